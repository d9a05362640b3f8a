"""Noise with the long-term spectrum of speech.

Source: ANSI S3.5-1997, table 3: standard speech spectrum level (dB re 20 µPa, a hertz), normal vocal effort, at the centres of third octaves from
160 Hz to 8 kHz. Between centres the level runs straight over the logarithm of frequency; half a third octave beyond the outermost it ends.
Deviations: only the shape is the standard's; the level is `rms`. The spectrum is exact for the expectation, bin by bin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.protocols import SoundSignal
from sonobench.types import Array, Floats

_PROVENANCE = {"licence": "none needed (synthetic)", "source": "sonobench, spectrum of ANSI S3.5-1997"}
_CENTRE_HZ = 1000.0 * 2.0 ** (np.arange(-8, 10) / 3.0)
_LEVEL_DB = np.array(
    [32.41, 34.48, 34.75, 33.98, 34.59, 34.27, 32.06, 28.30, 25.01, 23.00, 20.15, 17.32, 13.18, 11.55, 9.33, 5.31, 2.59, 1.13]
)
_EDGES_HZ = (float(_CENTRE_HZ[0] * 2 ** (-1 / 6)), float(_CENTRE_HZ[-1] * 2 ** (1 / 6)))


def speech_level_db(frequency_hz: Floats) -> Array:
    """Spectrum level (…) of normal speech, dB a hertz; −inf outside the table's bands."""
    level = np.interp(np.log(np.maximum(frequency_hz, 1.0)), np.log(_CENTRE_HZ), _LEVEL_DB)
    return np.where((frequency_hz >= _EDGES_HZ[0]) & (frequency_hz <= _EDGES_HZ[1]), level, -np.inf)


@dataclass(frozen=True)
class SpeechNoise:
    """Steady Gaussian noise shaped like speech."""

    rms: float = 0.1  #: expected root mean square, full scale 1

    def __post_init__(self) -> None:
        if not 0 < self.rms < np.inf:
            raise ValueError(f"rms is {self.rms}; a positive number is needed")

    def render(self, rng: np.random.Generator, duration_s: float, rate_hz: float) -> SoundSignal:
        """A mono signal of that length and rate.

        Raises:
            ValueError: so short, or of so low a rate, that no frequency falls into the band.
        """
        n = round(duration_s * rate_hz)
        frequency_hz: Floats = np.fft.rfftfreq(n, 1.0 / rate_hz) if n else np.zeros(0)
        amplitude = 10.0 ** (speech_level_db(frequency_hz) / 20.0)
        times = np.where(
            (frequency_hz == 0) | (frequency_hz == rate_hz / 2), 1.0, 2.0
        )  # an inner bin stands for two of the whole transform
        power = float(np.sum(times * amplitude**2)) / max(n, 1)
        if power == 0.0:
            raise ValueError(f"{n} samples at {rate_hz:g} Hz hold no frequency from {_EDGES_HZ[0]:.0f} to {_EDGES_HZ[1]:.0f} Hz")
        shaped = np.fft.irfft(amplitude * np.fft.rfft(rng.standard_normal(n)), n)
        return SoundSignal(self.rms / np.sqrt(power) * shaped, (_EDGES_HZ[0], min(_EDGES_HZ[1], rate_hz / 2)), _PROVENANCE)
