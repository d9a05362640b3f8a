"""Pre-emphasis: y[k] = x[k] − a x[k − 1].

Source: Liang 2016, 2.2, which names it; Markel & Gray 1976, "Linear prediction of speech". It lifts the high frequencies that speech lacks: for a
delay estimator that does not whiten it sharpens the peak. PHAT divides it out again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.protocols import State
from sonobench.types import Array


@dataclass(frozen=True)
class PreEmphasis:
    """First difference, leaky."""

    coefficient: float = 0.97  #: a; the gain is 1 − a at 0 Hz and 1 + a at half the rate

    def __post_init__(self) -> None:
        if not 0 <= self.coefficient <= 1:
            raise ValueError(f"coefficient is {self.coefficient}; 0 to 1 is needed")

    def start(self, rate_hz: float, channels: int) -> State:
        """The sample before the first (1, channels): zero."""
        return np.zeros((1, channels))

    def process(self, state: State, samples: Array) -> tuple[State, Array]:
        """Difference of the next (n, channels)."""
        before = np.concatenate([state, samples[:-1]])
        return samples[-1:].copy(), samples - self.coefficient * before

    def finish(self, state: State) -> Array:
        """Nothing is due."""
        return np.zeros((0, state.shape[1]))
