"""The leaderboard: one row a pipeline, with what its rank rests on.

Repetitions are averaged per scene first. Only complete blocks (a scene's repetition that every ranked pipeline has a
score of) are ranked; failed trials have the scores of empty output, so they are complete. A pipeline whose metric is
undefined somewhere, or covers less than all of the target time, or that has no scores, stands at the end unranked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from sonobench.board import notes, pooling, statistics
from sonobench.errors import InputError

_FULL = 1 - 1e-9
_STATISTICS = ("mean", "low", "high", "interval", "rank_low", "rank_high", "tie", "rank")


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
        also: further metrics, whose means stand in columns of their names.

    Returns:
        Columns: the one of `by`, rank (missing where unranked), pipeline, origin, mean, low, high (95 %), interval (its
        method), rank_low, rank_high, tie, failures, trials, coverage, ms_per_frame, given; with `vs` diff, diff_low,
        diff_high, diff_p; then those of `also`. `attrs` says what it is of: metric, unit, better, scenes, repetitions,
        over (what the interval is over), units, entrants (who can be ranked), and notes; with `by` one such table for each value under "groups".

    Raises:
        InputError: the metric, the pipeline `vs` or the column `by` is not there, and what is.
    """
    chosen = {name: _of_metric(scores, name) for name in (metric, *also)}
    if vs is not None and vs not in set(trials["pipeline"]):
        raise InputError(f"no pipeline {vs!r} to compare with; the board has {sorted(set(trials['pipeline']))}")
    if by is None:
        return _board(trials, chosen, vs)
    column = _column(trials, by)
    boards = [(value, _board(part, chosen, vs)) for value, part in _parts(trials, column)]
    table = pd.concat([board.assign(**{column: value}) for value, board in boards], ignore_index=True)
    table = table[[column, *(c for c in table.columns if c != column)]]
    table.attrs = {"by": column, "groups": [{**board.attrs, "value": _plain(value)} for value, board in boards]}
    return table


def _board(trials: pd.DataFrame, chosen: dict[str, pd.DataFrame], vs: str | None) -> pd.DataFrame:
    metric, scores = next(iter(chosen.items()))
    pool, unit, better = (str(scores[c].iloc[0]) for c in ("pool", "unit", "better"))
    sign = -1.0 if better == "higher" else 1.0
    planned = pooling.joined_scores(trials, scores)
    rows = planned[planned["block"].isin(planned.loc[planned["value"].notna(), "block"])]  # in the others there is nothing to score
    rows = rows if len(rows) else planned
    ranked, blocks = _ranked(rows)
    units = pooling.units(rows[rows["pipeline"].isin(ranked) & rows["block"].isin(blocks)], pool)
    found = _statistics(units.values, sign) | _unranked(rows[~rows["pipeline"].isin(ranked)], pool)
    table = _facts(trials, rows).join(pd.DataFrame.from_dict(found, orient="index", columns=list(_STATISTICS)))
    table = table.astype({"rank": "Int64", "rank_low": "Int64", "rank_high": "Int64"}).fillna({"interval": "", "tie": ""})
    last = ["ms_per_frame", "given"]
    if vs is not None:
        table = table.join(_against(units.values, vs))
        last += ["diff", "diff_low", "diff_high", "diff_p"]
    for name, other in list(chosen.items())[1:]:
        table[name] = pooling.units(pooling.joined_scores(trials, other), str(other["pool"].iloc[0])).values.mean()
    table["unranked"] = ~table.index.isin(units.values.columns)
    table["good"] = sign * table["mean"]
    table = table.rename_axis("pipeline").reset_index().sort_values(["unranked", "good", "pipeline"], na_position="last", ignore_index=True)
    table = table[["rank", "pipeline", "origin", *_STATISTICS[:-1], "failures", "trials", "coverage", *last, *list(chosen)[1:]]]
    table.attrs = {
        "metric": metric,
        "unit": unit,
        "better": better,
        "scenes": int(planned["scene"].nunique()),
        "repetitions": int(planned.groupby(["scene", "cell"])["block"].nunique().max()),
        "over": units.over,
        "units": len(units.values),
        "entrants": [p for p in table["pipeline"] if p in units.values.columns],
        "vs": vs,
    }
    table.attrs["notes"] = notes.of(table, rows, units.values, blocks, pool)
    return table


def _ranked(rows: pd.DataFrame) -> tuple[list[str], set[int]]:
    """The pipelines that can be ranked, and the blocks that all of them have a score of."""
    trial = rows.groupby(["pipeline", "block"]).agg(scored=("scored", "all"), known=("value", "count"), coverage=("coverage", "min"))
    defined = (trial["known"] > 0) & (trial["coverage"] >= _FULL) | ~trial["scored"]
    sound = defined.groupby("pipeline").all() & trial["scored"].groupby("pipeline").any()
    ranked = sorted(str(p) for p in sound.index[sound])
    complete = trial["scored"].unstack("pipeline").reindex(columns=ranked).fillna(False).astype(bool).all(axis=1)
    return ranked, set(complete.index[complete]) if ranked else set()


def _facts(trials: pd.DataFrame, rows: pd.DataFrame) -> pd.DataFrame:
    """What a row says of a pipeline beside its scores."""
    status = trials["status"].fillna("").astype(str)
    done = trials[status == "ok"]
    seconds = (done["front_end_s"].fillna(0) + done["tracker_s"].fillna(0)).groupby(done["pipeline"]).sum()
    frames = done.groupby("pipeline")["frames"].sum()
    first = trials.drop_duplicates("pipeline").set_index("pipeline")
    each = rows.groupby(["pipeline", "trial_key"])["coverage"].mean()
    return pd.DataFrame(
        {
            "origin": [_origin(row) for row in first.to_dict("records")],
            "failures": (~status.isin(["ok", ""])).groupby(trials["pipeline"]).sum().reindex(first.index),
            "trials": trials.groupby("pipeline").size().reindex(first.index),
            "coverage": each.groupby("pipeline").mean().reindex(first.index),
            "ms_per_frame": (1e3 * seconds / frames.where(frames > 0)).reindex(first.index),
            "given": [_given(value) for value in first["given"]] if "given" in first else "",
        },
        index=first.index,
    )


def _statistics(values: pd.DataFrame, sign: float) -> dict[str, tuple[Any, ...]]:
    """`_STATISTICS` of the ranked pipelines, from their unit values."""
    if values.empty:
        return {}
    ordered = values[list((sign * values.mean()).sort_values(kind="stable").index)]
    x = sign * ordered.to_numpy(float)
    n, k = x.shape
    counts = statistics.resamples(n)
    order, low, high = ([pd.NA] * k for _ in range(3))
    tie = [""] * k
    if n >= statistics.MIN_UNITS:
        order = statistics.ranks(x.mean(axis=0)).tolist()
        low, high = (r.tolist() for r in statistics.rank_intervals(x, counts))
        pairs, p = statistics.pairwise(x)
        tie = statistics.letters(k, [pair for pair, value in zip(pairs, p, strict=True) if value < 1 - statistics.LEVEL])
    own = [(float(v.mean()), *statistics.interval(v, counts)) for v in sign * x.T]
    return {str(name): (*own[j], low[j], high[j], tie[j], order[j]) for j, name in enumerate(ordered.columns)}


def _unranked(rows: pd.DataFrame, pool: str) -> dict[str, tuple[Any, ...]]:
    """`_STATISTICS` of what each other pipeline has a value of."""
    found: dict[str, tuple[Any, ...]] = {}
    for pipeline, mine in rows[rows["value"].notna()].groupby("pipeline"):
        values = pooling.units(mine, pool).values
        if not values.empty:
            v = values.iloc[:, 0].to_numpy(float)
            found[str(pipeline)] = (float(v.mean()), *statistics.interval(v), pd.NA, pd.NA, "", pd.NA)
    return found


def _against(values: pd.DataFrame, vs: str) -> pd.DataFrame:
    """Paired differences to `vs`; negative is a smaller value than its."""
    others = [p for p in values.columns if p != vs] if vs in values.columns else []
    differences = values[others].to_numpy(float) - values[[vs]].to_numpy(float) if others else np.zeros((0, 0))
    p = statistics.holm(statistics.sign_flip(differences)) if len(differences) >= statistics.MIN_UNITS else np.full(len(others), np.nan)
    found = {
        name: (float(d.mean()), *statistics.interval(d)[:2], p[j]) for j, (name, d) in enumerate(zip(others, differences.T, strict=True))
    }
    return pd.DataFrame.from_dict(found, orient="index", columns=["diff", "diff_low", "diff_high", "diff_p"], dtype=float)


def _of_metric(scores: pd.DataFrame, metric: str) -> pd.DataFrame:
    chosen = scores[scores["metric"] == metric]
    if chosen.empty:
        raise InputError(f"no scores of metric {metric!r}; the run has {sorted(set(scores['metric'])) or 'none'}")
    if "metric_sha" in chosen and chosen["metric_sha"].nunique() > 1:
        raise InputError(
            f"metric {metric!r} was computed with {chosen['metric_sha'].nunique()} different settings; compare runs of one setting"
        )
    return chosen


def _column(trials: pd.DataFrame, by: str) -> str:
    columns = [c for c in trials.columns if c.startswith("p_") or c == "scene"]
    found = [c for c in columns if c in (by, f"p_{by}")] or [c for c in columns if c.endswith(f".{by}")]
    if len(found) != 1:
        raise InputError(f"--by {by}: {f'{found} all end so' if found else 'no such column'}; the run can be split by {columns}")
    return found[0]


def _parts(trials: pd.DataFrame, column: str) -> list[tuple[Any, pd.DataFrame]]:
    """The trials of each value; pipelines that a pipeline's sweep does not touch stand on each board."""
    everywhere = trials[trials[column].isna()] if column.startswith("p_pipelines.") else trials.iloc[:0]
    values = sorted(trials[column].dropna().unique(), key=lambda v: (isinstance(v, str), v))
    parts = [(value, pd.concat([trials[trials[column] == value], everywhere])) for value in values]
    rest = trials[trials[column].isna()]
    return parts if len(everywhere) or rest.empty else [*parts, (None, rest)]


def _origin(row: Mapping[Any, Any]) -> str:
    """Distribution and version (of a file without one, the head of its code's hash); * marks uncommitted changes."""
    version = str(row.get("version") or "") or f"@{row.get('code_sha') or ''}"[:5]
    dirty = "*" if row.get("dirty") in (True, np.True_) else ""
    return f"{row.get('distribution') or ''} {version.removesuffix('@')}{dirty}".strip()


def _given(value: Any) -> str:
    if isinstance(value, str):
        return value
    return ", ".join(map(str, value)) if isinstance(value, (list, tuple, np.ndarray)) else ""


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
