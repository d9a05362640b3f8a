"""CLEAR MOT and identity scores of labelled tracks, by the library motmetrics (the extra `mot`).

    MOTA = 1 − (misses + false positives + switches) / targets,   MOTP: mean distance of matches,   IDF1: F1 of the best one-to-one naming

Source: Bernardin & Stiefelhagen 2008, "Evaluating multiple object tracking performance: the CLEAR MOT metrics"; Ristani, Solera, Zou, Cucchiara &
Tomasi 2016, "Performance measures and a data set for multi-target, multi-camera tracking"; py-motmetrics, which computes them.
Unlabelled estimates are no tracks: the metric is then undefined (NaN, coverage 0); so it is in a trial without a target.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from sonobench.errors import InputError, SetupError
from sonobench.protocols import Series
from sonobench.scoring import Aligned, aligned
from sonobench.types import Estimate, Space, Truth

_COUNTS = {"switches": "num_switches", "missed": "num_misses", "false": "num_false_positives"}


@dataclass(frozen=True)
class ClearMot:
    """MOTA, and of what it consists; MOTP; IDF1."""

    c_m: float = 1.0  #: gate: a pair at this distance or more is no match, in the unit of the compared components (m; rad for directions)
    targets: Literal["exists", "active"] = "exists"  #: truth that counts
    hold_s: float | None = None  #: how long an estimate stands; None is 1.5 periods

    def __post_init__(self) -> None:
        if not (self.c_m > 0 and math.isfinite(self.c_m)):
            raise InputError(f"clear-mot: c_m is {self.c_m}; a positive gate is needed")

    def evaluate(self, truth: Truth, output: Sequence[Estimate], space: Space | None) -> Mapping[str, Series]:
        """Columns "" (MOTA), "idf1", "motp", and "switches", "missed", "false" a target and time.

        Raises:
            SetupError: the library is not installed.
        """
        library = _motmetrics()
        pairs = aligned(truth, output, space, self.hold_s, targets=self.targets)
        told = all(f.labels is not None for f in pairs.frames)
        number = float(sum(len(f.truth) for f in pairs.frames))
        found = _summary(library, pairs, self.c_m) if told and number else {}
        hits = number - found.get("num_misses", number)
        weight = number if told else 0.0

        def one(value: float, unit: str, weight: float, better: Literal["lower", "higher"] = "lower", **more: float) -> Series:
            values, weights = np.array([value if weight else np.nan]), np.array([weight])
            return Series(values, weights, unit, better, coverage=more.get("coverage", 1.0 if told else 0.0))

        mean = found.get("motp", np.nan)
        return {
            "": one(found.get("mota", 0.0), "1", weight, "higher"),
            "idf1": one(np.nan_to_num(found.get("idf1", 0.0)), "1", weight, "higher"),
            "motp": one(mean, pairs.unit, hits if told else 0.0, coverage=hits / number if number and told else float(told)),
            **{name: one(found.get(key, 0.0) / max(number, 1.0), "1", weight) for name, key in _COUNTS.items()},
        }


def _summary(library: Any, pairs: Aligned, c: float) -> dict[str, float]:
    """What the library counts, by its own names."""
    seen = library.MOTAccumulator(auto_id=True)
    for frame in pairs.frames:
        distances = pairs.distances(frame)
        seen.update(frame.truth_labels.tolist(), np.asarray(frame.labels).tolist(), np.where(distances < c, distances, np.nan))
    wanted = ["mota", "motp", "idf1", *_COUNTS.values()]
    return {k: float(v) for k, v in library.metrics.create().compute(seen, metrics=wanted, return_dataframe=False).items()}


def _motmetrics() -> Any:
    try:
        import motmetrics
    except ImportError:
        raise SetupError(
            "metric clear-mot computes with the library motmetrics, which is not installed: pip install 'sonobench[mot]'"
        ) from None
    return motmetrics
