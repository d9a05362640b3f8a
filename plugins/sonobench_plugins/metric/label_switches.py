"""How often targets change their labels, and how often their tracks break.

In each frame, a target keeps the estimate of the label that it last had, if that is nearer than the gate; the other targets and estimates are
matched by the assignment that minimises the sum of min(d, c)², a pair at c or more being no match.
- A switch: a matched target whose label is another than when it was matched last.
- A fragment: a target that is matched again after frames in which it existed and was not.

Source: Bernardin & Stiefelhagen 2008, "Evaluating multiple object tracking performance: the CLEAR MOT metrics", section 2.1.4 (switches); Li, Huang &
Nevatia 2009, "Learning to associate: hybridboosted multi-target tracker for crowded scene" (fragments).
Deviations: matching is by squared distances, as in the metric position-error. Unlabelled estimates are no tracks: the metric is then
undefined (NaN, coverage 0). As its coverage says, it speaks of what was matched: nobody found is nobody confused.
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
from sonobench.scoring import Frame, aligned
from sonobench.types import Array, Estimate, Space, Truth


@dataclass(frozen=True)
class LabelSwitches:
    """Label switches and broken tracks, in all per target."""

    c_m: float = 1.0  #: gate: a pair at this distance or more is no match (m; rad for directions)
    targets: Literal["exists", "active"] = "exists"  #: truth that counts
    hold_s: float | None = None  #: how long an estimate stands; None is 1.5 periods

    def __post_init__(self) -> None:
        if not (self.c_m > 0 and math.isfinite(self.c_m)):
            raise InputError(f"label-switches: c_m is {self.c_m}; a positive gate is needed")

    def evaluate(self, truth: Truth, output: Sequence[Estimate], space: Space | None) -> Mapping[str, Series]:
        """Columns "" (switches) and "fragments", one value a target that was ever there."""
        pairs = aligned(truth, output, space, self.hold_s, targets=self.targets)
        names = sorted({int(n) for f in pairs.frames for n in f.truth_labels})
        counts = {n: [0, 0] for n in names}
        last: dict[int, int] = {}
        lost: set[int] = set()
        matched = wanted = 0
        if any(f.labels is None for f in pairs.frames):
            return self._columns(np.full((len(names), 2), np.nan), np.zeros(len(names)), 0.0)
        for frame in pairs.frames:
            now = matches(frame, pairs.distances(frame), self.c_m, last)
            for name, label in now.items():
                counts[name][0] += last.get(name, label) != label
                counts[name][1] += name in lost
            lost = (lost | {int(n) for n in frame.truth_labels if int(n) in last and int(n) not in now}) - now.keys()
            last.update(now)
            matched, wanted = matched + len(now), wanted + len(frame.truth_labels)
        share = matched / wanted if wanted else 1.0
        return self._columns(np.array([counts[n] for n in names], float).reshape(-1, 2), np.ones(len(names)), share)

    def _columns(self, values: Array, weights: Array, share: float) -> Mapping[str, Series]:
        return {
            name: Series(column, weights, "1/target", pool="rate", coverage=share)
            for name, column in zip(("", "fragments"), values.T, strict=True)
        }


def matches(frame: Frame, distances: Array, c: float, last: Mapping[int, int]) -> dict[int, int]:
    """Label of the estimate that each matched target of a frame has, by the target's own.

    Args:
        frame: with labels on both sides.
        distances: (n, m) of its rows.
        c: gate; a pair at this distance or more is no match.
        last: the labels that targets had when they were matched last.
    """
    own, labels = [int(n) for n in frame.truth_labels], [int(n) for n in np.asarray(frame.labels)]
    kept = [(i, labels.index(last[n])) for i, n in enumerate(own) if n in last and last[n] in labels]
    rest = distances.copy()
    now: dict[int, int] = {}
    for i, j in sorted(kept, key=lambda pair: distances[pair]):
        if distances[i, j] < c and labels[j] not in now.values():
            now[own[i]] = labels[j]
            rest[i], rest[:, j] = np.inf, np.inf
    for i, j in zip(*linear_sum_assignment(np.minimum(rest, c) ** 2), strict=True):
        if rest[i, j] < c:
            now[own[i]] = labels[j]
    return now
