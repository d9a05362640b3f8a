"""Seeded noises."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sonobench.protocols import SoundSignal
from sonobench.scene.noise import pink, shaped

_PROVENANCE = {"licence": "none needed (synthetic)", "source": "sonobench"}


@dataclass(frozen=True)
class White:
    """Independent samples: noise of flat spectrum."""

    rms: float = 0.1  #: expected root mean square, full scale 1
    distribution: Literal["gaussian", "uniform", "laplace"] = "gaussian"  #: of a sample; excess kurtosis 0, −1.2, 3

    def __post_init__(self) -> None:
        _check_rms(self.rms)

    def render(self, rng: np.random.Generator, duration_s: float, rate_hz: float) -> SoundSignal:
        """A mono signal of that length and rate."""
        n = round(duration_s * rate_hz)
        if self.distribution == "uniform":
            unit = rng.uniform(-math.sqrt(3.0), math.sqrt(3.0), n)
        elif self.distribution == "laplace":
            unit = rng.laplace(0.0, math.sqrt(0.5), n)
        else:
            unit = rng.standard_normal(n)
        return SoundSignal(self.rms * unit, (0.0, rate_hz / 2), _PROVENANCE)


@dataclass(frozen=True)
class NarrowBand:
    """Gaussian noise of flat spectrum within a band, exactly nothing outside at the bins of its transform."""

    centre_hz: float = 1000.0  #: middle of the band
    bandwidth_hz: float = 100.0  #: from edge to edge
    rms: float = 0.1  #: expected root mean square, full scale 1

    def __post_init__(self) -> None:
        _check_rms(self.rms)
        if not 0 < self.bandwidth_hz <= 2 * self.centre_hz < np.inf:
            raise ValueError(
                f"centre_hz is {self.centre_hz} and bandwidth_hz {self.bandwidth_hz}; a band that begins at 0 Hz or above is needed"
            )

    def render(self, rng: np.random.Generator, duration_s: float, rate_hz: float) -> SoundSignal:
        """A mono signal of that length and rate.

        Raises:
            ValueError: the band leaves half the rate, or holds none of the duration's frequencies.
        """
        low, high = self.centre_hz - self.bandwidth_hz / 2, self.centre_hz + self.bandwidth_hz / 2
        if high > rate_hz / 2:
            raise ValueError(f"the band ends at {high:g} Hz; at {rate_hz:g} Hz there is nothing above {rate_hz / 2:g} Hz")
        n = round(duration_s * rate_hz)
        if n == 0:
            return SoundSignal(np.zeros(0), (low, high), _PROVENANCE)
        frequency = np.fft.rfftfreq(n, 1 / rate_hz)
        inside = (frequency >= low) & (frequency <= high)
        if not inside.any():
            raise ValueError(f"{duration_s:g} s hold no frequency from {low:g} to {high:g} Hz; widen the band")
        return SoundSignal(self.rms * shaped(rng, n, inside.astype(float)), (low, high), _PROVENANCE)


@dataclass(frozen=True)
class Pink:
    """Gaussian noise whose power density falls as 1/f, exactly at the bins of its transform."""

    rms: float = 0.1  #: expected root mean square, full scale 1
    low_hz: float = 20.0  #: nothing below

    def __post_init__(self) -> None:
        _check_rms(self.rms)
        if not self.low_hz > 0:
            raise ValueError(f"low_hz is {self.low_hz}; a positive frequency is needed, since 1/f has infinite power down to 0")

    def render(self, rng: np.random.Generator, duration_s: float, rate_hz: float) -> SoundSignal:
        """A mono signal of that length and rate.

        Raises:
            ValueError: the rate is too low or the duration too short for any frequency above `low_hz`.
        """
        n = round(duration_s * rate_hz)
        return SoundSignal(self.rms * pink(rng, n, rate_hz, self.low_hz), (self.low_hz, rate_hz / 2), _PROVENANCE)


def _check_rms(rms: float) -> None:
    if not 0 < rms < np.inf:
        raise ValueError(f"rms is {rms}; a positive number is needed")
