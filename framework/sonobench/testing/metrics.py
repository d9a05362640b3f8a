"""What a metric must do with any truth and output."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sonobench.protocols import Series
from sonobench.testing import fixtures
from sonobench.testing.kit import Case, Skip, claim, need
from sonobench.types import Estimate, Scan, Space, Truth

_METRIC = ("metric",)
_SPACE = Space.of("x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s")


def _estimates(truth: Truth, offset_m: float = 0.0, shuffle: int | None = None) -> list[Estimate]:
    """The truth as estimates, `offset_m` off along x, rows shuffled on request."""
    rng = np.random.default_rng(shuffle)
    found = []
    for k, time_s in enumerate(truth.time_s):
        n = truth.position.shape[1]
        order = np.arange(n) if shuffle is None else rng.permutation(n)
        velocity = np.zeros((n, 3)) if truth.velocity is None else truth.velocity[k]
        states = np.concatenate([truth.position[k] + [offset_m, 0.0, 0.0], velocity], axis=1)[order]
        found.append(Estimate(time_s, states, labels=truth.label[order], count=float(n)))
    return found


def _nobody(truth: Truth) -> list[Estimate]:
    return [Estimate(t, np.zeros((0, len(_SPACE))), labels=np.zeros(0, int), count=0.0) for t in truth.time_s]


def _evaluate(case: Case, truth: Truth, output: Sequence[Any]) -> Mapping[str, Series]:
    if getattr(case.component, "reads", "estimates") == "scans":
        return dict(case.component.evaluate(truth, _scans(truth) if output else [], fixtures.setup("pairs") if output else None))
    return dict(case.component.evaluate(truth, output, _SPACE))


def _scans(truth: Truth) -> list[Scan]:
    return fixtures.scans(fixtures.setup("pairs"), truth.time_s)


def _total(series: Series) -> float:
    """The weighted mean; a signed error (a bias) counts by its size where lower is better."""
    counted = series.weights > 0
    mean = float(np.sum(series.values[counted] * series.weights[counted]) / max(np.sum(series.weights[counted]), 1e-300))
    return abs(mean) if series.better == "lower" else mean


def _equal(a: Series, b: Series) -> bool:
    return np.allclose(a.values, b.values, rtol=1e-9, atol=1e-12, equal_nan=True) and np.allclose(a.weights, b.weights)


def _estimates_only(case: Case) -> None:
    if getattr(case.component, "reads", "estimates") != "estimates":
        raise Skip("it reads scans, no estimates")


@claim("metric.runs", _METRIC)
def runs(case: Case) -> None:
    """A metric gives columns of ordinary output."""
    truth = fixtures.truth()
    columns = _evaluate(case, truth, _estimates(truth, 0.1))
    need(columns and all(isinstance(s, Series) for s in columns.values()), f"gave {columns!r:.100}; a mapping of Series is needed")


@claim("metric.columns", _METRIC, ["metric.runs"])
def columns_fit(case: Case) -> None:
    """Values and weights fit each other, values are NaN only where the weight is 0, and coverage is in [0, 1].

    Only "frame-rms" must have one value an evaluation time: other pools may also pool over targets (a median of errors).
    """
    truth = fixtures.truth()
    for name, s in _evaluate(case, truth, _estimates(truth, 0.1)).items():
        values, weights = np.asarray(s.values), np.asarray(s.weights)
        fit = values.ndim == 1 and values.shape == weights.shape and (s.pool != "frame-rms" or len(values) == len(truth.time_s))
        need(fit, f"column {name!r}: values {values.shape} and weights {weights.shape} at {len(truth.time_s)} evaluation times")
        need((weights >= 0).all(), f"column {name!r}: a weight is negative")
        need(np.isfinite(values[weights > 0]).all(), f"column {name!r}: NaN where the weight is not 0")
        need(0 <= s.coverage <= 1, f"column {name!r}: coverage is {s.coverage}")


@claim("metric.repeats", _METRIC, ["metric.runs"])
def repeats(case: Case) -> None:
    """The same truth and output give the same columns."""
    truth = fixtures.truth()
    first, second = (_evaluate(case, truth, _estimates(truth, 0.1)) for _ in range(2))
    need(first.keys() == second.keys() and all(_equal(first[n], second[n]) for n in first), "two evaluations of the same differ")


@claim("metric.rows", _METRIC, ["metric.repeats"])
def rows(case: Case) -> None:
    """The order of an estimate's rows carries no meaning."""
    _estimates_only(case)
    truth = fixtures.truth()
    first, second = (_evaluate(case, truth, _estimates(truth, 0.1, s)) for s in (None, 7))
    for name in first:
        need(_equal(first[name], second[name]), f"column {name!r} changes with the order of the rows")


@claim("metric.perfect", _METRIC, ["metric.repeats"])
def perfect(case: Case) -> None:
    """The truth itself never scores worse than estimates half a metre off or nobody at all."""
    _estimates_only(case)
    truth = fixtures.truth()
    best = _evaluate(case, truth, _estimates(truth))
    for what, output in {"half a metre off": _estimates(truth, 0.5), "nobody": _nobody(truth)}.items():
        for name, series in _evaluate(case, truth, output).items():
            if series.weights.sum() and name in best and best[name].weights.sum():
                gain = _total(series) - _total(best[name])
                gain = gain if series.better == "higher" else -gain
                need(
                    gain <= 1e-9,
                    f"column {name!r} scores {_total(series):.4g} for {what}, {_total(best[name]):.4g} for the truth; {series.better} is better",
                )


@claim("metric.nobody", _METRIC, ["metric.repeats"])
def nobody(case: Case) -> None:
    """Nobody there and nobody found is a perfect score: finite, and 0 where lower is better."""
    _estimates_only(case)
    truth = fixtures.nobody()
    for name, series in _evaluate(case, truth, _nobody(truth)).items():
        values = np.asarray(series.values)[np.asarray(series.weights) > 0]
        need(np.isfinite(values).all(), f"column {name!r} is not finite where nobody is there and nobody found")
        if series.better == "lower":
            need(np.allclose(values, 0), f"column {name!r} is {values[:3].tolist()} where nobody is there and nobody found; 0 is needed")


@claim("metric.failed", _METRIC, ["metric.repeats"])
def failed(case: Case) -> None:
    """A failed trial, an empty list, scores like empty output: no better than the truth, and says what stands in where it is undefined."""
    truth = fixtures.truth()
    good = _evaluate(case, truth, _estimates(truth))
    bad = _evaluate(case, truth, [])
    need(bad.keys() == good.keys(), f"a failed trial has columns {sorted(bad)}, a finished one {sorted(good)}; the same are needed")
    for name, series in bad.items():
        defined = np.asarray(series.weights) > 0
        if not defined.any():
            need(
                series.worst is not None or series.coverage < 1,
                f"column {name!r} is undefined for a failed trial; give `worst`, or a coverage below 1",
            )
            continue
        values = np.asarray(series.values)[defined]
        need(np.isfinite(values).all() or series.worst is not None, f"column {name!r} of a failed trial is not finite")
        if good[name].weights.sum() and np.isfinite(values).all():
            gain = (_total(series) - _total(good[name])) * (1 if series.better == "higher" else -1)
            need(
                gain <= 1e-9,
                f"column {name!r} scores {_total(series):.4g} for a failed trial and {_total(good[name]):.4g} for the truth; {series.better} is better",
            )
