"""What preprocessors must do."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from typing import Any

import numpy as np

from sonobench.testing.kit import Case, broken, claim, need

_PREPROCESSOR = ("preprocessor",)
_RATE_HZ = 16000.0


def _samples(n: int = 8000, seed: int = 5) -> Any:
    """(n, 4): noise, faint in the first third; channel 1 hears channel 0 twice as loud, channel 2 five samples later."""
    noise = np.random.default_rng(seed).standard_normal(n + 5) * np.where(np.arange(n + 5) < n // 3, 1e-3, 0.1)
    alone = 0.01 * np.random.default_rng(seed + 1).standard_normal(n)
    return np.stack([noise[5:], 2.0 * noise[5:], noise[:n], alone], axis=1)


def _run(component: Any, samples: Any, cuts: Sequence[int] = ()) -> Any:
    state, out = component.start(_RATE_HZ, samples.shape[1]), []
    for piece in np.split(samples, cuts):
        state, ready = component.process(state, np.ascontiguousarray(piece))
        out.append(np.asarray(ready))
    return np.concatenate([*out, np.asarray(component.finish(state))])


@claim("preprocessor.runs", _PREPROCESSOR)
def runs(case: Case) -> None:
    """As many samples come out as went in, each (n, channels), also of a single one."""
    for n in (8000, 333, 1):
        found = _run(case.component, _samples(n))
        need(
            found.shape == (n, 4),
            f"{n} samples of 4 channels give {found.shape} with those of finish; ({n}, 4) are needed, sample k for sample k",
        )


@claim("preprocessor.finite", _PREPROCESSOR, ["preprocessor.runs"])
def finite(case: Case) -> None:
    """Loud, faint and constant samples give finite samples."""
    for samples in (1e4 * _samples(), 1e-12 * _samples(), np.ones((8000, 2))):
        need(np.isfinite(_run(case.component, samples)).all(), f"samples of up to {np.abs(samples).max():.2g} give NaN or infinity")


@claim("preprocessor.repeats", _PREPROCESSOR, ["preprocessor.runs"])
def repeats(case: Case) -> None:
    """The same samples give the same samples."""
    first, second = _run(case.component, _samples()), _run(case.component, _samples())
    need(np.array_equal(first, second), "two runs over the same samples differ; keep all memory in the state")


@claim("preprocessor.blocks", _PREPROCESSOR, ["preprocessor.repeats"])
def blocks(case: Case) -> None:
    """How the samples are cut changes no bit."""
    whole = _run(case.component, _samples())
    for cuts in ((1, 2, 9, 700), range(160, 8000, 160), range(37, 8000, 1601)):
        parts = _run(case.component, _samples(), list(cuts))
        if not np.array_equal(parts, whole):
            k = int(np.argwhere(parts != whole)[0, 0])
            broken(f"cut at {list(cuts)[:4]} the samples differ from sample {k} on; carry the memory over in the state, sample by sample")


@claim("preprocessor.mutation", _PREPROCESSOR, ["preprocessor.repeats"])
def mutation(case: Case) -> None:
    """Neither state nor samples are changed."""
    samples = _samples()
    samples.flags.writeable = False
    try:
        state, _ = case.component.process(case.component.start(_RATE_HZ, 4), samples[:5000])
        first, second = (np.asarray(case.component.process(state, samples[5000:])[1]) for _ in range(2))
    except ValueError as error:
        broken(f"writes into the samples ({error})")
    need(np.array_equal(first, second), "a second call from the same state gives other samples; build a new state")


@claim("preprocessor.state", _PREPROCESSOR, ["preprocessor.repeats"])
def state_travels(case: Case) -> None:
    """Its state survives pickling and goes on the same."""
    state, _ = case.component.process(case.component.start(_RATE_HZ, 4), _samples()[:5000])
    try:
        again = pickle.loads(pickle.dumps(state))
    except Exception as error:
        broken(f"its state cannot be pickled ({type(error).__name__}: {error}); hold arrays and dataclasses only")
    here, there = (np.asarray(case.component.process(s, _samples()[5000:])[1]) for s in (state, again))
    need(np.array_equal(here, there), "a pickled state goes on with other samples")


@claim("preprocessor.silence", _PREPROCESSOR, ["preprocessor.runs"])
def silence(case: Case) -> None:
    """Digital silence stays silent, also on one channel among others."""
    samples = _samples()
    samples[:, 3] = 0.0
    need(not _run(case.component, np.zeros((8000, 2))).any(), "zeros give sound")
    need(
        not _run(case.component, samples)[:, 3].any(),
        "a channel of zeros beside others gets sound; front ends tell dead microphones by zeros",
    )


@claim("preprocessor.channels", _PREPROCESSOR, ["preprocessor.repeats"])
def channels(case: Case) -> None:
    """The same is done to all channels: what is in proportion stays so, in any order."""
    found = _run(case.component, _samples())
    scale = np.abs(found).max()
    need(
        np.allclose(found[:, 1], 2.0 * found[:, 0], rtol=0, atol=1e-9 * scale),
        "a channel twice as loud as another comes out in another proportion; give all channels one gain, or their delays and levels are lost",
    )
    turned = _run(case.component, np.ascontiguousarray(_samples()[:, ::-1]))
    need(np.allclose(turned[:, ::-1], found, rtol=0, atol=1e-9 * scale), "the order of channels changes their samples")


@claim("preprocessor.delays", _PREPROCESSOR, ["preprocessor.repeats"])
def delays(case: Case) -> None:
    """What one channel hears later than another it still hears later by as much."""
    found = _run(case.component, _samples())[2000:]
    spectra = np.fft.rfft(found[:, [0, 2]], 2 * len(found), axis=0)
    lag = int(np.argmax(np.fft.irfft(spectra[:, 1] * spectra[:, 0].conj())))
    need(lag == 5, f"5 samples between two channels become {lag if lag < len(found) else lag - 2 * len(found)}")
