"""From score rows to one value a unit: what a metric's `pool` says, over the repetitions of a scene.

Where several scenes are there, a scene is a unit and its value is pooled over its repetitions and runs. Within one scene
a repetition is a unit. As "rms" and "frame-rms" are not means of repetitions, a repetition's value is then its
jackknife-like pseudo-value, the pooled value plus the repetition's influence on it (first order), so that the mean of
the units is the pooled value and their spread is its sampling error.

A median is taken within a trial; trials are averaged.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd

#: what tells the trials of one pipeline apart; `cell` numbers the swept values of a scene
BLOCK = ["scene", "cell", "repetition", "run"]


class Units(NamedTuple):
    """values: units in rows, pipelines in columns; over: "scenes", "repetitions" or "runs"."""

    values: pd.DataFrame
    over: str


def joined_scores(trials: pd.DataFrame, scores: pd.DataFrame) -> pd.DataFrame:
    """One row for each trial and slice of one metric; `value` is NaN and `scored` False where a trial has no score."""
    swept = [c for c in trials.columns if c.startswith("p_") and not c.startswith("p_pipelines.")]
    cell = trials.groupby(swept, dropna=False, sort=True).ngroup() if swept else 0
    keys = trials[["trial_key", "pipeline", "scene", "repetition", "run", "status"]].assign(cell=cell)
    columns = ["trial_key", "slice", "value", "weight", "coverage"]
    rows = keys.merge(scores[columns].assign(scored=True), on="trial_key", how="left")
    return rows.assign(scored=rows["scored"].notna(), block=rows.groupby(BLOCK, sort=True).ngroup())


def units(rows: pd.DataFrame, pool: str) -> Units:
    """Unit values of every pipeline in `rows`; NaN where a pipeline has none."""
    rows = _weighted(rows, pool)
    several = [column for column in ("scene", "repetition", "run") if rows[column].nunique() > 1]
    unit = several[0] if several else "scene"
    root = pool in ("rms", "frame-rms")
    if rows.empty:
        return Units(pd.DataFrame(), f"{unit}s")
    return Units(_by_scene(rows, root) if unit == "scene" else _by_influence(rows, root, unit), f"{unit}s")


def _weighted(rows: pd.DataFrame, pool: str) -> pd.DataFrame:
    """Rows that count, with y and w·y; y is squared where roots are taken later."""
    weight = pd.Series(1.0, rows.index) if pool == "median" else rows["weight"]
    kept = rows[rows["value"].notna() & (weight > 0)]
    y = kept["value"] ** 2 if pool in ("rms", "frame-rms") else kept["value"]
    return kept.assign(w=weight.loc[kept.index], wy=weight.loc[kept.index] * y)


def _by_scene(rows: pd.DataFrame, root: bool) -> pd.DataFrame:
    sums = rows.groupby(["pipeline", "scene", "cell", "slice"])[["w", "wy"]].sum()
    ratio = sums["wy"] / sums["w"]
    pooled = ratio**0.5 if root else ratio
    cells = pooled.groupby(["pipeline", "scene", "cell"]).mean()
    return pd.DataFrame(cells.groupby(["pipeline", "scene"]).mean().unstack("pipeline"))


def _by_influence(rows: pd.DataFrame, root: bool, unit: str) -> pd.DataFrame:
    key = ["pipeline", "cell", "slice"]
    sums = rows.groupby([*key, unit])[["w", "wy"]].sum()
    w, wy = (sums[c].unstack(unit).fillna(0.0).to_numpy() for c in ("w", "wy"))
    table = sums["w"].unstack(unit)
    total = w.sum(axis=1, keepdims=True)
    mean = wy.sum(axis=1, keepdims=True) / total
    pooled = np.sqrt(mean) if root else mean
    slope = np.divide(0.5, pooled, out=np.zeros_like(pooled), where=pooled > 0) if root else 1.0
    seen = _seen(rows, unit).reindex(table.index.get_level_values("pipeline")).to_numpy()
    influence = seen.sum(axis=1, keepdims=True) / total * (wy - w * mean) * slope
    pseudo = pd.DataFrame(np.where(seen, pooled + influence, np.nan), index=table.index, columns=table.columns)
    return pseudo.groupby(["pipeline", "cell"]).mean().groupby("pipeline").mean().T


def _seen(rows: pd.DataFrame, unit: str) -> pd.DataFrame:
    """Whether a pipeline (row) has any value in a unit (column)."""
    return rows.groupby(["pipeline", unit]).size().unstack(unit).notna()
