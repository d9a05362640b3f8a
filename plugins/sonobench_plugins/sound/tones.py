"""Sums of sinusoids: tones at stated frequencies, and a harmonic sound whose pitch may waver."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from sonobench.protocols import SoundSignal
from sonobench.types import Array, read_only

_PROVENANCE = {"licence": "none needed (synthetic)", "source": "sonobench"}
_LOBE = 2.0  # half width of a tone's main lobe, in periods of its duration


@dataclass(frozen=True, eq=False)
class Multitone:
    """Equally strong sinusoids; the seed draws their phases."""

    frequencies_hz: Array = field(default_factory=lambda: np.array([500.0, 800.0, 1300.0, 2100.0, 3400.0]))  #: of the tones
    rms: float = 0.1  #: expected root mean square of their sum, full scale 1

    def __post_init__(self) -> None:
        frequencies = read_only(self.frequencies_hz, shape=(None,), name="frequencies_hz")
        if (
            not len(frequencies)
            or not (np.isfinite(frequencies) & (frequencies > 0)).all()
            or len(set(frequencies.tolist())) < len(frequencies)
        ):
            raise ValueError(f"frequencies_hz is {frequencies.tolist()}; one or more different positive frequencies are needed")
        _check_positive(rms=self.rms)
        object.__setattr__(self, "frequencies_hz", frequencies)

    def render(self, rng: np.random.Generator, duration_s: float, rate_hz: float) -> SoundSignal:
        """A mono signal of that length and rate.

        Raises:
            ValueError: a tone is not below half the rate.
        """
        highest = float(self.frequencies_hz.max())
        if highest >= rate_hz / 2:
            raise ValueError(f"a tone is at {highest:g} Hz; at {rate_hz:g} Hz tones below {rate_hz / 2:g} Hz are needed")
        time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
        phase = rng.uniform(0.0, 2.0 * np.pi, len(self.frequencies_hz))
        samples = np.zeros(len(time_s))
        for f, start in zip(self.frequencies_hz, phase, strict=True):
            samples += np.cos(2.0 * np.pi * f * time_s + start)
        scale = self.rms * math.sqrt(2.0 / len(self.frequencies_hz))
        return SoundSignal(scale * samples, _band(float(self.frequencies_hz.min()), highest, duration_s, rate_hz), _PROVENANCE)


@dataclass(frozen=True)
class Harmonic:
    """A pitch and its overtones, as of a sustained voice; the seed draws their phases and the vibrato's."""

    f0_hz: float = 150.0  #: pitch
    high_hz: float = 4000.0  #: no overtone reaches above this, nor half the rate
    tilt_db_octave: float = -6.0  #: level of an overtone against one an octave below
    vibrato_hz: float = 5.5  #: how often the pitch wavers a second
    vibrato_cents: float = 0.0  #: how far it wavers up and down, in hundredths of a semitone; 0 for none
    rms: float = 0.1  #: expected root mean square, full scale 1

    def __post_init__(self) -> None:
        _check_positive(f0_hz=self.f0_hz, high_hz=self.high_hz, vibrato_hz=self.vibrato_hz, rms=self.rms)
        if not (0 <= self.vibrato_cents <= 1200 and math.isfinite(self.tilt_db_octave)):
            raise ValueError(
                f"vibrato_cents is {self.vibrato_cents} and tilt_db_octave {self.tilt_db_octave}; 0 to 1200 and a finite slope are needed"
            )

    def render(self, rng: np.random.Generator, duration_s: float, rate_hz: float) -> SoundSignal:
        """A mono signal of that length and rate.

        Raises:
            ValueError: the pitch itself reaches `high_hz` or half the rate.
        """
        bend = self.vibrato_cents / 1200.0
        top = min(self.high_hz, rate_hz / 2) / 2.0**bend
        count = math.ceil(top / self.f0_hz) - 1
        if count < 1:
            raise ValueError(
                f"the pitch {self.f0_hz:g} Hz with its vibrato reaches {2.0**bend * top:g} Hz; lower f0_hz, or raise high_hz or the rate"
            )
        time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
        turn = rng.uniform(0.0, 2.0 * np.pi, 1 + count)
        pitch_hz = self.f0_hz * 2.0 ** (bend * np.sin(2.0 * np.pi * self.vibrato_hz * time_s + turn[0]))
        cycles = np.cumsum(pitch_hz) / rate_hz if bend else self.f0_hz * time_s
        number = np.arange(1, count + 1)
        level = number ** (self.tilt_db_octave / (20.0 * math.log10(2.0)))
        samples = np.zeros(len(time_s))
        for k, amplitude, start in zip(number.tolist(), level, turn[1:], strict=True):
            samples += amplitude * np.cos(2.0 * np.pi * k * cycles + start)
        scale = self.rms * math.sqrt(2.0 / float(np.sum(level**2)))
        band = _band(self._reach_hz(1, bend, -1), self._reach_hz(count, bend, 1), duration_s, rate_hz)
        return SoundSignal(scale * samples, band, _PROVENANCE)

    def _reach_hz(self, number: int, bend: float, side: int) -> float:
        """How far down (side −1) or up (1) an overtone reaches with the side tones of its vibrato."""
        edge = number * self.f0_hz * 2.0 ** (side * bend)
        if bend == 0.0:
            return edge
        index = abs(edge - number * self.f0_hz) / self.vibrato_hz  # beyond it Bessel functions J_n fall within a few times its cube root
        return float(edge + side * self.vibrato_hz * (1.0 + 3.0 * index ** (1.0 / 3.0)))


def _band(low_hz: float, high_hz: float, duration_s: float, rate_hz: float) -> tuple[float, float]:
    """From the lowest tone to the highest with their main lobes."""
    margin = _LOBE / duration_s
    return max(0.0, low_hz - margin), min(high_hz + margin, rate_hz / 2)


def _check_positive(**values: float) -> None:
    for name, value in values.items():
        if not 0 < value < np.inf:
            raise ValueError(f"{name} is {value}; a positive number is needed")
