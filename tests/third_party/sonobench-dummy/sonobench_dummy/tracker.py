"""One talker: the cell of a grid that explains most rows."""

from dataclasses import dataclass

import numpy as np

from sonobench import Estimate, SetupError, Space
from sonobench.geometry import sensor_delays


@dataclass(frozen=True)
class BestCell:
    """Holds its cell while nothing is searched, reports nobody after a miss."""

    grid_m: float = 0.2  #: side of a cell
    gate_s: float = 1e-4  #: a row this near explains a cell
    sensor: str = ""  #: what the names of the sensors begin with

    @property
    def space(self):
        return Space.of("x_m", "y_m")

    def init(self, rng, setup):
        if setup.box_m is None:
            raise SetupError("best-cell needs the room's box_m, which this recording does not tell")
        (x0, y0), (x1, y1) = setup.box_m[:, :2]
        cells = np.stack(np.meshgrid(np.arange(x0, x1, self.grid_m), np.arange(y0, y1, self.grid_m)), axis=-1).reshape(-1, 2)
        delays = {q: sensor_delays(cells, setup, q) for q in setup.of_kind("tdoa", "best-cell", self.sensor)}
        return cells, delays, np.zeros((0, 2))

    def step(self, rng, state, scan):
        cells, delays, held = state
        votes = np.zeros(len(cells))
        for q, expected in delays.items():
            z, _ = scan.rows(q)
            if len(z):
                votes += (np.abs(expected[:, None, :] - z) < self.gate_s).all(axis=-1).any(axis=1)
        if votes.any():
            held = cells[votes == votes.max()].mean(axis=0, keepdims=True)
        elif scan.searched.any():
            held = np.zeros((0, 2))
        return (cells, delays, held), Estimate(scan.time_s, held)
