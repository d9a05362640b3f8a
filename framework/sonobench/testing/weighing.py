"""What delay estimators that weigh averaged spectra must do; `weigh` is optional, and without it nothing is asked."""

from __future__ import annotations

from typing import Any

import numpy as np

from sonobench.testing.kit import Case, Skip, claim, need, untouched

_DELAY = ("delay",)
_PAIRS = np.array([[0, 1], [0, 2], [2, 1]])
_N = 512


def _periodograms(gain: float = 1.0) -> Any:
    """(frame 3, segment 6, mic 3, bin) complex64: noise that the microphones hear 5, 0 and 9 samples late, beside noise of their own."""
    rng = np.random.default_rng(5)
    heard = rng.standard_normal((3, 6, _N))
    own = 0.3 * rng.standard_normal((3, 6, 3, _N))
    samples = gain * (np.stack([np.roll(heard, s, axis=-1) for s in (5, 0, 9)], axis=2) + own)
    return np.fft.rfft(samples).astype(np.complex64)


def _averages(gain: float = 1.0, dead: tuple[int, ...] = ()) -> tuple[Any, Any]:
    """Cross-spectra (3, pair, bin) and power (3, mic, bin), averaged over segments."""
    spectra = _periodograms(gain)
    spectra[:, :, list(dead)] = 0.0
    cross = spectra[:, :, _PAIRS[:, 0]] * spectra[:, :, _PAIRS[:, 1]].conj()
    return cross.mean(axis=1), (np.abs(spectra) ** 2).mean(axis=1)


def _weigher(case: Case) -> Any:
    if not hasattr(case.component, "weigh"):
        raise Skip("it has no weigh; it correlates frames as they are")
    return case.component


def _peaks(weighted: Any) -> Any:
    """Correlations of weighted cross-spectra, as front ends scale them."""
    from sonobench.signal import correlations

    return correlations(np.asarray(weighted).astype(np.complex64))


def _alike(one: Any, other: Any) -> bool:
    return bool(np.allclose(one, other, rtol=1e-3, atol=1e-3 * np.abs(other).max()))


@claim("delay.weigh", _DELAY, ["delay.lags", "delay.repeats", "delay.mutation", "delay.batch", "delay.sign", "delay.silence"])
def delay_weigh(case: Case) -> None:
    """Averaged cross-spectra come back weighed, in their shape, from an estimator that says how much to average."""
    estimator = _weigher(case)
    segments, memory_s = getattr(estimator, "segments", None), getattr(estimator, "memory_s", None)
    need(
        isinstance(segments, int) and segments >= 1,
        f"segments is {segments!r}; the number of Welch segments of a frame is needed, 1 for none",
    )
    need(isinstance(memory_s, (int, float)) and memory_s >= 0, f"memory_s is {memory_s!r}; a time constant of at least 0 is needed")
    weighted = np.asarray(estimator.weigh(*_averages(), _PAIRS.copy()))
    need(
        weighted.shape == (3, 3, _N // 2 + 1),
        f"weigh gives shape {weighted.shape} for cross-spectra (3, 3, {_N // 2 + 1}); theirs is needed",
    )
    need(weighted.dtype.kind == "c", f"weighed cross-spectra are {weighted.dtype}; complex ones are needed, whose phases carry the delay")


@claim("delay.weigh_mutation", _DELAY, ["delay.weigh"])
def delay_weigh_mutation(case: Case) -> None:
    """The averages are left as they came: the next frame's are made from them."""
    untouched(_weigher(case).weigh, *_averages(), _PAIRS)


@claim("delay.weigh_batch", _DELAY, ["delay.weigh"])
def delay_weigh_batch(case: Case) -> None:
    """What is weighed of one frame and pair does not depend on the frames and pairs beside it."""
    estimator, (cross, power) = _weigher(case), _averages()
    whole = _peaks(estimator.weigh(cross.copy(), power.copy(), _PAIRS.copy()))
    for f in range(3):
        one = _peaks(estimator.weigh(cross[f].copy(), power[f].copy(), _PAIRS.copy()))
        need(one.shape == whole[f].shape and _alike(one, whole[f]), f"frame {f} alone and in a batch is weighed differently")
    swapped = _peaks(estimator.weigh(cross[:, ::-1].copy(), power.copy(), _PAIRS[::-1].copy()))
    need(_alike(swapped[:, ::-1], whole), "what is weighed of a pair depends on the other pairs; does it read power by `pairs`?")


@claim("delay.weigh_level", _DELAY, ["delay.weigh"])
def delay_weigh_level(case: Case) -> None:
    """A recording 60 dB quieter has the same correlations."""
    estimator = _weigher(case)
    loud, quiet = (_peaks(estimator.weigh(*_averages(gain), _PAIRS.copy())) for gain in (1.0, 1e-3))
    need(
        _alike(quiet, loud),
        f"of a recording 60 dB quieter the highest peak is {quiet.max():.3g} and not {loud.max():.3g}; "
        "make what stands beside |cross| a share of it: divide by its mean over the bins",
    )


@claim("delay.weigh_silence", _DELAY, ["delay.weigh_batch"])
def delay_weigh_silence(case: Case) -> None:
    """A dead microphone, or silence, gives finite values, and the pairs without it peak where they did."""
    estimator = _weigher(case)
    for dead in ((2,), (0, 1, 2)):
        weighted = np.asarray(estimator.weigh(*_averages(dead=dead), _PAIRS.copy()))
        need(np.isfinite(weighted).all(), f"with {len(dead)} of 3 microphones dead weigh gives NaN or infinity; guard the division")
    whole, one = (_peaks(estimator.weigh(*_averages(dead=d), _PAIRS.copy()))[:, 0] for d in ((), (2,)))
    same = np.argmax(one, axis=-1) == np.argmax(whole, axis=-1)
    need(bool(same.all()), "a dead microphone moves the peak of a pair that it does not belong to; leave its pairs out of what all share")


@claim("delay.weighed", _DELAY, ["delay.weigh_mutation", "delay.weigh_level", "delay.weigh_silence"])
def delay_weighed(case: Case) -> None:
    """`correlate` is `weigh` of one frame's periodogram."""
    from sonobench.signal import weighed

    estimator, spectra = _weigher(case), _periodograms()[:, 0]
    own = np.asarray(estimator.correlate(spectra.copy(), _PAIRS.copy()))
    need(
        _alike(own, weighed(estimator, spectra, _PAIRS)),
        "correlate and weigh of the same periodogram give different correlations; let correlate return sonobench.signal.weighed(self, spectra, pairs)",
    )
