"""Births anywhere in the room: a grid of Gaussians that together cover it evenly.

Source: Vo & Ma 2006, eq. 15, with the uniform density over the room matched in mean and variance cell by cell. One wide
Gaussian is a poor prior for a bent measurement; several narrower ones are the Gaussian sum of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.errors import SetupError
from sonobench.filtering.kinematics import position_columns, variances
from sonobench.protocols import BoundMeasurement, Mixture, State
from sonobench.types import Scan, Setup, Space


@dataclass(frozen=True)
class Room:
    """per_axis ** dims Gaussians at rest; memory is the mixture."""

    weight: float = 0.1  #: expected births a scan, in the whole room
    per_axis: int = 1  #: Gaussians along each axis of the room
    position_std_m: float | None = None  #: spread of each; None: that of a uniform cell, its width / √12
    velocity_std_m_s: float = 0.5  #: spread of each velocity coordinate

    def __post_init__(self) -> None:
        if self.per_axis < 1:
            raise ValueError(f"per_axis is {self.per_axis}; at least 1 is needed")

    @property
    def uses_scan(self) -> bool:
        """A prior."""
        return False

    def start(self, space: Space, setup: Setup, measurement: BoundMeasurement) -> State:
        """The mixture.

        Raises:
            SetupError: the recording has no box, or the state no position.
        """
        who = "birth room"
        if setup.box_m is None:
            raise SetupError(f"{who} needs the room's box; the recording is in free field or does not say")
        columns = position_columns(space, who)
        low, high = setup.box_m[:, : len(columns)]
        width = (high - low) / self.per_axis
        shares = (np.arange(self.per_axis) + 0.5) / self.per_axis
        cells = np.stack(np.meshgrid(*[lo + shares * (hi - lo) for lo, hi in zip(low, high, strict=True)], indexing="ij"), axis=-1)
        m = np.zeros((self.per_axis ** len(columns), len(space)))
        m[:, columns] = cells.reshape(-1, len(columns))
        spread = variances(space, 1.0, self.velocity_std_m_s, who)
        spread[columns] = width**2 / 12 if self.position_std_m is None else self.position_std_m**2
        n = len(m)
        return Mixture(np.full(n, self.weight / n), m, np.tile(np.diag(spread), (n, 1, 1)), np.zeros(n, np.int64))

    def propose(self, rng: np.random.Generator, memory: State, scan: Scan, live: Mixture) -> tuple[State, Mixture]:
        """The same mixture."""
        return memory, memory
