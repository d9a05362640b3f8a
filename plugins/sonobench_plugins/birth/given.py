"""Births where the recording says that targets may appear; its board entry is marked, for it was told.

Source: Vo & Ma 2006, eq. 15.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np

from sonobench.errors import SetupError
from sonobench.filtering.kinematics import position_columns, variances
from sonobench.filtering.mixture import take
from sonobench.protocols import BoundMeasurement, Mixture, State
from sonobench.types import Scan, Setup, Space

#: the columns of `starts`, as scenes give them
_STARTS = ("t_s", "x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s")


@dataclass(frozen=True)
class Given:
    """A Gaussian at every row of a `given` array, in every scan; memory is the mixture."""

    name: str = "births"  #: the given array, (n, d) states (turn rates may be left out), or (n, 2 or 3) positions born at rest; "starts": rows t, x, y, z, vx, vy, vz
    weight: float = 0.1  #: expected births a scan at each row
    position_std_m: float = 0.1  #: spread of each position coordinate
    velocity_std_m_s: float = 0.3  #: spread of each velocity coordinate
    once: int = 0  #: this many leading rows exist at the recording's start, and are not born later

    @property
    def uses_scan(self) -> bool:
        """A prior."""
        return False

    def start(self, space: Space, setup: Setup, measurement: BoundMeasurement) -> State:
        """The mixture.

        Raises:
            SetupError: the array is not offered, or its rows fit neither states nor positions.
        """
        who = "birth given"
        if self.name not in setup.given:
            has = f"asked for {sorted(setup.given)}" if setup.given else "asked for nothing"
            raise SetupError(
                f"{who} reads given {self.name!r}; the pipeline {has}: write given = [{json.dumps(self.name)}] beside its front_end and tracker"
            )
        rows = setup.given[self.name]
        if self.name == "starts" and rows.ndim == 2 and rows.shape[1] == len(_STARTS):
            rows = rows[:, [_STARTS.index(n) for n in space.names if n in _STARTS]]
        columns = position_columns(space, who)
        moving = [i for i, name in enumerate(space.names) if name.endswith(("_m", "_m_s"))]
        if rows.ndim != 2 or rows.shape[1] not in (len(space), len(moving), len(columns), 3):
            raise SetupError(
                f"{who}: given {self.name!r} has shape {rows.shape}; (n, {len(space)}) states, (n, {len(moving)}) positions and velocities, "
                f"or (n, {len(columns)}) are needed"
            )
        if not 0 <= self.once <= len(rows):
            raise SetupError(f"{who}: once is {self.once}; given {self.name!r} has {len(rows)} rows")
        own = {len(space): list(range(len(space))), len(moving): moving}.get(rows.shape[1], columns)
        m = np.zeros((len(rows), len(space)))
        m[:, own] = rows[:, : len(own)]
        P = np.diag(variances(space, self.position_std_m, self.velocity_std_m_s, who))
        n = len(m)
        return Mixture(np.full(n, self.weight), m, np.tile(P, (n, 1, 1)), np.zeros(n, np.int64))

    def propose(self, rng: np.random.Generator, memory: State, scan: Scan, live: Mixture) -> tuple[State, Mixture]:
        """The rows after `once`."""
        return memory, take(memory, np.arange(self.once, len(memory.w)))

    def initial(self, memory: State) -> Mixture:
        """The first `once` rows."""
        return take(memory, np.arange(self.once))
