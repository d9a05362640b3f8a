"""Births at this scan's own position measurements, where nobody is known yet.

Source: Ristic, Clark, Vo & Vo 2012, "Adaptive target birth intensity for PHD and CPHD filters", for births driven by measurements;
Reuter, Vo, Vo & Dietmayer 2014, "The labeled multi-Bernoulli filter", section IV-C, for leaving out rows that a live target explains.
Deviations: the births of a scan join after its update, so that the next scan is the first that can confirm them. Only rows with all
their components place a target.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sonobench.errors import SetupError
from sonobench.filtering.evidence import rows_of, searched
from sonobench.filtering.kinematics import position_columns, variances
from sonobench.filtering.mixture import empty, take, union
from sonobench.protocols import BoundMeasurement, Mixture, State
from sonobench.types import Array, Bools, Scan, Setup, Space


class Known(NamedTuple):
    """What `propose` needs of the setup: the models, the measured columns of a state by sensor, its variances where nothing is measured."""

    measurement: BoundMeasurement
    setup: Setup
    columns: dict[int, list[int]]
    spread: Array


@dataclass(frozen=True)
class FromPositions:
    """Births from detected positions, at rest in the mean; memory is what the setup says."""

    weight: float = 0.1  #: expected births a scan, shared by the scan's proposals
    gate: float = 0.99  #: probability that a measurement of a target lies within its gate
    taken_weight: float = 0.3  #: components above count as live targets
    velocity_std_m_s: float = 0.5  #: spread of each velocity coordinate

    def __post_init__(self) -> None:
        if not (0 < self.gate < 1 and self.weight >= 0 and self.velocity_std_m_s >= 0):
            raise ValueError(
                f"gate {self.gate} must lie in (0, 1), weight {self.weight} and velocity_std_m_s {self.velocity_std_m_s} be at least 0"
            )

    @property
    def uses_scan(self) -> bool:
        """The scan's own measurements."""
        return True

    def start(self, space: Space, setup: Setup, measurement: BoundMeasurement) -> State:
        """Look up what the sensors measure of a state.

        Raises:
            SetupError: a sensor of another kind, or one that does not measure the whole position.
        """
        who = "birth from-positions"
        wanted = position_columns(space, who)
        columns = {}
        for q in measurement.sensors:
            unit = setup.sensors[q]
            if unit.kind != "position" or sorted(space.index(*unit.space.names)) != sorted(wanted):
                names = [space.names[i] for i in wanted]
                raise SetupError(
                    f"{who} needs sensors of kind 'position' that measure {names}; {unit.name} is {unit.kind!r} and measures "
                    f"{list(unit.space.names)} (birth from-detections searches the room for where delays agree)"
                )
            columns[q] = space.index(*unit.space.names)
        return Known(measurement, setup, columns, variances(space, 0.0, self.velocity_std_m_s, who))

    def propose(self, rng: np.random.Generator, memory: State, scan: Scan, live: Mixture) -> tuple[State, Mixture]:
        """A component at each row that no live target explains, as uncertain as the row."""
        known: Known = memory
        targets = take(live, live.w > self.taken_weight)
        born = empty(len(known.spread))
        for q in searched(scan, known.measurement.sensors):
            born = union(born, self._unexplained(known, scan, q, targets))
        n = len(born.w)
        return memory, born._replace(w=np.full(n, self.weight / max(n, 1)))

    def _unexplained(self, known: Known, scan: Scan, q: int, targets: Mixture) -> Mixture:
        columns = known.columns[q]
        rows = rows_of(scan, q, len(columns))
        whole = rows.valid.all(axis=1)
        z = rows.z[whole]
        R = np.broadcast_to(known.measurement.R(q, scan), (len(z), len(columns), len(columns))) if rows.R is None else rows.R[whole]
        free: Bools = np.ones(len(z), bool)
        if len(targets.w) and len(z):
            off = z - targets.m[:, None, columns]
            S = targets.P[:, columns][:, :, columns][:, None] + R
            free = np.all(_squared(off, S) > _chi2(self.gate, len(columns)), axis=0)
        n = int(free.sum())
        m, P = np.zeros((n, len(known.spread))), np.tile(np.diag(known.spread), (n, 1, 1))
        m[:, columns] = z[free]
        P[:, np.array(columns)[:, None], columns] = R[free]
        return Mixture(np.ones(n), m, P, np.zeros(n, np.int64))


def _squared(off: Array, S: Array) -> Array:
    """Squared Mahalanobis distances (J, m) of (J, m, dz) by covariances (J, m, dz, dz)."""
    return np.einsum("jmd,jmd->jm", off, np.linalg.solve(S, off[..., None])[..., 0])


def _chi2(probability: float, n: int) -> float:
    """Quantile of the chi-squared distribution of n degrees of freedom."""
    from scipy.special import gammaincinv

    return float(2 * gammaincinv(n / 2, probability))
