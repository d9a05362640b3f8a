"""Several runs as one table: shards of one study, runs of several studies, the same run twice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from sonobench.errors import InputError

_RUN = "_run"
_ROUNDING = 1e-9  # relative
_WORST = 2  # of 0 ok, 1 failed, 2 not run
_SCORE = ("trial_key", "metric", "metric_sha", "slice")


def together(trials: Sequence[pd.DataFrame], scores: Sequence[pd.DataFrame], names: Sequence[str]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Trials and scores of several runs as those of one.

    A trial that several runs planned stands there once: the one that is ok, else one that failed, else one that was not
    reached; among equals the first run's.

    Args:
        trials, scores: of each run.
        names: of the runs, for messages.

    Raises:
        InputError: two runs have different results of the same trial.
    """
    if len(trials) == 1:
        return trials[0], scores[0]
    rows, values = (pd.concat([t.assign(**{_RUN: k}) for k, t in enumerate(side)], ignore_index=True) for side in (trials, scores))
    if rows["trial_key"].is_unique:
        return rows.drop(columns=_RUN), values.drop(columns=_RUN)
    status = rows["status"].fillna("").astype(str)
    quality = np.select([status == "ok", ~status.isin(["", "skipped"])], [0, 1], _WORST)
    order = np.lexsort([rows[_RUN].to_numpy(), quality])
    kept = rows.iloc[order].drop_duplicates("trial_key").sort_index()
    _refuse_two_results(rows[quality == 0], names)
    chosen = pd.Series(quality, rows.index).loc[kept.index].to_numpy()
    best = pd.Series(chosen, kept["trial_key"]).reindex(rows["trial_key"]).to_numpy()
    equal = rows.loc[quality == best, ["trial_key", _RUN]]  # a failed trial has the scores of empty output in each run
    values = values.reset_index().merge(equal, on=["trial_key", _RUN]).sort_values("index", kind="stable")
    _refuse_two_scores(values, names)
    values = values.drop_duplicates([c for c in _SCORE if c in values], ignore_index=True).drop(columns=["index", _RUN])
    return kept.drop(columns=_RUN).reset_index(drop=True), values


def same_entries(entries: Sequence[Mapping[str, Any]], names: Sequence[str]) -> dict[str, Any]:
    """Entries of several runs by name.

    Raises:
        InputError: a name stands for different tables.
    """
    whole: dict[str, Any] = {}
    home: dict[str, str] = {}
    for run, own in zip(names, entries, strict=True):
        for name, entry in own.items():
            if whole.setdefault(name, entry)["table"] != entry["table"]:
                raise InputError(f"pipeline {name!r} has other parameters in {run} than in {home[name]}; rename one of the entries")
            home.setdefault(name, run)
    return whole


def _refuse_two_scores(values: pd.DataFrame, names: Sequence[str]) -> None:
    """The same output has the same score, but for what machines differ in at the last digits."""
    same = [c for c in _SCORE if c in values]
    several = values[values.duplicated(same, keep=False)]
    if several.empty:
        return
    found = several.groupby(same, dropna=False)["value"].agg(["min", "max", "count", "size"])
    apart = found["max"] - found["min"] > _ROUNDING * np.maximum(found["max"].abs(), found["min"].abs())
    twofold = found[apart | ((found["count"] > 0) & (found["count"] < found["size"]))]
    if len(twofold):
        first = dict(zip(same, twofold.index[0], strict=True))
        runs = [names[k] for k in sorted(set(several.loc[several["trial_key"] == first["trial_key"], _RUN]))]
        raise InputError(
            f"{len(twofold)} scores, such as {first['metric']} of trial {first['trial_key']}, have different results in "
            f"{' and '.join(runs)}: the metric's code changed between them; run the older one again"
        )


def _refuse_two_results(done: pd.DataFrame, names: Sequence[str]) -> None:
    if "estimate_key" not in done:
        return
    results = done.groupby("trial_key")["estimate_key"].nunique()
    twofold = results[results > 1]
    if len(twofold):
        runs = [names[k] for k in sorted(set(done.loc[done["trial_key"] == twofold.index[0], _RUN]))]
        raise InputError(
            f"{len(twofold)} trials, such as {twofold.index[0]}, have different results in {' and '.join(runs)}: other code or another "
            "environment; board them one by one, or run the older one again"
        )
