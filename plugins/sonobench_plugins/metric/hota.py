"""HOTA of labelled tracks, by the library trackeval (the extra `mot`).

    HOTA_α = √(DetA_α AssA_α),   averaged over the thresholds α = .05, .1, …, .95 of the similarity max(0, 1 − d / c)

Source: Luiten, Ošep, Dendorfer, Torr, Geiger, Leal-Taixé & Leibe 2021, "HOTA: a higher order metric for evaluating multi-object tracking"; TrackEval,
which computes it. The similarity of points is that of TrackEval's own Euclidean one.
Unlabelled estimates are no tracks: the metric is then undefined (NaN, coverage 0); so it is where there is neither target nor estimate.
"""

from __future__ import annotations

import contextlib
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from sonobench.errors import InputError, SetupError
from sonobench.protocols import Series
from sonobench.scoring import Aligned, aligned
from sonobench.types import Estimate, Space, Truth

_COLUMNS = {"": "HOTA", "detection": "DetA", "association": "AssA"}


@dataclass(frozen=True)
class Hota:
    """HOTA with its detection and association parts, in [0, 1]."""

    c_m: float = 1.0  #: distance of similarity 0, in the unit of the compared components (m for positions, rad for directions)
    targets: Literal["exists", "active"] = "exists"  #: truth that counts
    hold_s: float | None = None  #: how long an estimate stands; None is 1.5 periods

    def __post_init__(self) -> None:
        if not (self.c_m > 0 and math.isfinite(self.c_m)):
            raise InputError(f"hota: c_m is {self.c_m}; a positive distance is needed")

    def evaluate(self, truth: Truth, output: Sequence[Estimate], space: Space | None) -> Mapping[str, Series]:
        """Columns "" (HOTA), "detection" (DetA), "association" (AssA).

        Raises:
            SetupError: the library is not installed.
        """
        library = _trackeval()
        pairs = aligned(truth, output, space, self.hold_s, targets=self.targets)
        told = all(f.labels is not None for f in pairs.frames)
        data = _data(pairs, self.c_m) if told else {}
        weight = float(max(data["num_gt_dets"], data["num_tracker_dets"])) if told else 0.0
        found = library.HOTA().eval_sequence(data) if weight else {}
        return {
            name: Series(np.array([np.mean(found[key]) if weight else np.nan]), np.array([weight]), "1", "higher", coverage=float(told))
            for name, key in _COLUMNS.items()
        }


def _data(pairs: Aligned, c: float) -> dict[str, Any]:
    """A trial in TrackEval's terms: labels are numbered from 0."""
    frames = pairs.frames
    mine = np.unique(np.concatenate([np.zeros(0, np.int64), *(f.truth_labels for f in frames)]))
    theirs = np.unique(np.concatenate([np.zeros(0, np.int64), *(np.asarray(f.labels) for f in frames)]))
    return {
        "num_gt_dets": sum(len(f.truth) for f in frames),
        "num_tracker_dets": sum(len(f.estimates) for f in frames),
        "num_gt_ids": len(mine),
        "num_tracker_ids": len(theirs),
        "gt_ids": [np.searchsorted(mine, f.truth_labels) for f in frames],
        "tracker_ids": [np.searchsorted(theirs, np.asarray(f.labels)) for f in frames],
        "similarity_scores": [np.maximum(0.0, 1.0 - pairs.distances(f) / c) for f in frames],
    }


def _trackeval() -> Any:
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # it tells which of its image data sets lack their libraries
            from trackeval import metrics
    except ImportError:
        raise SetupError("metric hota computes with the library trackeval, which is not installed: pip install 'sonobench[mot]'") from None
    return metrics
