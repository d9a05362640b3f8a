"""Errors of the number of targets.

Source: Chen et al. 2012, eq. 45, for the average relative error (ARE): E{ ||X̂| − |X|| / |X| }.
Deviations: eq. 45 is undefined in frames without a target; here the error is divided by max(|X|, 1), so that false
estimates in such frames count, and the value equals eq. 45 wherever that is defined.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sonobench.protocols import Series
from sonobench.scoring import aligned
from sonobench.types import Estimate, Space, Truth


@dataclass(frozen=True)
class Cardinality:
    """Mean absolute error of the number of targets, its bias (signed mean), and the average relative error.

    The number is that of reported rows, not Estimate.count. `bias` is better lower only in size; read it, do not rank by it.
    """

    targets: Literal["exists", "active"] = "exists"  #: truth that counts
    hold_s: float | None = None  #: how long an estimate stands; None is 1.5 periods

    def evaluate(self, truth: Truth, output: Sequence[Estimate], space: Space | None) -> Mapping[str, Series]:
        """Columns "" (|n̂ − n|), "bias" (n̂ − n), "are" (|n̂ − n| / max(n, 1))."""
        frames = aligned(truth, output, space, self.hold_s, (), self.targets).frames
        n = np.array([len(f.truth) for f in frames], float)
        excess = np.array([len(f.estimates) for f in frames], float) - n
        ones = np.ones(len(n))
        return {
            "": Series(np.abs(excess), ones, "1"),
            "bias": Series(excess, ones, "1"),
            "are": Series(np.abs(excess) / np.maximum(n, 1), ones, "1"),
        }
