"""Root mean square error over a whole run, as papers on tracking one talker print it, and the share of runs that lost him.

The error is a target's distance to the nearest estimate: it does not ask how many there are. A lost run dominates an average over
runs: their share stands beside it, and the run's folder keeps every run's own error (scores.parquet).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sonobench.errors import InputError
from sonobench.protocols import Series
from sonobench.scoring import aligned
from sonobench.types import Estimate, Space, Truth


@dataclass(frozen=True)
class RunError:
    """Columns "" (a run's root mean square error; boards average it over runs) and "lost" (share of runs)."""

    lost_m: float = 0.6  #: a run whose error is above is lost
    targets: Literal["exists", "active"] = "exists"  #: instants that count
    hold_s: float | None = None  #: how long an estimate stands; None is 1.5 periods

    def __post_init__(self) -> None:
        if not (self.lost_m > 0 and math.isfinite(self.lost_m)):
            raise InputError(f"run-error: lost_m is {self.lost_m}; a positive distance is needed")
        if self.targets not in ("exists", "active"):
            raise InputError(f"run-error: targets is {self.targets!r}; 'exists' or 'active' is needed")

    def evaluate(self, truth: Truth, output: Sequence[Estimate], space: Space | None) -> Mapping[str, Series]:
        """The run's error is over the instants at which there is an estimate, of each target to the nearest one; coverage is their share."""
        pairs = aligned(truth, output, space, self.hold_s)
        errors: list[float] = []
        wanted = 0
        for frame in pairs.frames:
            counted = frame.active if self.targets == "active" else np.ones(len(frame.truth), bool)
            wanted += int(counted.sum())
            if len(frame.estimates):
                errors += pairs.distances(frame).min(axis=1)[counted].tolist()
        share = len(errors) / wanted if wanted else 0.0
        found = np.array([np.sqrt(np.mean(np.square(errors)))]) if errors else np.zeros(0)
        lost = np.array([float(wanted > 0 and (not errors or found[0] > self.lost_m))])
        one = np.ones(len(found))
        return {
            "": Series(found, one, pairs.unit, pool="mean", coverage=share),
            "lost": Series(lost, np.ones(1), "1", pool="mean", worst=1.0),
        }
