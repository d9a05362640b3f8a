"""Normalisation: one gain for all channels that brings the sound to a stated level, from its past alone.

Source: Liang 2016, 2.2, which names it and gives no rule.
By "rms" the gain follows the mean square over all channels with a time constant; before the first sample the level counts as reached, so
the gain begins at 1 and moves as sound comes in. By "peak" it is the level over the largest magnitude so far, and only ever falls.
All channels share the gain at an instant. It changes by at most a share of delay / memory_s while sound passes from one
microphone to the next, so ratios and delays between channels stay as they were. Beware of voice activity by energy
behind "rms" with a short memory: it lifts the noise of pauses.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from typing import Literal

import numpy as np

from sonobench.protocols import State
from sonobench.types import Array


@dataclass(frozen=True)
class Normalise:
    """Automatic gain, common to all channels."""

    by: Literal["rms", "peak"] = "rms"  #: what is brought to the level: a running root mean square, or the largest magnitude so far
    level: float = 0.1  #: where it is brought, full scale 1
    memory_s: float = 1.0  #: time constant of "rms"
    most: float = 1000.0  #: largest gain

    def __post_init__(self) -> None:
        if self.by not in ("rms", "peak"):
            raise ValueError(f"by is {self.by!r}; 'rms' or 'peak' is needed")
        for name in ("level", "memory_s", "most"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} is {getattr(self, name)}; a positive number is needed")

    def start(self, rate_hz: float, channels: int) -> State:
        """(share of the past that a sample leaves, the mean square or the peak so far, channels)."""
        keep = float(np.exp(-1.0 / (rate_hz * self.memory_s)))
        return keep, self.level**2 if self.by == "rms" else self.level / self.most, channels

    def process(self, state: State, samples: Array) -> tuple[State, Array]:
        """Scale the next (n, channels)."""
        keep, before, channels = state
        now = self._peak(before, samples) if self.by == "peak" else self._rms(keep, before, samples)
        size = now if self.by == "peak" else np.sqrt(now)
        gain = self.level / np.maximum(size, self.level / self.most)
        return (keep, float(now[-1]), channels), samples * gain[:, None]

    def finish(self, state: State) -> Array:
        """Nothing is due."""
        return np.zeros((0, state[2]))

    def _peak(self, before: float, samples: Array) -> Array:
        return np.asarray(np.maximum.accumulate(np.maximum(np.abs(samples).max(axis=1), before)))

    def _rms(self, keep: float, before: float, samples: Array) -> Array:
        from scipy.signal import lfilter

        # column by column: a sum along rows may be grouped differently for another number of rows
        power = reduce(np.add, np.square(samples.T)) / samples.shape[1]
        return np.asarray(lfilter([1.0 - keep], [1.0, -keep], power, zi=[keep * before])[0])
