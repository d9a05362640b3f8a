"""The sentences under a board: what its numbers are over, and what to beware of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from sonobench.board import pooling, statistics


def of(table: pd.DataFrame, rows: pd.DataFrame, values: pd.DataFrame, blocks: set[int], pool: str) -> list[str]:
    """All notes that apply to a board with its attrs, in reading order."""
    attrs = {str(k): v for k, v in table.attrs.items()}
    found = [_interval(table, attrs), *_separation(table, attrs, values), *_failures(table, attrs, rows, pool)]
    found += _missing(table, rows, blocks)
    swept = sorted(rows["cell"].unique())
    if len(swept) > 1:
        found.append(f"averaged over {len(swept)} swept settings of the scenes (--by splits them).")
    given = table[table["given"] != ""]
    if len(given):
        found.append("° uses what the scene gives out: " + "; ".join(given["pipeline"] + ": " + given["given"]) + ".")
    if "diff" in table:
        found.append(f"diff: paired, minus {attrs['vs']}; p by sign flips, Holm over the other pipelines.")
    return found


def _interval(table: pd.DataFrame, attrs: Mapping[str, Any]) -> str:
    n, over = attrs["units"], attrs["over"]
    one = over[:-1]
    averaged = f" ({attrs['repetitions']} repetitions of a scene averaged first)" if over == "scenes" and attrs["repetitions"] > 1 else ""
    methods = set(table["interval"]) - {""}
    if n < 2:
        return f"no interval: only {n} {one}." if n else "no complete block to rank; means and intervals are of what each pipeline covers."
    if methods == {"bootstrap-t"}:
        return f"95% CI: bootstrap-t over {n} {over}{averaged}."
    mixed = "bootstrap-t, and " if "bootstrap-t" in methods else ""
    why = f"fewer than {statistics.MIN_UNITS} {over}" if n < statistics.MIN_UNITS else "too little spread to resample"
    return f"95% CI: {mixed}Student's t over {n} {over}{averaged}; {why}, so it rests on normality."


def _separation(table: pd.DataFrame, attrs: Mapping[str, Any], values: pd.DataFrame) -> list[str]:
    entrants = len(values.columns)
    comparisons = entrants * (entrants - 1) // 2
    n, over = len(values), attrs["over"]
    if not comparisons:
        return []
    needed = statistics.units_needed(comparisons)
    if n < statistics.MIN_UNITS:
        more = f" for one comparison, {needed} for these {comparisons}" if comparisons > 1 else ""
        return [f"too few {over} to rank: {n}; {statistics.MIN_UNITS} are needed{more}."]
    found = ["same letter = not separated (paired sign flips, Holm 5%); ranks in brackets hold in 95% of resamples."]
    if n < needed:
        found.append(f"too few {over} to separate anything among {comparisons} comparisons: {n}; {needed} are needed.")
    order = [p for p in table["pipeline"] if p in values.columns]
    x = values[order].to_numpy(float)
    bent = np.flatnonzero(statistics.skewed(np.diff(x, axis=1)))
    if len(bent):
        pairs = statistics.joined([f"{order[k]} and {order[k + 1]}" for k in bent])
        found.append(f"differences are skewed between {pairs}: interval and letters are optimistic there.")
    return found


def _failures(table: pd.DataFrame, attrs: Mapping[str, Any], rows: pd.DataFrame, pool: str) -> list[str]:
    if not table["failures"].sum():
        return []
    ranked = [p for p, mean in zip(table["pipeline"], table["mean"], strict=True) if pd.notna(mean)]
    sign = -1.0 if attrs["better"] == "higher" else 1.0
    kept = rows[(rows["status"] == "ok") & rows["pipeline"].isin(ranked)]
    means = pooling.units(kept, pool).values.mean() if len(kept) else pd.Series(dtype=float)
    before = [p for p in ranked if p in means.index]
    after = sorted(before, key=lambda p: (sign * means[p], before.index(p)))
    gone = [p for p in ranked if p not in means.index]
    change = "order unchanged if dropped" if before == after else f"order if dropped: {', '.join(after)}"
    never = f" ({statistics.joined(gone)} never succeeded)" if gone else ""
    return [f"! failures scored as empty output; {change}{never}."]


def _missing(table: pd.DataFrame, rows: pd.DataFrame, blocks: set[int]) -> list[str]:
    found = []
    total = rows["block"].nunique()
    if blocks and len(blocks) < total:
        found.append(f"ranked on {len(blocks)} of {total} blocks (scene and repetition): the others lack a score of a ranked pipeline.")
    scored = rows.groupby("pipeline")["scored"].any()
    bare = [str(p) for p in table["pipeline"] if not scored.get(p, False)]
    if bare:
        found.append(f"– no scores: {statistics.joined(bare)}.")
    partial = [str(p) for p in table.loc[table["coverage"] < 1 - 1e-9, "pipeline"]]
    if partial:
        found.append(f"– not ranked, the metric covers only a share of the target time: {statistics.joined(partial)}.")
    return found
