"""OSPA between sets of directions, with the angle on the great circle as distance.

Source: Schuhmacher, Vo & Vo 2008, eq. 3 and 4 (see `ospa`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sonobench.directions import looks
from sonobench.errors import InputError
from sonobench.protocols import Series
from sonobench.types import Estimate, Space, Truth
from sonobench_plugins.metric.ospa import ospa


@dataclass(frozen=True)
class OspaDirection:
    """OSPA per frame in degrees, with its localisation and cardinality parts; the trial's number is the mean over frames."""

    p: float = 1.0  #: order, 1 to inf
    c_deg: float = 5.0  #: cut-off
    targets: Literal["exists", "active"] = "exists"  #: truth that counts
    hold_s: float | None = None  #: how long an estimate stands; None is 1.5 periods

    def __post_init__(self) -> None:
        if not self.p >= 1:
            raise InputError(f"ospa-direction: p is {self.p}; 1 or more (or inf) is needed for a metric")
        if not (self.c_deg > 0 and math.isfinite(self.c_deg)):
            raise InputError(f"ospa-direction: c_deg is {self.c_deg}; a positive cut-off is needed")

    def evaluate(self, truth: Truth, output: Sequence[Estimate], space: Space | None) -> Mapping[str, Series]:
        """Columns "", "localisation", "cardinality", in degrees."""
        seen = looks(truth, output, space, self.hold_s, self.targets)
        parts = np.array([ospa(np.degrees(look.angles()), self.c_deg, self.p) for look in seen]).reshape(-1, 3)
        ones = np.ones(len(parts))
        return {name: Series(column, ones, "°") for name, column in zip(("", "localisation", "cardinality"), parts.T, strict=True)}
