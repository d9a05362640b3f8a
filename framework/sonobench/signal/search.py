"""Where in a room the steered response power is highest: a grid of precomputed table columns, then a finer local grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonobench.errors import SetupError
from sonobench.geometry import pair_delays
from sonobench.signal.correlation import TablePlan
from sonobench.signal.peaks import refine
from sonobench.signal.rig import Rig
from sonobench.signal.steering import grid
from sonobench.types import Array, Bools, Floats, Header, Ints

Tables = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Picked:
    """A position of high steered power as its pairs saw it.

    Attributes:
        position: (3,) m in the room.
        power: mean of the tables over the pairs that were heard.
        delay_s: (P,) delay of each pair's own peak; the position's delay where there is none.
        valid: (P,) whether the pair has a peak.
    """

    position: Array
    power: float
    delay_s: Array
    valid: Bools


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """A grid over a room for tables of one plan.

    Attributes:
        points: (G, 3) m.
        columns: (P, G) int32, the nearest table column of each pair at each point.
        offsets: (g, 3) m of the finer grid.
        elements, pairs, c_m_s: the rig in the room.
        start_s, step_s: of the tables.
        width: columns from a correlation peak to its first zero.
    """

    points: Array
    columns: NDArray[np.int32]
    offsets: Array
    elements: Array
    pairs: Ints
    c_m_s: float
    start_s: float
    step_s: float
    width: float

    def power(self, tables: Tables) -> NDArray[np.float32]:
        """Sum of tables (P, lags) over pairs at every point of the grid (G,)."""
        from sonobench.signal._kernels import look_up

        out = np.empty(len(self.points), np.float32)
        look_up(tables, self.columns, out)
        return out

    def strongest(self, tables: Tables, heard: int, taken: Sequence[Array], radius_m: float) -> tuple[Array, float]:
        """Position (3,) of the highest power not within radius_m of the `taken` ones, and the power over `heard` pairs."""
        power = self.power(tables)
        for other in taken:
            power[np.sum((self.points - other) ** 2, axis=1) < radius_m**2] = -np.inf
        near = self.points[int(np.argmax(power))] + self.offsets
        fine = _interpolated(tables, self._columns(near)).sum(axis=-1)
        best = int(np.argmax(fine))
        return near[best], float(fine[best]) / heard if np.isfinite(power).any() else -np.inf

    def read(self, tables: Tables, position: Array, power: float, window_s: float, least: float) -> Picked:
        """Each pair's highest local maximum ≥ least within window_s of the position's delay."""
        expected = self._columns(position)
        reach = max(1, int(np.ceil(window_s / self.step_s)))
        column = np.clip(np.rint(expected).astype(np.int64)[:, None] + np.arange(-reach, reach + 1), 1, tables.shape[1] - 2)
        row = np.arange(len(tables))[:, None]
        middle, left, right = tables[row, column], tables[row, column - 1], tables[row, column + 1]
        height = np.where((middle > left) & (middle >= right), middle, np.float32(-1.0))
        best = np.argmax(height, axis=1)[:, None]
        offset, _ = refine(*(np.take_along_axis(a, best, 1)[:, 0] for a in (left, middle, right)))
        valid = np.take_along_axis(height, best, 1)[:, 0] >= least
        at = np.where(valid, np.take_along_axis(column, best, 1)[:, 0] + offset, expected)
        return Picked(position, power, self.start_s + self.step_s * at, valid)

    def without(self, tables: Tables, found: Picked) -> Tables:
        """The tables with the peaks of a pick taken out: nothing within width / 2 of each, untouched from 3 width / 2 on."""
        at = (found.delay_s - self.start_s) / self.step_s
        distance = np.abs(np.arange(tables.shape[1]) - at[:, None]) / self.width
        keep = np.where(found.valid[:, None], np.clip(distance - 0.5, 0.0, 1.0), 1.0)
        return (tables * keep).astype(np.float32)

    def _columns(self, points: Array) -> Floats:
        return (pair_delays(points, self.elements, self.pairs, self.c_m_s) - self.start_s) / self.step_s


def open_search(unit: Rig, header: Header, plan: TablePlan, grid_m: float, height_m: float | None) -> Search:
    """The search of a recording's room, in the plane at height_m or, with None, in the whole room.

    Raises:
        SetupError: the room is unknown, or the grid has no spacing or too many points.
    """
    if header.box_m is None:
        raise SetupError(f"a search needs a room; recording {header.name} has no box_m")
    size = header.box_m[1] - header.box_m[0]
    cells = np.prod(size[: 2 if height_m is not None else 3] / grid_m) if grid_m > 0.0 else np.inf
    if not cells <= 2e6:
        raise SetupError(f"grid_m {grid_m} cuts a room of {size.tolist()} m into {cells:.3g} cells; 2e6 are allowed")
    points = grid(header.box_m, grid_m, height_m)
    step = np.arange(-2, 3) * grid_m / 4.0
    local = np.stack(np.meshgrid(step, step, [0.0] if height_m is not None else step, indexing="ij"), axis=-1).reshape(-1, 3)
    columns = (pair_delays(points, unit.room, unit.pairs, header.c_m_s) - plan.start_s) / plan.step_s
    nearest = np.ascontiguousarray(np.rint(columns).T, np.int32)
    width = 1.0 / (2.0 * plan.high_hz) / plan.step_s
    return Search(points, nearest, local, unit.room, unit.pairs, header.c_m_s, plan.start_s, plan.step_s, width)


def _interpolated(tables: Tables, column: Any) -> Floats:
    low = np.clip(column.astype(np.int64), 0, tables.shape[1] - 2)
    share, row = column - low, np.arange(len(tables))
    return tables[row, low] * (1.0 - share) + tables[row, low + 1] * share
