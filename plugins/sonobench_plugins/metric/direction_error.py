"""Error of directions: the angle on the great circle, and its azimuth and elevation, over matched targets.

Several targets are matched by the assignment that makes the sum of squared angles least; one frame's value is the root mean square
over its matched targets. The trial's number is pooled as tables print it: rms over runs at each frame, then the mean over frames.
What was not found is not in an error over matched targets; its coverage stands beside it.
Source: Nehorai & Paldi 1994, section III (mean squared angular error); Hu, Li & Jin 2014, section 4 (RMSE by angle).
Deviations: the paper prints radians under the name of degrees; both are given here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from sonobench.directions import Look, looks, separations, window
from sonobench.errors import InputError
from sonobench.protocols import Series
from sonobench.types import Array, Estimate, Space, Truth


class Errors(NamedTuple):
    """Mean squares (frames, 3) of angle, azimuth and elevation over matched targets, and numbers (frames,) of matched and of counted targets."""

    squares: Array
    matched: Array
    counted: Array


@dataclass(frozen=True)
class DirectionError:
    """Angle between truth and estimate as seen from the array, in rad and in degrees, and its mean square."""

    c_rad: float | None = None  #: gate: a pair at this angle or more is no match; None: any pair is one
    first_step: int = 1  #: first evaluation time that counts, from 1
    last_step: int | None = None  #: last evaluation time that counts; None: the last
    targets: Literal["exists", "active"] = "exists"  #: truth that counts
    hold_s: float | None = None  #: how long an estimate stands; None is 1.5 periods

    def __post_init__(self) -> None:
        if self.c_rad is not None and not self.c_rad > 0:
            raise InputError(f"direction-error: c_rad is {self.c_rad}; a positive gate is needed")
        if self.first_step < 1 or (self.last_step is not None and self.last_step < self.first_step):
            raise InputError(f"direction-error: first_step is {self.first_step}, last_step {self.last_step}; 1 ≤ first ≤ last is needed")

    def evaluate(self, truth: Truth, output: Sequence[Estimate], space: Space | None) -> Mapping[str, Series]:
        """Columns "" (rad), "azimuth", "elevation", the same in degrees ("deg", "azimuth_deg", "elevation_deg"), and "msae" (rad²)."""
        seen = looks(truth, output, space, self.hold_s, self.targets)
        errors = self.errors(seen)
        weight = (errors.matched > 0).astype(float)
        share = float(errors.matched.sum() / errors.counted.sum()) if errors.counted.sum() > 0 else 0.0
        columns = {}
        for column, name in enumerate(("", "azimuth", "elevation")):
            rad = np.sqrt(errors.squares[:, column])
            columns[name] = Series(rad, weight, "rad", pool="frame-rms", coverage=share)
            columns[f"{name}_deg" if name else "deg"] = Series(np.degrees(rad), weight, "°", pool="frame-rms", coverage=share)
        columns["msae"] = Series(errors.squares[:, 0], weight, "rad²", coverage=share)
        return columns

    def errors(self, seen: Sequence[Look]) -> Errors:
        """Frame by frame; nothing outside the window."""
        inside = window(len(seen), self.first_step, self.last_step)
        rows = [self._frame(look) if counts else (0.0,) * 5 for look, counts in zip(seen, inside, strict=True)]
        table = np.array(rows, float).reshape(-1, 5)
        return Errors(table[:, :3], table[:, 3], table[:, 4])

    def _frame(self, look: Look) -> tuple[float, float, float, float, float]:
        of, to = look.matched()
        z, z_hat = look.truth[of], look.estimates[to]
        angle = separations(z_hat, z)
        near = np.ones(len(of), bool) if self.c_rad is None else angle < self.c_rad
        turn = np.remainder(z_hat[:, 0] - z[:, 0] + math.pi, 2 * math.pi) - math.pi
        squares = np.stack([angle, turn, z_hat[:, 1] - z[:, 1]])[:, near] ** 2
        mean = squares.mean(axis=1) if near.any() else np.zeros(3)
        return float(mean[0]), float(mean[1]), float(mean[2]), float(near.sum()), float(len(look.truth))
