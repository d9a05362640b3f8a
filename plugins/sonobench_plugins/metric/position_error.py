"""Position error of matched targets, beside the share of target time that was matched and the false estimates.

Estimates are matched to the existing targets of a frame by the assignment that minimises the sum of min(d, c)²; a pair
at c or more is no match (GOSPA's assignment at α = 2: Rahmathullah et al. 2017).

An error over matched targets speaks only of what was found. Its coverage stands beside it, and as it is undefined where
nothing was found and has no worst value, a board ranks by it only pipelines that cover all of the target time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import linear_sum_assignment

from sonobench.errors import InputError
from sonobench.protocols import Series
from sonobench.scoring import Aligned, Frame, aligned
from sonobench.types import Estimate, Space, Truth


@dataclass(frozen=True)
class PositionError:
    """Root mean square and median error of matched targets, their coverage, and false estimates per frame.

    With targets = "active" an estimate that matches an existing but silent target is neither false nor counted, and a
    silent target that nobody reports is not missed.
    """

    c_m: float = 1.0  #: gate: a pair at this distance or more is no match (m)
    targets: Literal["exists", "active"] = "active"  #: truth that counts
    hold_s: float | None = None  #: how long an estimate stands; None is 1.5 periods

    def __post_init__(self) -> None:
        if not (self.c_m > 0 and math.isfinite(self.c_m)):
            raise InputError(f"position-error: c_m is {self.c_m}; a positive gate is needed")
        if self.targets not in ("exists", "active"):
            raise InputError(f"position-error: targets is {self.targets!r}; 'exists' or 'active' is needed")

    def evaluate(self, truth: Truth, output: Sequence[Estimate], space: Space | None) -> Mapping[str, Series]:
        """Columns "" (rms) and "median" over matched target instants, "coverage", "false"."""
        pairs = aligned(truth, output, space, self.hold_s)
        found = [self._match(pairs, frame) for frame in pairs.frames]
        errors = np.concatenate([np.zeros(0), *(f[0] for f in found)])
        matched = np.array([len(f[0]) for f in found], float)
        false = np.array([f[1] for f in found], float)
        wanted = np.array([self._counted(f).sum() for f in pairs.frames], float)
        share = float(matched.sum() / wanted.sum()) if wanted.sum() > 0 else 0.0
        each = np.ones(len(errors))
        return {
            "": Series(errors, each, pairs.unit, pool="rms", coverage=share),
            "median": Series(errors, each, pairs.unit, pool="median", coverage=share),
            "coverage": Series(matched, wanted, "1", better="higher", pool="rate"),
            "false": Series(false, np.ones(len(false)), "1/frame", pool="rate"),
        }

    def _counted(self, frame: Frame) -> np.ndarray:
        return frame.active if self.targets == "active" else np.ones(len(frame.truth), bool)

    def _match(self, pairs: Aligned, frame: Frame) -> tuple[np.ndarray, int]:
        """Errors of counted targets that are matched, and the number of estimates that match no existing target."""
        distances = pairs.distances(frame)
        rows, columns = linear_sum_assignment(np.minimum(distances, self.c_m) ** 2)
        error = distances[rows, columns]
        near = error < self.c_m
        return error[near & self._counted(frame)[rows]], len(frame.estimates) - int(near.sum())
