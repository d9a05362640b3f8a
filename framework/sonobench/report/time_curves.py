"""Metrics at every evaluation time, pooled over the recordings of one scenario, computed again from stored estimates.

Each frame's pooled value and 95 % interval are the board's (`sonobench.board`): units are the scenario's recordings, a
trial that failed counts as empty output, and only recordings that every pipeline has a score of are used.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sonobench.board.bootstrap import bootstrap
from sonobench.board.pooling import units
from sonobench.board.rows import Coded, Rows, coded
from sonobench.board.statistics import intervals
from sonobench.errors import InputError
from sonobench.protocols import Series
from sonobench.report.frame_values import FrameMetric, frame_metrics, outputs
from sonobench.report.recordings import Recordings
from sonobench.report.selection import metrics_of, scene_columns
from sonobench.scoring import aligned
from sonobench.types import Array, Ints

if TYPE_CHECKING:
    import pandas as pd

    from sonobench.harness.run import Run

NUMBER = "number"  #: what the estimated number of targets is called among the metrics
_AT_ONCE = 200  # columns that are resampled together


@dataclass(frozen=True, slots=True, eq=False)
class _Frames:
    """One column of one metric on some trials: values and weights (trials, frames)."""

    values: Array
    weights: Array
    unit: str
    pool: str


def over_time(run: Run, metrics: Sequence[str] = ()) -> pd.DataFrame:
    """Metrics, and the number of targets, at every evaluation time of every scenario (a scene with its swept values).

    Args:
        run: all of it is used; `run.where(...)` narrows it down.
        metrics: names, or patterns such as "ospa*"; by default the run's first.

    Returns:
        Columns: scene, those swept in scenes, metric ("number" is the reported number of targets), unit, time_s, pipeline,
        n (recordings), mean, low, high (95 %), targets (the true number, mean over the recordings). `attrs`: metrics,
        left_out (how many recordings of a scenario not every pipeline has a score of),
        without (pipelines without any score in one of the metrics).

    Raises:
        InputError: a metric that is not there or has no value of a frame's own; recordings of a scenario with different
            evaluation times; or stored estimates do not give the stored scores any more.
    """
    import pandas as pd

    wanted = metrics_of(run, metrics)
    recordings = Recordings(run)
    built = frame_metrics(run, wanted, recordings)
    columns = scene_columns(run.trials)
    tables: list[pd.DataFrame] = []
    left_out: dict[tuple[Any, ...], int] = {}
    for scenario in scenarios_of(run.trials):
        whole, dropped = _complete(run, _of(run.trials, scenario), wanted)
        if dropped:
            left_out[tuple(scenario.values())] = dropped
        if len(whole):
            tables.append(_scenario(run, whole, built, recordings).assign(**scenario))
    if not tables:
        raise InputError(f"{run.path}: no recording has a score of {', '.join(wanted)} for every pipeline; choose some (--pipeline)")
    table = pd.concat(tables, ignore_index=True)
    table = table[["scene", *columns, *(c for c in table.columns if c not in ("scene", *columns))]]
    table.attrs = {"metrics": wanted, "left_out": left_out, "without": sorted(set(run.trials["pipeline"]) - set(table["pipeline"]))}
    return table


def scenarios_of(trials: pd.DataFrame) -> list[dict[str, Any]]:
    """Every scenario's scene and swept values by column, None where a value is missing, in their order."""
    import pandas as pd

    columns = ["scene", *scene_columns(trials)]
    found = trials[columns].drop_duplicates().sort_values(columns)
    return [{str(c): None if pd.isna(v) else v for c, v in row.items()} for row in found.to_dict("records")]


def _of(trials: pd.DataFrame, scenario: Mapping[str, Any]) -> pd.DataFrame:
    for column, value in scenario.items():
        trials = trials[trials[column].isna() if value is None else trials[column] == value]
    return trials


def _scenario(run: Run, trials: pd.DataFrame, built: Sequence[FrameMetric], recordings: Recordings) -> pd.DataFrame:
    """All rows of one scenario."""
    import pandas as pd

    trials = trials.sort_values(["recording_key", "pipeline", "run"], ignore_index=True)
    found: dict[str, list[Series]] = {name: [] for name in (*(m.name for m in built), NUMBER)}
    exist: list[list[int]] = []
    times: list[Array] = []
    for output in outputs(run, trials, recordings):
        frames = aligned(output.truth, output.estimates, output.space, None, ()).frames
        times.append(np.array([f.time_s for f in frames]))
        if len(times[-1]) != len(times[0]) or not np.allclose(times[-1], times[0], rtol=0, atol=1e-9):
            raise InputError(
                f"{output.row['scene']}: its recordings have different evaluation times; they cannot be pooled at each of them"
            )
        exist.append([len(f.truth) for f in frames])
        found[NUMBER].append(Series(np.array([float(len(f.estimates)) for f in frames]), np.ones(len(frames)), "1"))
        for metric in built:
            found[metric.name].append(metric.series(output))
    codes, targets = coded(trials), np.mean(exist, axis=0)
    parts = [_pooled(name, _stacked(series), codes, times[0]) for name, series in found.items()]
    return pd.concat([part.assign(targets=np.resize(targets, len(part))) for part in parts], ignore_index=True)


def _pooled(name: str, frames: _Frames, codes: Coded, time_s: Array) -> pd.DataFrame:
    """Mean and interval at each frame: for the board's statistics a frame of a pipeline is a pipeline of its own."""
    import pandas as pd

    trials, count = frames.values.shape
    many = len(codes.pipelines) * count
    each = (codes.pipeline[:, None] * count + np.arange(count)).ravel()
    scenario, take, block = (np.repeat(c, count) for c in (codes.scenario, codes.take, codes.block))
    spread = Coded(tuple(map(str, range(many))), each, scenario, codes.scene, take, block, np.repeat(codes.ok, count))
    size = trials * count
    rows = Rows(
        spread, np.arange(size), np.zeros(size, np.int64), frames.values.ravel(), frames.weights.ravel(), np.ones(size), np.ones(size, bool)
    )
    whole = np.bincount(each[np.isfinite(rows.value) & (rows.weight > 0)], minlength=many)
    told = np.full((many, 4), np.nan)
    told[:, 0] = 0
    for group in _alike(whole, np.bincount(each, minlength=many)):
        member = np.isin(each, group)
        mine = units(rows.only(member), frames.pool)
        draws = bootstrap(mine)
        told[mine.pipelines] = [(draws.n, v, *i[:2]) for v, i in zip(draws.value, intervals(draws), strict=True)]
    return pd.DataFrame(
        {
            "metric": name,
            "unit": frames.unit,
            "time_s": np.tile(time_s, len(codes.pipelines)),
            "pipeline": np.repeat(codes.pipelines, count),
            "n": told[:, 0].astype(np.int64),
            **dict(zip(("mean", "low", "high"), told[:, 1:].T, strict=True)),
        }
    )


def _alike(there: Ints, planned: Ints) -> Iterator[Ints]:
    """Columns that can be resampled together: those without gaps, some at a time; every other by itself."""
    full = np.flatnonzero((there == planned) & (there > 0))
    yield from (full[k : k + _AT_ONCE] for k in range(0, len(full), _AT_ONCE))
    yield from (np.array([k]) for k in np.flatnonzero((there < planned) & (there > 0)))


def _stacked(found: Sequence[Series]) -> _Frames:
    """Values as the board's pooling takes them: `worst` stands where a metric is undefined and has one."""
    values, weights = [], []
    for series in found:
        v, w = np.asarray(series.values, float), np.asarray(series.weights, float)
        if series.pool == "rate":  # its values are sums already
            v = np.divide(v, w, out=np.full(len(v), np.nan), where=w > 0)
        if series.worst is not None and series.coverage < 1:
            v, w = np.where(w > 0, v, series.worst), np.where(w > 0, w, 1.0)
        values.append(np.where(w > 0, v, np.nan))
        weights.append(w)
    return _Frames(np.array(values), np.array(weights), found[0].unit, found[0].pool)


def _complete(run: Run, trials: pd.DataFrame, metrics: Sequence[str]) -> tuple[pd.DataFrame, int]:
    """The trials on recordings that every pipeline with any score has a score of in every metric, and how many are left out."""
    import pandas as pd

    scored = [set(run.scores.loc[run.scores["metric"] == name, "trial_key"]) for name in metrics]
    has = trials["trial_key"].isin(set.intersection(*scored))
    trials = trials[trials["pipeline"].isin(trials.loc[has, "pipeline"])]
    block = pd.Series(coded(trials).block, trials.index) if len(trials) else pd.Series(dtype=np.int64)
    lost = set(block[~has.loc[trials.index]])
    return trials[~block.isin(lost)], len(lost)
