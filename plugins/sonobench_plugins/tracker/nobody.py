"""A tracker that never reports anybody: the least that a board entry must beat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.protocols import State
from sonobench.types import Estimate, Scan, Setup, Space


@dataclass(frozen=True)
class Nobody:
    """Reports an empty set after every scan."""

    @property
    def space(self) -> Space:
        """The plane."""
        return Space.of("x_m", "y_m")

    def init(self, rng: np.random.Generator, setup: Setup) -> State:
        """Nothing to remember."""
        return None

    def step(self, rng: np.random.Generator, state: State, scan: Scan) -> tuple[State, Estimate]:
        """Nobody."""
        return None, Estimate(scan.time_s, np.zeros((0, 2)), count=0.0)
