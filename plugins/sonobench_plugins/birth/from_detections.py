"""Births where this scan's own measurements point and nobody is known yet.

A coarse grid over the room finds the place that most measurements agree on, Gauss-Newton refines it, its rows are taken
away, and so on. A stacked row agrees in all its components at once; single rows of several sensors must meet at a place.
Rows that a live target explains are left out first, so that it is not born again.
Source: the idea is that of Ristic, Clark, Vo & Vo 2012, "Adaptive target birth intensity for PHD and CPHD filters" and,
for leaving out what is explained, Reuter, Vo, Vo & Dietmayer 2014, "The labeled multi-Bernoulli filter", section IV-C.
Deviations: delays have no inverse in closed form, hence the search. The births of a scan join after its update, so the next
scan is the first that can confirm them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sonobench.errors import SetupError
from sonobench.filtering.evidence import Rows, rows_of, searched
from sonobench.filtering.kinematics import position_columns, variances
from sonobench.filtering.mixture import empty, take, union
from sonobench.filtering.steps import pose_of
from sonobench.protocols import BoundMeasurement, Mixture, State
from sonobench.types import Array, Bools, Floats, Scan, Setup, Space

_ITERATIONS = 8
_SETTLED_M = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """What `propose` needs of the setup.

    Attributes:
        measurement, setup: the models.
        columns: of the position in a state.
        box_m: the room.
        step_m: (axes,) widths of the grid's cells.
        x: (G, d) states on the grid.
        spread: (d,) variances of a birth's velocity.
        still: by sensor, its images of the grid (see `_images`) while the arrays stand where the setup says.
    """

    measurement: BoundMeasurement
    setup: Setup
    columns: list[int]
    box_m: Array
    step_m: Array
    x: Array
    spread: Array
    still: Mapping[int, tuple[Floats, Array]]


@dataclass(frozen=True)
class FromDetections:
    """Births from the scan's detections; memory is the grid."""

    weight: float = 0.05  #: expected births of each proposal
    grid_m: float = 0.25  #: width of the search grid's cells, at most
    agree: int | None = None  #: delays (components of rows) that must meet at a place; None: one more than the axes
    gate: float = 0.99  #: probability that a measurement of a target lies within its gate
    most: int = 4  #: proposals a scan
    apart_m: float = 0.4  #: no birth nearer than this to a live target
    taken_weight: float = 0.3  #: components above count as live targets
    velocity_std_m_s: float = 0.5  #: spread of each velocity coordinate, at rest in the mean

    def __post_init__(self) -> None:
        if not (self.grid_m > 0 and 0 < self.gate < 1 and self.weight >= 0):
            raise ValueError(f"grid_m {self.grid_m} and gate {self.gate} must be above 0, gate below 1, weight {self.weight} at least 0")

    @property
    def uses_scan(self) -> bool:
        """The scan's own measurements."""
        return True

    def start(self, space: Space, setup: Setup, measurement: BoundMeasurement) -> State:
        """The grid.

        Raises:
            SetupError: no box, no position in the state, or too few components to place a target.
        """
        who = "birth from-detections"
        if setup.box_m is None:
            raise SetupError(f"{who} searches the room and needs its box; the recording is in free field or does not say")
        columns = position_columns(space, who)
        parts = sum(len(setup.sensors[q].space) for q in measurement.sensors)
        if parts < self._needed(columns):
            raise SetupError(f"{who} needs {self._needed(columns)} components that agree on a place; its sensors have {parts} together")
        box = setup.box_m[:, : len(columns)]
        counts = np.maximum(np.ceil((box[1] - box[0]) / self.grid_m).astype(int), 1)
        step = (box[1] - box[0]) / counts
        axes = [lo + (np.arange(n) + 0.5) * s for lo, n, s in zip(box[0], counts, step, strict=True)]
        x = np.zeros((int(np.prod(counts)), len(space)))
        x[:, columns] = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(columns))
        spread = variances(space, 0.0, self.velocity_std_m_s, who)
        still = {q: _images(measurement, x, step, columns, q, None) for q in measurement.sensors}
        return Grid(measurement=measurement, setup=setup, columns=columns, box_m=box, step_m=step, x=x, spread=spread, still=still)

    def _needed(self, columns: list[int]) -> int:
        return len(columns) + 1 if self.agree is None else self.agree

    def propose(self, rng: np.random.Generator, memory: State, scan: Scan, live: Mixture) -> tuple[State, Mixture]:
        """Components at rest, one for each place on which enough unexplained components agree."""
        grid: Grid = memory
        targets = take(live, live.w > self.taken_weight)
        places = [_Sensor.of(grid, scan, q, targets, self.gate) for q in searched(scan, grid.measurement.sensors)]
        born = empty(grid.x.shape[1])
        for _ in range(2 * self.most):
            found = self._best(grid, places)
            if found is None or len(born.w) >= self.most:
                break
            start, used = found
            component = self._refined(grid, scan, start, places, used)
            for place, row in zip(places, used, strict=True):
                if row is not None:
                    place.d2[:, row] = np.inf
            if component is not None and not _near(component, union(targets, born), grid.columns, self.apart_m):
                born = union(born, component)
        return grid, born

    def _best(self, grid: Grid, places: list[_Sensor]) -> tuple[Array, list[int | None]] | None:
        """The grid state that most components agree on, and the row of each sensor that does; None where too few agree."""
        cost, agreeing = np.zeros(len(grid.x)), np.zeros(len(grid.x))
        for place in places:
            if place.d2.shape[1]:
                row = np.argmin(place.d2 / place.limit, axis=1)
                ratio = np.take_along_axis(place.d2 / place.limit, row[:, None], axis=1)[:, 0]
                agreeing += np.where(ratio <= 1, place.rows.valid.sum(axis=1)[row], 0)
                cost += np.minimum(ratio, 1.0)
            else:
                cost += 1.0
        g = int(np.argmin(np.where(agreeing >= self._needed(grid.columns), cost - agreeing, np.inf)))
        if agreeing[g] < self._needed(grid.columns):
            return None
        used: list[int | None] = []
        for place in places:
            ratio = place.d2[g] / place.limit
            used.append(int(np.argmin(ratio)) if len(ratio) and ratio.min() <= 1 else None)
        return grid.x[g], used

    def _refined(self, grid: Grid, scan: Scan, start: Array, places: list[_Sensor], used: list[int | None]) -> Mixture | None:
        """Gauss-Newton within the room from a grid state; None where the rows do not fit a place after all."""
        columns = grid.columns
        x = start.copy()
        rows = [_Used.of(grid, scan, place, row) for place, row in zip(places, used, strict=True) if row is not None]
        prior = np.diag(12 / (grid.box_m[1] - grid.box_m[0]) ** 2)  # the room bounds what the rows leave open
        for _ in range(_ITERATIONS):
            r, J = _stack(grid, x, rows)
            step = np.linalg.solve(J.T @ J + prior, J.T @ r)
            x[columns] = np.clip(x[columns] + step, *grid.box_m)
            if np.abs(step).max() < _SETTLED_M:
                break
        r, J = _stack(grid, x, rows)
        if r @ r > _chi2(self.gate, len(r) - len(columns) if len(r) > len(columns) else 1):
            return None
        P = np.diag(grid.spread)
        P[np.ix_(columns, columns)] = np.linalg.inv(J.T @ J + prior)
        return Mixture(np.array([self.weight]), x[None], P[None], np.zeros(1, np.int64))


@dataclass(frozen=True, slots=True, eq=False)
class _Sensor:
    """One searched sensor's unexplained rows: squared distances d2 (G, m) to the grid's cells and their gates limit (m,)."""

    q: int
    rows: Rows
    d2: Array
    limit: Array

    @classmethod
    def of(cls, grid: Grid, scan: Scan, q: int, targets: Mixture, gate: float) -> _Sensor:
        model, pose = grid.measurement, pose_of(grid.setup, scan, q)
        rows = rows_of(scan, q, len(grid.setup.sensors[q].space))
        noise = np.diag(model.R(q, scan)) if rows.R is None else np.diagonal(rows.R, axis1=1, axis2=2)
        limit = np.array([_chi2(gate, int(v.sum())) for v in rows.valid])
        if len(targets.w) and len(rows.z):
            H = model.jacobian(targets.m, q, pose)[:, 0]
            extra = np.einsum("jzd,jde,jze->jz", H, targets.P, H)
            explained = _squared(model, rows, model.h(targets.m, q, pose)[:, 0], q, noise + extra[:, None]) <= limit
            free = ~explained.any(axis=0)
            rows, limit = Rows(rows.z[free], None if rows.R is None else rows.R[free], rows.valid[free]), limit[free]
            noise = noise if rows.R is None else noise[free]
        z_hat, slack = grid.still[q] if pose is None else _images(model, grid.x, grid.step_m, grid.columns, q, pose)
        return cls(q=q, rows=rows, d2=_squared(model, rows, z_hat, q, noise + slack), limit=limit)


@dataclass(frozen=True, slots=True, eq=False)
class _Used:
    """One row that places a birth: its valid components z, and the inverse root of their noise."""

    q: int
    pose: Array | None
    z: Array
    valid: Bools
    white: Array

    @classmethod
    def of(cls, grid: Grid, scan: Scan, place: _Sensor, row: int) -> _Used:
        q, rows, valid = place.q, place.rows, place.rows.valid[row]
        R = (grid.measurement.R(q, scan) if rows.R is None else rows.R[row])[np.ix_(valid, valid)]
        white = np.linalg.inv(np.linalg.cholesky(R))
        return cls(q=q, pose=pose_of(grid.setup, scan, q), z=rows.z[row], valid=valid, white=white)


def _images(model: BoundMeasurement, x: Array, step_m: Array, columns: list[int], q: int, pose: Array | None) -> tuple[Floats, Array]:
    """Images (G, dz) of the grid's states, and variances (G, 1, dz): the place may be anywhere in the cell."""
    H = model.jacobian(x, q, pose)[:, 0][..., columns]
    return model.h(x, q, pose)[:, 0], (H**2 @ (step_m**2 / 12))[:, None]


def _squared(model: BoundMeasurement, rows: Rows, z_hat: Floats, q: int, variance: Floats) -> Array:
    """Squared distances (n, m) of the rows' valid components from images (n, dz), by component variances (n, m or 1, dz)."""
    residual = model.residual(rows.z, z_hat[:, None, :], q)
    return np.asarray(np.sum(np.where(rows.valid, residual**2 / variance, 0.0), axis=-1))


def _stack(grid: Grid, x: Array, rows: list[_Used]) -> tuple[Array, Array]:
    """Whitened residuals (n,) and their Jacobian (n, axes) of the used rows at a state."""
    model, residuals, slopes = grid.measurement, [], []
    for row in rows:
        residuals.append(row.white @ model.residual(row.z, model.h(x, row.q, row.pose)[0], row.q)[row.valid])
        slopes.append(row.white @ model.jacobian(x, row.q, row.pose)[0][row.valid][:, grid.columns])
    return np.concatenate(residuals), np.concatenate(slopes)


def _near(component: Mixture, others: Mixture, columns: list[int], apart_m: float) -> bool:
    """Whether one of the other components lies nearer than apart_m."""
    return bool((np.linalg.norm((others.m - component.m)[:, columns], axis=1) < apart_m).any())


def _chi2(probability: float, n: int) -> float:
    """Quantile of the chi-squared distribution of n degrees of freedom."""
    from scipy.special import gammaincinv

    return float(2 * gammaincinv(n / 2, probability))
