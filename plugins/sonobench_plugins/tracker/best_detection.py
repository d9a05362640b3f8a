"""A tracker without memory: it reports each scan's best directions as they are. What a filter adds is measured against it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.filtering.evidence import rows_of, searched
from sonobench.filtering.steps import pose_of
from sonobench.protocols import State
from sonobench.sphere import rotated
from sonobench.types import Array, Estimate, Scan, Setup, Space


@dataclass(frozen=True)
class BestDetection:
    """Reports the rows of the highest scores of one direction sensor, in the room's axes; nobody where there is none."""

    sensor: str = ""  #: what the name of the sensor begins with; "" is the first of kind "direction"
    most: int = 1  #: how many rows it reports at most

    def __post_init__(self) -> None:
        if not self.most >= 1:
            raise ValueError(f"most is {self.most}; at least 1 is needed")

    @property
    def space(self) -> Space:
        """Directions."""
        return Space.of("azimuth_rad", "elevation_rad")

    def init(self, rng: np.random.Generator, setup: Setup) -> State:
        """The setup and the sensor's index.

        Raises:
            SetupError: there is no such sensor.
        """
        return setup, setup.of_kind("direction", "tracker best-detection", self.sensor)[0]

    def step(self, rng: np.random.Generator, state: tuple[Setup, int], scan: Scan) -> tuple[State, Estimate]:
        """The rows of this scan."""
        setup, q = state
        rows = rows_of(scan, q, 2) if searched(scan, (q,)) else rows_of(Scan(scan.time_s, scan.searched), q, 2)
        whole = np.flatnonzero(rows.valid.all(axis=1))
        best = whole if rows.score is None else whole[np.argsort(-rows.score[whole], kind="stable")]
        best = best[: self.most]
        pose = pose_of(setup, scan, q)
        turn = (setup.pose(setup.sensors[q]) if pose is None else pose)[:3, :3]
        z, R = _turned(rows.z[best], None if rows.R is None else rows.R[best], turn)
        return state, Estimate(scan.time_s, z, R, count=float(len(z)))


def _turned(z: Array, R: Array | None, turn: Array) -> tuple[Array, Array | None]:
    """In the room's axes; the same bits where the array's are those."""
    return (z, R) if np.array_equal(turn, np.eye(3)) else rotated(z, R, turn)
