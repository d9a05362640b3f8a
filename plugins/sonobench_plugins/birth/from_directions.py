"""Births along the last scan's directions, at an assumed range: a bearing says where to look, not how far.

Source: Ristic, Arulampalam & Gordon 2004, "Beyond the Kalman filter", section 6.3 (bearings-only initiation).
Deviations: two angles, and the covariance of a position is diagonal along the ray: the range's spread on it, range times the
angles' deviations across.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.errors import SetupError
from sonobench.filtering.evidence import rows_of, searched
from sonobench.filtering.kinematics import position_columns, variances
from sonobench.filtering.mixture import empty
from sonobench.filtering.steps import pose_of
from sonobench.geometry import place, unit_vector
from sonobench.protocols import BoundMeasurement, Mixture, State
from sonobench.sphere import in_arc, tangents
from sonobench.types import Array, Scan, Setup, Space


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What does not change: the setup, the measurement, and the state space."""

    setup: Setup
    measurement: BoundMeasurement
    space: Space
    columns: list[int]


@dataclass(frozen=True)
class FromDirections:
    """One Gaussian a direction of the scan, at `range_m` from its sensor and at rest."""

    weight: float = 0.1  #: expected births a direction
    range_m: float = 2.0  #: assumed distance from the sensor
    range_std_m: float = 1.0  #: its spread
    velocity_std_m_s: float = 0.5  #: spread of each velocity coordinate

    def __post_init__(self) -> None:
        if not (self.range_m > 0 and self.range_std_m > 0 and self.velocity_std_m_s >= 0 and self.weight >= 0):
            raise ValueError("range_m and range_std_m must be above 0, velocity_std_m_s and weight at least 0")

    @property
    def uses_scan(self) -> bool:
        """From rows."""
        return True

    def start(self, space: Space, setup: Setup, measurement: BoundMeasurement) -> State:
        """What the scans to come need.

        Raises:
            SetupError: the state has no position in space, or a sensor measures no directions.
        """
        who = "birth from-directions"
        columns = position_columns(space, who)
        if len(columns) != 3:
            raise SetupError(f"{who} places targets in space and needs z_m; the state space is {list(space.names)}")
        variances(space, 1.0, self.velocity_std_m_s, who)
        others = [setup.sensors[q] for q in measurement.sensors if setup.sensors[q].kind != "direction"]
        if others:
            raise SetupError(
                f"{who} reads sensors of kind 'direction'; the measurement reads {[f'{s.name} ({s.kind})' for s in others]}: use another birth"
            )
        return Known(setup, measurement, space, columns)

    def propose(self, rng: np.random.Generator, memory: Known, scan: Scan, live: Mixture) -> tuple[State, Mixture]:
        """A component a row, in an order that the rows' order cannot change; what is alive already is not looked at."""
        means, covs = [], []
        for q in searched(scan, memory.measurement.sensors):
            rows = rows_of(scan, q, 2)
            for i in np.flatnonzero(rows.valid.all(axis=1)):
                R = memory.measurement.R(q, scan) if rows.R is None else in_arc(rows.R[i], rows.z[i])
                m, P = self._placed(memory, scan, q, rows.z[i], R)
                means.append(m)
                covs.append(P)
        if not means:
            return memory, empty(len(memory.space))
        return memory, Mixture(np.full(len(means), self.weight), np.array(means), np.array(covs), np.zeros(len(means), np.int64))

    def _placed(self, memory: Known, scan: Scan, q: int, z: Array, R: Array) -> tuple[Array, Array]:
        """Mean (d,) and covariance (d, d) along a direction z whose arcs have the covariance R."""
        pose = pose_of(memory.setup, scan, q)
        pose = memory.setup.pose(memory.setup.sensors[q]) if pose is None else pose
        origin = place(pose, memory.setup.sensors[q].elements[0])
        ray, across = pose[:3, :3] @ unit_vector(z), tangents(z) @ pose[:3, :3].T
        m = np.zeros(len(memory.space))
        m[memory.columns] = origin + self.range_m * ray
        P = np.diag(variances(memory.space, 0.0, self.velocity_std_m_s, "birth from-directions"))
        spread = self.range_std_m**2 * np.outer(ray, ray) + (self.range_m**2 + self.range_std_m**2) * across.T @ R @ across
        P[np.ix_(memory.columns, memory.columns)] = spread
        return m, P
