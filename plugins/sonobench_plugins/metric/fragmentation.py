"""Into how many pieces the tracks of targets are cut, and how long the longest is.

Targets and labelled estimates are matched frame by frame as in the metric label-switches. A piece is a run of frames in which a target exists
and is matched with one label, without a frame between in which it exists and is not; while it is away, a piece lasts.
- pieces beyond the first, per target: 0 is a target followed under one label from first to last match, or one that was never matched;
- longest: the share of the target's frames that its longest piece covers, 0 for one that was never matched;
- strays: labels that never matched a target, per target.

Source: Blackman & Popoli 1999, "Design and Analysis of Modern Tracking Systems", section 13 (track continuity and breaks); Bernardin &
Stiefelhagen 2008 for the matching.
Unlabelled estimates are no tracks: the metric is then undefined (NaN, coverage 0).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sonobench.errors import InputError
from sonobench.protocols import Series
from sonobench.scoring import Aligned, aligned
from sonobench.types import Estimate, Space, Truth
from sonobench_plugins.metric.label_switches import matches


@dataclass(frozen=True)
class Fragmentation:
    """Pieces of tracks, per target."""

    c_m: float = 1.0  #: gate: a pair at this distance or more is no match (m; rad for directions)
    targets: Literal["exists", "active"] = "exists"  #: truth that counts
    hold_s: float | None = None  #: how long an estimate stands; None is 1.5 periods

    def __post_init__(self) -> None:
        if not (self.c_m > 0 and math.isfinite(self.c_m)):
            raise InputError(f"fragmentation: c_m is {self.c_m}; a positive gate is needed")

    def evaluate(self, truth: Truth, output: Sequence[Estimate], space: Space | None) -> Mapping[str, Series]:
        """Columns "" (pieces beyond the first), "longest" and "strays"; of the first two one value a target that was ever there."""
        pairs = aligned(truth, output, space, self.hold_s, targets=self.targets)
        names = sorted({int(n) for f in pairs.frames for n in f.truth_labels})
        if any(f.labels is None for f in pairs.frames):
            nan, none = np.full(len(names), np.nan), np.zeros(len(names))
            return self._columns((nan, nan, nan), none, 0.0)
        lengths, lives, strays, share = _pieces(pairs, self.c_m)
        beyond = np.array([max(len(lengths[n]) - 1, 0) for n in names], float)
        longest = np.array([max(lengths[n], default=0) / lives[n] for n in names], float)
        return self._columns((beyond, longest, np.full(len(names), strays / max(len(names), 1))), np.ones(len(names)), share)

    def _columns(self, values: tuple[np.ndarray, ...], weights: np.ndarray, share: float) -> Mapping[str, Series]:
        beyond, longest, strays = values
        whole = 1.0 if share > 0 or len(weights) == 0 or weights.any() else 0.0
        return {
            "": Series(beyond, weights, "1/target", pool="rate", coverage=share),
            "longest": Series(longest, weights, "1", better="higher", coverage=whole),
            "strays": Series(strays, weights, "1/target", pool="rate", coverage=whole),
        }


def _pieces(pairs: Aligned, c: float) -> tuple[dict[int, list[int]], dict[int, int], int, float]:
    """Lengths of every target's pieces, its frames, the number of labels never matched, and the share of target frames that are matched."""
    lengths: dict[int, list[int]] = {}
    lives: dict[int, int] = {}
    last: dict[int, int] = {}
    open_now: dict[int, int] = {}
    seen: set[int] = set()
    used: set[int] = set()
    for frame in pairs.frames:
        now = matches(frame, pairs.distances(frame), c, last)
        for name in map(int, frame.truth_labels):
            own = lengths.setdefault(name, [])
            lives[name] = lives.get(name, 0) + 1
            if name not in now:
                open_now.pop(name, None)
                continue
            if open_now.get(name) != now[name]:
                own.append(0)
            own[-1] += 1
            open_now[name] = now[name]
        last.update(now)
        seen |= {int(n) for n in np.asarray(frame.labels)}
        used |= set(now.values())
    total = sum(lives.values())
    return lengths, lives, len(seen - used), sum(map(sum, lengths.values())) / total if total else 1.0
