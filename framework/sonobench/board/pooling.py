"""From score rows to one value a unit: what a metric's `pool` says, over the repetitions of a scenario.

Where several scenarios are there, a scenario is a unit and its value is pooled over its repetitions and runs. Within one
scenario a repetition is a unit. As "rms", "frame-rms" and ratios are not means of repetitions, a repetition's value is
then its pseudo-value, the pooled value plus the repetition's influence on it (first order), so that the mean of the units
is the pooled value and their spread its sampling error; what they are pooled from is kept for resampling.

A median is taken within a trial; trials are averaged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sonobench.board.rows import Rows
from sonobench.types import Floats, Ints

_ROOTS = ("rms", "frame-rms")


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """Sums of w and of w·y (n units, K pipelines, L slices); the pooled value is the mean over slices of (√ of) Σ wy / Σ w."""

    w: Floats
    wy: Floats
    root: bool


@dataclass(frozen=True, slots=True, eq=False)
class Units:
    """Unit values.

    Attributes:
        values: (n, K); NaN where a pipeline has none.
        pipelines: (K,) codes, ascending.
        over: "scenarios", "repetitions" or "runs".
        groups: (n,) the scene of each scenario; of repetitions, each its own.
        parts: None where the pooled value is the plain mean over units.
    """

    values: Floats
    pipelines: Ints
    over: str
    groups: Ints
    parts: Parts | None = None


def units(rows: Rows, pool: str) -> Units:
    """Unit values of every pipeline in `rows`."""
    weight = np.ones(len(rows.value)) if pool == "median" else rows.weight
    counts = np.isfinite(rows.value) & (weight > 0)
    rows, weight = rows.only(counts), weight[counts]
    y = rows.value**2 if pool in _ROOTS else rows.value
    pipelines, pipeline = np.unique(rows.pipeline, return_inverse=True)
    unit, over, groups = _units(rows)
    slices, piece = np.unique(rows.slice, return_inverse=True)
    shape = len(groups), len(pipelines), len(slices)
    at = (unit * shape[1] + pipeline) * shape[2] + piece
    w, wy = (np.bincount(at, v, minlength=int(np.prod(shape))).reshape(shape).astype(float) for v in (weight, weight * y))
    parts = Parts(w, wy, pool in _ROOTS)
    if over == "scenarios" or len(groups) < 2:
        return Units(_pooled(w, wy, parts.root), pipelines, over, groups)
    values = _pseudo_values(parts)
    plain = not parts.root and bool(np.all(w == w[:1]))
    return Units(values, pipelines, over, groups, None if plain or np.isnan(values).any() else parts)


def means(pooled: Units, names: Sequence[str]) -> dict[str, float]:
    """Mean over the units that each pipeline has, by name; without those that have none."""
    count = np.isfinite(pooled.values).sum(axis=0)
    total = np.nansum(pooled.values, axis=0)
    return {names[code]: float(total[k] / count[k]) for k, code in enumerate(pooled.pipelines) if count[k]}


def _units(rows: Rows) -> tuple[Ints, str, Ints]:
    """Unit (R,) of each row, what units are, and each unit's scene."""
    trials = rows.trials
    scenarios, scenario = np.unique(rows.scenario, return_inverse=True)
    if len(scenarios) > 1:
        return scenario, "scenarios", trials.scene[scenarios]
    for name, codes in (("repetitions", trials.take), ("runs", trials.block)):
        found, unit = np.unique(codes[rows.trial], return_inverse=True)
        if len(found) > 1:
            return unit, name, np.arange(len(found))
    return scenario, "scenarios", trials.scene[scenarios]


def _pooled(w: Floats, wy: Floats, root: bool) -> Floats:
    """(…, L) → (…): the mean over the slices that have a weight; NaN without any."""
    has = w > 0
    ratio = np.divide(wy, w, out=np.zeros_like(wy), where=has)
    total = (np.sqrt(ratio) if root else ratio).sum(axis=-1)
    count = has.sum(axis=-1)
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)


def _pseudo_values(parts: Parts) -> Floats:
    """(n, K): pooled value plus influence of each unit; NaN where a pipeline has nothing in a unit."""
    seen = (parts.w > 0).any(axis=2)
    pooled = _pooled(parts.w.sum(axis=0), parts.wy.sum(axis=0), parts.root)
    influence = influences(parts, np.ones((1, len(parts.w))))[1][0]
    return np.where(seen, pooled + seen.sum(axis=0) * influence, np.nan)


def influences(parts: Parts, counts: Floats) -> tuple[Floats, Floats]:
    """Pooled values (B, K) of resamples and the first-order influence (B, n, K) of each unit on them.

    Args:
        parts: of n units.
        counts: (B, n) how often each unit was drawn.
    """
    n, k, pieces = parts.w.shape
    w, wy = (np.ascontiguousarray(a.reshape(n, -1)) for a in (parts.w, parts.wy))
    total, weighed = ((counts @ a).reshape(-1, k, pieces) for a in (w, wy))
    has = total > 0
    mean = np.divide(weighed, total, out=np.zeros_like(total), where=has)
    value = np.sqrt(mean) if parts.root else mean
    slope = np.divide(0.5, value, out=np.zeros_like(value), where=value > 0) if parts.root else np.ones_like(mean)
    count = np.maximum(has.sum(axis=2), 1)
    gain = np.divide(slope, total, out=np.zeros_like(total), where=has) / count[..., None]
    influence = np.stack([gain[:, j] @ parts.wy[:, j].T - (gain * mean)[:, j] @ parts.w[:, j].T for j in range(k)], axis=-1)
    return value.sum(axis=2) / count, influence
