"""What of a run's tables a board is about: a metric, a column to split by, the swept settings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from sonobench.errors import InputError
from sonobench.registry import did_you_mean

_OWN = "p_pipelines."


def of_metric(scores: pd.DataFrame, metric: str) -> pd.DataFrame:
    """The rows of one metric.

    Raises:
        InputError: there are none, or they were computed with different settings.
    """
    chosen = scores[(scores["metric"] == metric).fillna(False).to_numpy(bool)]
    if chosen.empty:
        there = sorted(set(scores["metric"].dropna()))
        raise InputError(f"no scores of metric {metric!r}; the run has {there or 'none'}{did_you_mean(metric, there)}")
    if "metric_sha" in chosen and chosen["metric_sha"].nunique() > 1:
        raise InputError(
            f"metric {metric!r} was computed with {chosen['metric_sha'].nunique()} different settings; compare runs of one setting"
        )
    return chosen


def trial_keys(trials: pd.DataFrame) -> pd.Index:
    """The key of every trial.

    Raises:
        InputError: one stands there twice.
    """
    keys = pd.Index(trials["trial_key"])
    if not keys.is_unique:
        twice = keys[keys.duplicated()]
        raise InputError(f"{len(twice)} trials stand there twice, such as {twice[0]}; put runs together with open_run(RUN, RUN, …)")
    return keys


def known_pipeline(trials: pd.DataFrame, name: str) -> None:
    """Refuse a pipeline that is not there.

    Raises:
        InputError: it is not, and what is.
    """
    there = set(trials["pipeline"].unique())
    if name not in there:
        raise InputError(f"no pipeline {name!r} to compare with; the board has {sorted(there)}{did_you_mean(name, there)}")


def column_of(trials: pd.DataFrame, by: str) -> str:
    """The column that `by` names by any unique ending.

    Raises:
        InputError: none, or more than one.
    """
    columns = [c for c in trials.columns if c.startswith("p_") or c == "scene"]
    found = [c for c in columns if c in (by, f"p_{by}")] or [c for c in columns if c.endswith(f".{by}")]
    if len(found) != 1:
        raise InputError(f"--by {by}: {f'{found} all end so' if found else 'no such column'}; the run can be split by {columns}")
    return found[0]


def parts(trials: pd.DataFrame, column: str) -> list[tuple[Any, pd.DataFrame]]:
    """The trials of each value; pipelines that a pipeline's sweep does not touch stand on each board."""
    values = sorted_values(trials[column])
    without = trials[trials[column].isna()]
    everywhere = without if column.startswith(_OWN) and values else trials.iloc[:0]
    split = [(value, pd.concat([trials[trials[column] == value], everywhere])) for value in values]
    return split if len(everywhere) or without.empty else [*split, (None, without)]


def sorted_values(column: pd.Series) -> list[Any]:
    """Distinct values but missing ones as plain Python objects, numbers before strings."""
    found = [v.item() if isinstance(v, np.generic) else v for v in column.dropna().unique()]
    return sorted(found, key=lambda v: (isinstance(v, str), v))


def scene_columns(trials: pd.DataFrame) -> list[str]:
    """Columns of what is swept in scenes."""
    return sorted(c for c in trials.columns if c.startswith("p_") and not c.startswith(_OWN))
