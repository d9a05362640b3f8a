"""A tracker that always reports one target in the middle of the room: it knows the room and listens to nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.errors import SetupError
from sonobench.protocols import State
from sonobench.types import Estimate, Scan, Setup, Space


@dataclass(frozen=True)
class RoomCentre:
    """Reports the centre of the setup's box after every scan."""

    @property
    def space(self) -> Space:
        """The plane."""
        return Space.of("x_m", "y_m")

    def init(self, rng: np.random.Generator, setup: Setup) -> State:
        """The centre (2,).

        Raises:
            SetupError: the recording has no box.
        """
        if setup.box_m is None:
            raise SetupError("tracker room-centre needs the room's box; the recording is in free field or does not say")
        return setup.box_m.mean(axis=0)[:2]

    def step(self, rng: np.random.Generator, state: State, scan: Scan) -> tuple[State, Estimate]:
        """The centre."""
        return state, Estimate(scan.time_s, state[None], count=1.0)
