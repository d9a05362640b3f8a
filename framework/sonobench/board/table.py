"""The leaderboard: one row a pipeline, with what its rank rests on.

Repetitions are pooled per scenario first. Only complete blocks (a scenario's repetition that every ranked pipeline has a
score of) are ranked; failed trials have the scores of empty output, so they are complete. A pipeline whose metric is
undefined somewhere, or covers less than all of the target time, or that has no scores, stands at the end unranked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from sonobench.board import notes, select, statistics
from sonobench.board.bootstrap import bootstrap, combined
from sonobench.board.facts import facts
from sonobench.board.measured import Measured, measured
from sonobench.board.pooling import means, units
from sonobench.errors import InputError
from sonobench.types import Floats

_COLUMNS = ("rank", "pipeline", "origin", "mean", "low", "high", "interval", "rank_low", "rank_high", "tie")
_TEXTS = ("pipeline", "origin", "interval", "tie", "given")
_COUNTS = ("failures", "trials")
_BLANK = {"rank": None, "rank_low": None, "rank_high": None, "interval": "", "tie": "", "mean": math.nan}
_FACTS = ("failures", "trials", "coverage", "ms_per_frame", "given")
_AGAINST = ("diff", "diff_low", "diff_high", "diff_p")
_MEDIAN = "median:"
Found = dict[str, dict[str, Any]]


def leaderboard(
    trials: pd.DataFrame, scores: pd.DataFrame, metric: str, by: str | None = None, vs: str | None = None, also: Sequence[str] = ()
) -> pd.DataFrame:
    """The board of a run.

    Args:
        trials: the run's trials.parquet, one row for each planned trial.
        scores: the run's scores.parquet.
        metric: which one, such as "ospa" or "gospa.missed".
        by: a column of `trials` ("p_scene.noise.snr_db", or any unique ending of it; "scene"): one board for each value.
        vs: a pipeline: adds each one's paired difference to it, its interval, and its p after Holm over the others.
        also: further metrics, whose means stand in columns of their names; with "median:" before one, its median over trials.

    Returns:
        Columns: the one of `by`, rank (missing where unranked), pipeline, origin, mean, low, high (95 %), interval (its
        method), rank_low, rank_high, tie, failures, trials, coverage, ms_per_frame, given; with `vs` diff, diff_low,
        diff_high, diff_p; then those of `also`. `attrs` says what it is of: metric, unit, better, scenes, scenarios,
        repetitions, over (what the interval is over), units (how many), entrants (who can be ranked), vs, scene_names,
        settings (values swept in scenes, by column) and notes; with `by` one such table for each value under "groups".

    Raises:
        InputError: the metric, the pipeline `vs` or the column `by` is not there, and what is; a trial stands there twice; or a
            median is asked for of a metric with several values a trial.
    """
    chosen = {metric: select.of_metric(scores, metric)} | {name: select.of_metric(scores, name.removeprefix(_MEDIAN)) for name in also}
    if vs is not None:
        select.known_pipeline(trials, vs)
    return grouped(trials, by, lambda part: _board(part, chosen, vs))


def grouped(trials: pd.DataFrame, by: str | None, board: Callable[[pd.DataFrame], pd.DataFrame]) -> pd.DataFrame:
    """The board of all trials, or one table of the boards for each value of a column.

    Raises:
        InputError: there is no such column.
    """
    if by is None:
        return board(trials)
    column = select.column_of(trials, by)
    boards = [(value, board(part)) for value, part in select.parts(trials, column)]
    table = pd.concat([one.assign(**{column: value}) for value, one in boards], ignore_index=True)
    table = table[[column, *(c for c in table.columns if c != column)]]
    table.attrs = {"by": column, "groups": [{**one.attrs, "value": value} for value, one in boards]}
    return table


def _board(trials: pd.DataFrame, chosen: Mapping[str, pd.DataFrame], vs: str | None) -> pd.DataFrame:
    metric = next(iter(chosen))
    found = measured(trials, metric, chosen[metric])
    told = _ranked(found, vs) | _unranked(found)
    others = {name: _beside(measured(trials, name, scores)) for name, scores in chosen.items() if name != metric}
    records = [
        {
            **_BLANK,
            **fact,
            **told.get(fact["pipeline"], {}),
            **{name: means.get(fact["pipeline"], np.nan) for name, means in others.items()},
        }
        for fact in facts(trials, found)
    ]
    ranked = set(found.names)
    order = sorted(records, key=lambda r: (r["pipeline"] not in ranked, _worth(found.sign, r["mean"]), r["pipeline"]))
    names = [*_COLUMNS, *_FACTS, *(_AGAINST if vs is not None else ()), *others]
    table = pd.DataFrame({name: _column(name, [record.get(name) for record in order]) for name in names})
    attrs = about(trials, found) | {"vs": vs, "entrants": [r["pipeline"] for r in order if r["pipeline"] in ranked]}
    table.attrs = attrs | {"notes": notes.of(order, attrs, found)}
    return table


def _column(name: str, values: list[Any]) -> Any:
    if name in _TEXTS:
        return pd.array(values, "str")
    if name in _COUNTS:
        return np.array(values, np.int64)
    return pd.array(values, "Int64") if name.startswith("rank") else np.array(values, float)


def about(trials: pd.DataFrame, found: Measured) -> dict[str, Any]:
    """What a board is of."""
    coded = found.planned.trials
    first = np.unique(coded.block, return_index=True)[1]
    return {
        "metric": found.metric,
        "unit": found.unit,
        "better": found.better,
        "scenes": len(np.unique(coded.scene)),
        "scenarios": len(coded.scene),
        "repetitions": int(np.bincount(coded.scenario[first]).max(initial=0)),
        "over": found.units.over,
        "units": len(found.units.values),
        "scene_names": select.sorted_values(trials["scene"]),
        "settings": {c: select.sorted_values(trials[c]) for c in select.scene_columns(trials)},
    }


def _worth(sign: float, mean: float) -> tuple[bool, float]:
    """What sorts the better one first, and NaN last."""
    return (True, 0.0) if math.isnan(mean) else (False, sign * mean)


def _ranked(found: Measured, vs: str | None) -> Found:
    """What the ranked pipelines' unit values tell; statistics below MIN_UNITS are left out."""
    names, values = found.names, found.units.values
    n, k = values.shape
    if not n or not k:
        return {}
    others = [j for j, name in enumerate(names) if name != vs] if vs in names else []
    contrasts = np.eye(k)[:, others] - (np.eye(k)[:, [names.index(vs)]] if vs in names else 0.0)
    draws = bootstrap(found.units, np.concatenate([np.eye(k), contrasts], axis=1))
    spans = statistics.intervals(draws)
    told: Found = {
        name: {"mean": float(draws.value[j]), **dict(zip(("low", "high", "interval"), spans[j], strict=True))}
        for j, name in enumerate(names)
    }
    if n >= statistics.MIN_UNITS:
        _add_ranks(told, found, draws.values[:, :k])
    p = statistics.holm(statistics.sign_flip(combined(values, contrasts))) if n >= statistics.MIN_UNITS else np.full(len(others), np.nan)
    for m, j in enumerate(others):
        told[names[j]] |= dict(zip(_AGAINST, (float(draws.value[k + m]), *spans[k + m][:2], float(p[m])), strict=True))
    return told


def _add_ranks(told: Found, found: Measured, resampled: Floats) -> None:
    goodness = found.sign * found.units.values
    order = np.argsort(goodness.mean(axis=0), kind="stable")
    rank = statistics.ranks(goodness.mean(axis=0))
    low, high = statistics.rank_intervals(found.sign * resampled)
    pairs, p = statistics.pairwise(goodness[:, order])
    tie = statistics.letters(len(order), [pair for pair, value in zip(pairs, p, strict=True) if value < 1 - statistics.LEVEL])
    for place, j in enumerate(order):
        told[found.names[j]] |= {"rank": int(rank[j]), "rank_low": int(low[j]), "rank_high": int(high[j]), "tie": tie[place]}


def _unranked(found: Measured) -> Found:
    """Mean and interval of what each other pipeline has a value of."""
    told: Found = {}
    for code in np.flatnonzero(~found.ranked):
        mine = units(found.rows.only(found.rows.pipeline == code), found.pool)
        if mine.values.size:
            draws = bootstrap(mine)
            told[found.planned.trials.pipelines[code]] = {
                "mean": float(draws.value[0]),
                **dict(zip(("low", "high", "interval"), statistics.intervals(draws)[0], strict=True)),
            }
    return told


def _beside(found: Measured) -> dict[str, float]:
    """Mean over units, or median over trials, of whatever each pipeline has."""
    names = found.planned.trials.pipelines
    if not found.metric.startswith(_MEDIAN):
        return means(units(found.planned, found.pool), names)
    rows = found.planned.only(np.isfinite(found.planned.value) & (found.planned.weight > 0))
    if len(np.unique(rows.trial)) < len(rows.trial):
        raise InputError(
            f"{found.metric.removeprefix(_MEDIAN)} has a value at every time; a median over trials needs a metric with one a trial"
        )
    return {names[code]: float(np.median(rows.value[rows.pipeline == code])) for code in np.unique(rows.pipeline)}
