"""OSPA(2): the OSPA distance between two sets of tracks, over a window of time.

    d(f, g) = ( 1/|D| Σ_{t ∈ D} d_t(f, g)^q )^(1/q),   D the times of the window at which f or g exists
    d_t = min(|f(t) − g(t)|, c) where both exist, c where only one does

and OSPA of order p with this distance between the tracks that exist within the window. An estimated track is all rows of one label, so a label that
changes, or a track that breaks, costs, however exact the places are.
Source: Beard, Vo & Vo 2020, "A solution for large-scale multi-object tracking", IEEE Trans. Signal Processing 68, eq. 22 to 24 (weights equal over D).
Unlabelled estimates are no tracks: the metric is then undefined (NaN, coverage 0; a board shows the pipeline and does not rank it).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sonobench.errors import InputError
from sonobench.protocols import Series
from sonobench.scoring import Aligned, Frame, aligned
from sonobench.types import Array, Estimate, Ints, Space, Truth
from sonobench_plugins.metric.ospa import ospa


@dataclass(frozen=True)
class Ospa2:
    """OSPA(2) over the window that ends at each frame; the trial's number is the mean over frames."""

    p: float = 1.0  #: order over tracks, 1 to inf
    q: float = 1.0  #: order over time, from 1
    c_m: float = 1.0  #: cut-off, in the unit of the compared components (m for positions)
    window_s: float | None = None  #: length of the window; None: from the first frame on
    components: tuple[str, ...] | None = None  #: state names to compare; None is the position
    targets: Literal["exists", "active"] = "exists"  #: truth that counts
    hold_s: float | None = None  #: how long an estimate stands; None is 1.5 periods

    def __post_init__(self) -> None:
        if not self.p >= 1 or not 1 <= self.q <= 32:
            raise InputError(f"ospa2: p is {self.p}, 1 or more (or inf) is needed; q is {self.q}, 1 to 32 is needed")
        if not (self.c_m > 0 and math.isfinite(self.c_m)):
            raise InputError(f"ospa2: c_m is {self.c_m}; a positive cut-off is needed")
        if self.window_s is not None and not self.window_s > 0:
            raise InputError(f"ospa2: window_s is {self.window_s}; a positive length is needed (leave it out for all that was)")

    def evaluate(self, truth: Truth, output: Sequence[Estimate], space: Space | None) -> Mapping[str, Series]:
        """Columns "", "localisation", "cardinality", as of OSPA.

        Raises:
            InputError: a label comes twice in one estimate.
        """
        pairs = aligned(truth, output, space, self.hold_s, self.components, self.targets)
        names, n = ("", "localisation", "cardinality"), len(pairs.frames)
        if any(f.labels is None for f in pairs.frames):
            return {name: Series(np.full(n, np.nan), np.zeros(n), pairs.unit, coverage=0.0) for name in names}
        parts = np.array([ospa(d, self.c_m, self.p) for d in self._distances(pairs)]).reshape(-1, 3)
        return {name: Series(column, np.ones(n), pairs.unit) for name, column in zip(names, parts.T, strict=True)}

    def _distances(self, pairs: Aligned) -> list[Array]:
        """Distances between the tracks (n, m) that exist within each frame's window."""
        frames = [self._scaled(pairs, f) for f in pairs.frames]
        mine = np.unique(np.concatenate([np.zeros(0, np.int64), *(f.truth_labels for f in pairs.frames)]))
        theirs = np.unique(np.concatenate([np.zeros(0, np.int64), *(np.asarray(f.labels) for f in pairs.frames)]))
        found, power, times, first = [], np.zeros((len(mine), len(theirs))), np.zeros((len(mine), len(theirs))), 0
        seen = (np.zeros(len(mine), np.int64), np.zeros(len(theirs), np.int64))
        last: list[tuple[Ints, Ints, Array]] = []
        for k, (own, other, cost) in enumerate(frames):
            i, j = np.searchsorted(mine, own), np.searchsorted(theirs, other)
            last.append((i, j, cost))
            _add(power, times, seen, last[-1])
            if self.window_s is not None:
                edge = pairs.frames[k].time_s - self.window_s * (1 - 1e-9)
                start = first
                while pairs.frames[first].time_s <= edge:
                    first += 1
                if first > start:  # summed anew, not subtracted: no rounding stays behind
                    power[:], times[:] = 0.0, 0.0
                    seen[0][:], seen[1][:] = 0, 0
                    for one in last[first:]:
                        _add(power, times, seen, one)
            here = np.ix_(seen[0] > 0, seen[1] > 0)
            found.append(self.c_m * (power[here] / times[here]) ** (1 / self.q))
        return found

    def _scaled(self, pairs: Aligned, frame: Frame) -> tuple[Ints, Ints, Array]:
        """Labels (n,), (m,) of a frame, and (min(d, c) / c)^q (n, m)."""
        labels = np.asarray(frame.labels)
        if len(np.unique(labels)) < len(labels):
            raise InputError(
                f"ospa2: labels {labels.tolist()} at {frame.time_s} s; a track is at one place at a time, give each row its own label"
            )
        return frame.truth_labels, labels, (np.minimum(pairs.distances(frame), self.c_m) / self.c_m) ** self.q


def _add(power: Array, times: Array, seen: tuple[Ints, Ints], one: tuple[Ints, Ints, Array]) -> None:
    """One time's distances: of pairs that both exist, of those of which one does (a whole cut-off); and how often each exists."""
    i, j, cost = one
    only = np.zeros(power.shape, bool)
    only[i] = True
    only[:, j] = True
    power += only
    times += only
    power[np.ix_(i, j)] += cost - 1.0
    seen[0][i] += 1
    seen[1][j] += 1
