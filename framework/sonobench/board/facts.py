"""What a board says of a pipeline beside its scores: where it comes from, how it failed, what it cost."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from sonobench.board.measured import Measured
from sonobench.types import Bools, Floats, Ints


def facts(trials: pd.DataFrame, found: Measured) -> list[dict[str, Any]]:
    """Of every pipeline (by code): pipeline, origin, failures, trials, coverage, ms_per_frame, given."""
    coded = found.planned.trials
    size = len(coded.pipelines)

    def total(values: Floats | Bools) -> Floats:
        return np.bincount(coded.pipeline, values, minlength=size).astype(float)

    bad = ~coded.ok & (trials["status"].fillna("") != "").to_numpy(bool)
    seconds = sum(np.nan_to_num(_floats(trials[c])) for c in ("front_end_s", "tracker_s"))
    frames = np.where(coded.ok, np.nan_to_num(_floats(trials["frames"])), 0.0)
    planned, failures, work, done = total(np.ones(len(trials))), total(bad), total(np.where(coded.ok, seconds, 0.0)), total(frames)
    cost = np.divide(1e3 * work, done, out=np.full(size, np.nan), where=done > 0)
    coverage = _coverage(found, size)
    first = _first(found)
    columns = [c for c in ("distribution", "version", "code_sha", "dirty", "given") if c in trials]
    told = {c: list(trials[c].array.take(first)) for c in columns}
    rows = [{c: values[k] for c, values in told.items()} for k in range(size)]
    return [
        {
            "pipeline": name,
            "origin": _origin(rows[k]),
            "failures": int(failures[k]),
            "trials": int(planned[k]),
            "coverage": float(coverage[k]),
            "ms_per_frame": float(cost[k]),
            "given": _given(rows[k].get("given")),
        }
        for k, name in enumerate(coded.pipelines)
    ]


def _floats(column: pd.Series) -> Floats:
    return column.to_numpy(float, na_value=np.nan)


def _coverage(found: Measured, size: int) -> Floats:
    """Mean over a pipeline's trials of the mean over their slices; NaN where nothing was scored."""
    rows = found.rows.only(np.isfinite(found.rows.coverage))
    size_trials = len(rows.trials.pipeline)
    count = np.bincount(rows.trial, minlength=size_trials)
    mean = np.bincount(rows.trial, rows.coverage, minlength=size_trials) / np.maximum(count, 1)
    scored = count > 0
    n = np.bincount(rows.trials.pipeline[scored], minlength=size)
    covered = np.bincount(rows.trials.pipeline[scored], mean[scored], minlength=size).astype(float)
    return np.divide(covered, n, out=np.full(size, np.nan), where=n > 0)


def _first(found: Measured) -> Ints:
    """A trial of each pipeline that tells its origin: the first that is ok, else the first."""
    coded = found.planned.trials
    order = np.argsort(~coded.ok, kind="stable")
    return order[np.unique(coded.pipeline[order], return_index=True)[1]]


def _origin(row: Mapping[Any, Any]) -> str:
    """Distribution and version (of a file without one, the head of its code's hash); * marks uncommitted changes."""
    text = {c: "" if pd.isna(row.get(c)) else str(row[c]) for c in ("distribution", "version", "code_sha")}
    version = text["version"] or f"@{text['code_sha']}"[:5]
    dirty = row.get("dirty")
    mark = "*" if not pd.isna(dirty) and bool(dirty) else ""
    return f"{text['distribution']} {version.removesuffix('@')}{mark}".strip()


def _given(value: Any) -> str:
    if isinstance(value, str):
        return value
    return ", ".join(map(str, value)) if isinstance(value, (list, tuple, np.ndarray)) else ""
