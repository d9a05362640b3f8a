"""A recorded sound: one of the clips that come with a distribution, or a user's own file.

The file is mixed down to one channel (mean of its channels), freed of its mean, resampled by a polyphase filter, scaled to
a stated level, and repeated with a pause after each turn for as long as is wanted. Resampling upwards adds nothing above
the file's own half rate, which `band_hz` says.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from sonobench.errors import InputError
from sonobench.protocols import SoundSignal
from sonobench.registry import Registry
from sonobench.scene.resampling import resampled
from sonobench.types import Array

_SUFFIXES = (".wav", ".flac")
_FRAME_S = 0.02
_SILENCE = 1e-4  # −40 dB
_FADE_S = 0.005


@dataclass(frozen=True)
class Clip:
    """A clip, repeated; each rendering starts somewhere else in it unless `offset_s` says where."""

    clip: str  #: name of a packaged clip, or a path that ends in .wav or .flac
    offset_s: float | None = None  #: where in the clip it starts; None: drawn from the seed
    pause_s: float = 0.4  #: silence after each turn of the clip
    rms: float = 0.1  #: root mean square of its 20 ms frames above −40 dB of the loudest, full scale 1

    def __post_init__(self) -> None:
        if self.offset_s is not None and not 0 <= self.offset_s < np.inf:
            raise ValueError(f"offset_s is {self.offset_s}; 0 or more is needed (leave it out to draw it from the seed)")
        if not 0 <= self.pause_s < np.inf:
            raise ValueError(f"pause_s is {self.pause_s}; 0 or more is needed")
        if not 0 < self.rms < np.inf:
            raise ValueError(f"rms is {self.rms}; a positive number is needed")

    @property
    def files(self) -> tuple[Path, ...]:
        """The file of the sound, and the one beside a packaged clip that says where it comes from.

        Raises:
            InputError: there is none; the message lists the packaged clips.
        """
        file = _find(self.clip)
        return (file,) if self.clip.endswith(_SUFFIXES) else (file, file.with_suffix(".txt"))

    def render(self, rng: np.random.Generator, duration_s: float, rate_hz: float) -> SoundSignal:
        """A mono signal of that length and rate.

        Raises:
            InputError: the file is missing, unreadable, or silent.
        """
        file = self.files[0]
        samples, own_hz = _read(file)
        turn = _faded(resampled(self.rms * samples, own_hz, rate_hz), rate_hz)
        turn = np.concatenate([turn, np.zeros(round(self.pause_s * rate_hz))])
        start = rng.integers(len(turn)) if self.offset_s is None else round(self.offset_s * rate_hz)
        signal = turn[(start + np.arange(round(duration_s * rate_hz))) % len(turn)]
        return SoundSignal(signal, (0.0, min(own_hz, rate_hz) / 2), _provenance(self.clip, file))


@lru_cache(maxsize=1)
def _packaged() -> Registry:
    return Registry.load()


def _find(clip: str) -> Path:
    if clip.endswith(_SUFFIXES):
        file = Path(clip)
        if not file.is_file():
            raise InputError(f"{clip}: no such file")
        return file
    clips = _packaged().data_files("clips", ".flac")
    dist, _, name = clip.rpartition(":")
    found = [f for p, f in clips.get(name, []) if not dist or p.distribution == dist]
    if len(found) != 1:
        what = f"{len(found)} distributions ship a clip {name!r}; write dist:name" if found else f"no clip is named {clip!r}"
        raise InputError(f"{what}; there are {', '.join(sorted(clips)) or 'none'} (a file's name ends in {' or '.join(_SUFFIXES)})")
    return found[0]


def _read(file: Path) -> tuple[Array, float]:
    """Samples (n,) of mean 0 and active RMS 1, and their rate."""
    import soundfile

    try:
        channels, rate_hz = soundfile.read(file, always_2d=True)
    except soundfile.LibsndfileError as error:
        raise InputError(f"{file}: cannot be read as sound: {error}") from None
    samples = channels.mean(axis=1)
    samples = samples - samples.mean() if len(samples) else samples
    frame = round(_FRAME_S * rate_hz)
    power = np.square(samples[: len(samples) // frame * frame]).reshape(-1, frame).mean(axis=1)
    if not power.size or not np.isfinite(power).all() or power.max() == 0:
        raise InputError(f"{file}: holds no sound of {_FRAME_S:g} s or more")
    return samples / np.sqrt(power[power > _SILENCE * power.max()].mean()), float(rate_hz)


def _faded(samples: Array, rate_hz: float) -> Array:
    n = min(round(_FADE_S * rate_hz), len(samples) // 2)
    gain = np.ones(len(samples))
    gain[:n] = (np.arange(n) + 0.5) / n
    gain[len(samples) - n :] = gain[:n][::-1]
    return samples * gain


def _provenance(clip: str, file: Path) -> dict[str, str]:
    if clip.endswith(_SUFFIXES):
        return {"source": file.name, "licence": "unknown (a user's own file)"}
    lines = file.with_suffix(".txt").read_text("utf-8").splitlines()
    keys = {"Source": "source", "License": "licence", "Copyright": "copyright"}
    found = {keys[k]: v.strip() for k, _, v in (line.partition(":") for line in lines) if k in keys}
    return {"clip": clip, **found, "attribution": "\n".join(lines)}
