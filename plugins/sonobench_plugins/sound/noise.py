"""Seeded noises."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.protocols import SoundSignal
from sonobench.scene.noise import pink

_PROVENANCE = {"licence": "none needed (synthetic)", "source": "sonobench"}


@dataclass(frozen=True)
class White:
    """Gaussian noise of flat spectrum."""

    rms: float = 0.1  #: root mean square, full scale 1

    def __post_init__(self) -> None:
        _check_rms(self.rms)

    def render(self, rng: np.random.Generator, duration_s: float, rate_hz: float) -> SoundSignal:
        """A mono signal of that length and rate."""
        return SoundSignal(self.rms * rng.standard_normal(round(duration_s * rate_hz)), (0.0, rate_hz / 2), _PROVENANCE)


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
