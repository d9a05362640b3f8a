"""A metric's value at each evaluation time of a trial, computed again from the stored estimates.

A metric has values of the frames' own where it gives one for each valid evaluation time, also of an empty output, and the
same ones when only every other frame is evaluated. A median or rms over matched targets has not.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sonobench.errors import InputError, SonobenchError
from sonobench.protocols import Series
from sonobench.registry import did_you_mean
from sonobench.report.recordings import Recordings, stored_estimates
from sonobench.scoring import score
from sonobench.types import Estimate, Space, Truth

if TYPE_CHECKING:
    import pandas as pd

    from sonobench.harness.run import Run

_RELATIVE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Output:
    """What a trial is scored by."""

    row: Mapping[str, Any]
    truth: Truth
    estimates: Sequence[Estimate]
    space: Space | None

    @property
    def instants(self) -> int:
        """How many valid evaluation times there are."""
        return len(self.truth.time_s) if self.truth.valid is None else int(self.truth.valid.sum())


@dataclass(frozen=True, slots=True, eq=False)
class FrameMetric:
    """One column of a metric of a run's studies.

    Attributes:
        name: "cardinality.are".
        label, column: "cardinality" and "are".
        metric: the component.
        stored: scores by trial_key and slice.
    """

    name: str
    label: str
    column: str
    metric: Any
    stored: Mapping[str, Mapping[str, float]]

    @classmethod
    def of(cls, run: Run, name: str) -> FrameMetric:
        """Set as the run's studies set it.

        Raises:
            InputError: the run has no scores of it, or it reads scans.
        """
        from sonobench.board.select import of_metric
        from sonobench.components import build

        scores = of_metric(run.scores, name)
        tables = {label: own for study in run.studies for label, own in study.get("metric_tables", {}).items()}
        label = next((m for m in tables if name == m or name.startswith(f"{m}.")), None)
        if label is None:
            raise InputError(f"{run.path}: the run does not say how {name} is set; run it again")
        metric = build("metric", tables[label], run.registry, label)
        if getattr(metric, "reads", "estimates") != "estimates":
            raise InputError(f"{name} reads scans; over time only metrics that read estimates can be drawn")
        stored: dict[str, dict[str, float]] = {}
        for key, part, value in zip(scores["trial_key"], scores["slice"], scores["value"], strict=True):
            stored.setdefault(str(key), {})[str(part)] = float(value)
        return cls(name, label, name.removeprefix(label).removeprefix("."), metric, stored)

    def series(self, output: Output) -> Series:
        """A trial's values.

        Raises:
            InputError: they do not give its stored score, or are not one for each evaluation time.
        """
        made = self.metric.evaluate(output.truth, output.estimates, output.space)
        again = score(_Known(made), output.truth, output.estimates, output.space, self.label)
        before = self.stored.get(str(output.row["trial_key"]), {})
        mine = [(r.value, before.get(r.slice, np.nan)) for r in again if r.metric == self.name]
        if not all(np.isclose(now, then, rtol=_RELATIVE, atol=0, equal_nan=True) for now, then in mine):
            raise InputError(
                f"trial {output.row['trial_key']} ({output.row['pipeline']} on {output.row['scene']}): {self.name} is not what is stored "
                "when it is computed again; `sonobench board RUN --verify` says why"
            )
        found: Series = made[self.column]
        if len(found.values) != output.instants:
            raise _no_own_value(self.name, f"it has {len(found.values)} values for {output.instants} evaluation times")
        return found


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
    """A metric that has been evaluated already."""

    columns: Mapping[str, Series]

    def evaluate(self, truth: Truth, output: Sequence[Any], space: Space | None) -> Mapping[str, Series]:
        return self.columns


def frame_metrics(run: Run, names: Sequence[str], recordings: Recordings) -> list[FrameMetric]:
    """The named metrics, each with values of the frames' own.

    Raises:
        InputError: one is not there, or has none; then the message names those that have.
    """
    found = [FrameMetric.of(run, name) for name in names]
    rows = run.trials[(run.trials["status"] == "ok") & run.trials["estimates_path"].astype(str).str.endswith(".mcap")]
    if rows.empty:
        raise InputError(f"{run.path}: no trial has estimates to draw")
    sample = next(outputs(run, rows.iloc[:1], recordings))
    for one in found:
        if one.column not in _framewise(one.metric, sample):
            have = _drawable(run, sample)
            raise _no_own_value(one.name, f"those that have: {', '.join(have) or 'none'}{did_you_mean(one.name, have)}")
    return found


def outputs(run: Run, trials: pd.DataFrame, recordings: Recordings) -> Iterator[Output]:
    """In the order of `trials`; a trial that failed has an empty output in its pipeline's space."""
    rows: list[dict[str, Any]] = [{str(k): v for k, v in row.items()} for row in trials.to_dict("records")]
    spaces: dict[str, Space] = {}
    for row in rows:
        if row["status"] == "ok" and row["pipeline"] not in spaces:
            spaces[row["pipeline"]] = stored_estimates(run.paths, row)[1]
    for row in rows:
        truth = recordings.of(row).truth
        if row["status"] == "ok":
            yield Output(row, truth, *stored_estimates(run.paths, row))
        else:
            yield Output(row, truth, [], spaces.get(row["pipeline"]))


def _drawable(run: Run, output: Output) -> list[str]:
    """Names of the run's metrics that can be drawn over time."""
    found = []
    for label in run.metrics:
        try:
            names = sorted({n for n in run.scores["metric"] if n == label or n.startswith(f"{label}.")})
            metric = FrameMetric.of(run, names[0]).metric if names else None
        except SonobenchError:  # it cannot be built any more, or reads scans
            continue
        found += [f"{label}.{column}" if column else label for column in _framewise(metric, output)] if metric else []
    return found


def _framewise(metric: Any, output: Output) -> list[str]:
    """Columns of a metric whose values are the frames' own, as one output shows."""
    truth = output.truth
    valid = np.ones(len(truth.time_s), bool) if truth.valid is None else truth.valid
    kept = np.flatnonzero(valid)[::2]
    half = np.zeros(len(valid), bool)
    half[kept] = True
    whole = metric.evaluate(truth, output.estimates, output.space)
    thinned = metric.evaluate(replace(truth, valid=half), output.estimates, output.space)
    empty = metric.evaluate(truth, [], output.space)
    return [
        name
        for name, series in whole.items()
        if len(series.values) == len(empty[name].values) == output.instants
        and len(thinned[name].values) == len(kept)
        and np.allclose(np.asarray(series.values)[::2], thinned[name].values, rtol=_RELATIVE, atol=0, equal_nan=True)
    ]


def _no_own_value(name: str, why: str) -> InputError:
    return InputError(f"{name} has no value of its own at each evaluation time, so it cannot be drawn over time; {why}")
