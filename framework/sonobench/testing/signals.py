"""What delays, voice activity and sounds must do."""

from __future__ import annotations

from typing import Any

import numpy as np

from sonobench.testing.kit import Case, broken, claim, need

_DELAY, _ACTIVITY, _SOUND = ("delay",), ("activity",), ("sound",)
_PAIRS = np.array([[0, 1], [0, 2], [2, 1]])
_N = 512


def _spectra(frames: int = 3, shift: int = 5, seed: int = 2) -> Any:
    """(frames, 3, bin): noise; microphone 0 hears it `shift` samples after 1, microphone 2 another 4 later."""
    noise = np.random.default_rng(seed).standard_normal((frames, _N))
    return np.fft.rfft(np.stack([np.roll(noise, s, axis=1) for s in (shift, 0, shift + 4)], axis=1))


@claim("delay.runs", _DELAY)
def delay_runs(case: Case) -> None:
    """A delay estimator takes spectra (…, mic, bin) and gives correlations (…, pair, lag)."""
    shape = np.shape(case.component.correlate(_spectra(), _PAIRS.copy()))
    need(len(shape) == 3 and shape[:2] == (3, 3), f"correlations of 3 frames and 3 pairs have shape {shape}; (3, 3, {_N}) is needed")


@claim("delay.lags", _DELAY, ["delay.runs"])
def delay_lags(case: Case) -> None:
    """A spectrum of bin bins gives 2 (bin − 1) lags of a real number."""
    found = np.asarray(case.component.correlate(_spectra(), _PAIRS.copy()))
    need(found.shape[-1] == _N, f"{found.shape[-1]} lags from {_N // 2 + 1} bins; 2 (bin − 1) = {_N} are needed")
    need(found.dtype.kind == "f", f"correlations are {found.dtype}; a real floating type is needed")


@claim("delay.repeats", _DELAY, ["delay.runs"])
def delay_repeats(case: Case) -> None:
    """The same spectra give the same correlations."""
    first, second = (np.asarray(case.component.correlate(_spectra(), _PAIRS.copy())) for _ in range(2))
    need(np.array_equal(first, second), "two calls with the same arguments differ; a delay is a function of its arguments only")


@claim("delay.mutation", _DELAY, ["delay.repeats"])
def delay_mutation(case: Case) -> None:
    """The spectra are left as they came."""
    spectra, pairs = _spectra(), _PAIRS.copy()
    spectra.flags.writeable = pairs.flags.writeable = False
    try:
        case.component.correlate(spectra, pairs)
    except ValueError as error:
        broken(f"writes into its arguments ({error}); the spectra are shared by all pairs")


@claim("delay.batch", _DELAY, ["delay.repeats"])
def delay_batch(case: Case) -> None:
    """A frame's correlation does not depend on the frames and pairs beside it."""
    spectra = _spectra()
    whole = np.asarray(case.component.correlate(spectra, _PAIRS.copy()))
    scale = np.abs(whole).max()
    for frame in range(3):
        one = np.asarray(case.component.correlate(spectra[frame].copy(), _PAIRS.copy()))
        need(one.shape == whole.shape[1:], f"spectra (mic, bin) give shape {one.shape}; {whole.shape[1:]} is needed")
        need(
            np.allclose(one, whole[frame], rtol=1e-6, atol=1e-9 * scale), f"frame {frame} alone and in a batch give different correlations"
        )
    swapped = np.asarray(case.component.correlate(spectra, _PAIRS[::-1].copy()))
    need(np.allclose(swapped, whole[:, ::-1], rtol=1e-6, atol=1e-9 * scale), "a pair's correlation depends on the other pairs")


@claim("delay.sign", _DELAY, ["delay.lags"])
def delay_sign(case: Case) -> None:
    """The peak of pair (i, j) lies at the lag by which i is later than j."""
    found = np.asarray(case.component.correlate(_spectra(), _PAIRS.copy()))
    lags = (np.argmax(found, axis=-1) + _N // 2) % _N - _N // 2
    for p, expected in enumerate((5, -4, 9)):
        need(
            (lags[:, p] == expected).all(),
            f"pair {_PAIRS[p].tolist()} peaks at lags {lags[:, p].tolist()}, where i is {expected} samples later than j; "
            "is it spectra[i] · conj(spectra[j]), zero lag first?",
        )


@claim("delay.silence", _DELAY, ["delay.runs"])
def delay_silence(case: Case) -> None:
    """Silent frames give finite correlations."""
    spectra = _spectra()
    spectra[1] = 0.0
    found = np.asarray(case.component.correlate(spectra, _PAIRS.copy()))
    need(np.isfinite(found).all(), "a frame of zeros gives NaN or infinity; guard the division")


def _frames(count: int = 12, seed: int = 4) -> Any:
    """(count, 400, 2): faint noise, and loud noise in the later half."""
    loud = np.where(np.arange(count) < count // 2, 1e-4, 0.3)
    return loud[:, None, None] * np.random.default_rng(seed).standard_normal((count, 400, 2))


@claim("activity.runs", _ACTIVITY)
def activity_runs(case: Case) -> None:
    """Frames (f, n, channels) give a state and (f,) booleans."""
    _, active = case.component.active(case.component.start(16000.0), _frames())
    active = np.asarray(active)
    need(active.shape == (12,) and active.dtype == bool, f"12 frames give {active.dtype} {active.shape}; bool (12,) is needed")


@claim("activity.voice", _ACTIVITY, ["activity.runs"])
def activity_voice(case: Case) -> None:
    """Loud frames after faint ones are active."""
    _, active = case.component.active(case.component.start(16000.0), _frames())
    need(np.asarray(active)[6:].any(), "no frame is active where the level rises by 70 dB")


@claim("activity.repeats", _ACTIVITY, ["activity.runs"])
def activity_repeats(case: Case) -> None:
    """The same frames give the same answer."""
    first, second = (np.asarray(case.component.active(case.component.start(16000.0), _frames())[1]) for _ in range(2))
    need(np.array_equal(first, second), "two runs over the same frames differ; keep all memory in the state")


@claim("activity.batch", _ACTIVITY, ["activity.repeats"])
def activity_batch(case: Case) -> None:
    """How many frames come at a time does not matter."""
    frames = _frames()
    _, whole = case.component.active(case.component.start(16000.0), frames.copy())
    state, parts = case.component.start(16000.0), []
    for first, last in ((0, 1), (1, 7), (7, 12)):
        state, part = case.component.active(state, frames[first:last].copy())
        parts.append(part)
    need(
        np.array_equal(np.concatenate(parts), whole),
        "the same frames in other batches give another answer; carry the memory over in the state",
    )


@claim("activity.mutation", _ACTIVITY, ["activity.repeats"])
def activity_mutation(case: Case) -> None:
    """Neither state nor frames are changed."""
    frames = _frames()
    frames.flags.writeable = False
    try:
        state, _ = case.component.active(case.component.start(16000.0), frames[:7])
        first, second = (np.asarray(case.component.active(state, frames[7:])[1]) for _ in range(2))
    except ValueError as error:
        broken(f"writes into the frames ({error})")
    need(np.array_equal(first, second), "a second call from the same state gives another answer; build a new state")


def _render(case: Case, seed: int = 1, duration_s: float = 0.7) -> Any:
    return case.component.render(np.random.default_rng(seed), duration_s, 16000.0)


@claim("sound.runs", _SOUND)
def sound_runs(case: Case) -> None:
    """A sound renders to (samples, band_hz, provenance)."""
    signal = _render(case)
    need(len(signal) == 3, f"render gave {type(signal).__name__}; a SoundSignal(samples, band_hz, provenance) is needed")


@claim("sound.length", _SOUND, ["sound.runs"])
def sound_length(case: Case) -> None:
    """The signal is mono and as long as was asked."""
    for duration_s in (0.7, 0.25):
        samples = np.asarray(_render(case, duration_s=duration_s)[0])
        wanted = round(duration_s * 16000)
        need(samples.shape == (wanted,), f"{duration_s} s at 16 kHz give shape {samples.shape}; ({wanted},) is needed")


@claim("sound.finite", _SOUND, ["sound.runs"])
def sound_finite(case: Case) -> None:
    """The signal is finite and not silent."""
    samples = np.asarray(_render(case)[0])
    need(np.isfinite(samples).all(), "the samples hold NaN or infinity")
    need(np.any(samples), "the samples are all zero")


@claim("sound.seed", _SOUND, ["sound.runs"])
def sound_seed(case: Case) -> None:
    """The same generator seed gives the same samples."""
    need(
        np.array_equal(_render(case)[0], _render(case)[0]),
        "two renderings from one seed differ; draw only from the generator that is passed",
    )


@claim("sound.band", _SOUND, ["sound.runs"])
def sound_band(case: Case) -> None:
    """Its band lies between 0 and half the rate, and its provenance names a licence and a source."""
    _, band_hz, provenance = _render(case)
    low, high = band_hz
    need(0 <= low < high <= 8000.0, f"band_hz is {tuple(band_hz)} at 16 kHz; 0 ≤ low < high ≤ 8000 is needed")
    need({"licence", "source"} <= set(provenance), f"the provenance has {sorted(provenance)}; licence and source are needed")
