"""Truth and estimates at the same instants, and what a metric makes of a trial.

Every pipeline is scored at the truth's valid evaluation times: the last estimate at or before such a time stands there
while it is at most `hold_s` old, afterwards there is nobody.
"""

from __future__ import annotations

import math
import re
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from sonobench.errors import InputError, SetupError
from sonobench.protocols import Metric, Series
from sonobench.types import Array, Bools, Estimate, Ints, Setup, Space, Truth

Targets = Literal["exists", "active"]

_POSITION = ("x_m", "y_m", "z_m")
_VELOCITY = ("vx_m_s", "vy_m_s", "vz_m_s")
_DIRECTION = ("azimuth_rad", "elevation_rad")
_UNITS = (("_m_s2", "m/s²"), ("_m_s", "m/s"), ("_rad_s", "rad/s"), ("_rad", "rad"), ("_m", "m"))


class Frame(NamedTuple):
    """Both sides at one valid evaluation time: truth (n, d), active (n,) bool, estimates (m, d), and whose rows they are.

    truth_labels (n,); labels (m,), None where the tracker gives none.
    """

    time_s: float
    truth: Array
    active: Bools
    estimates: Array
    truth_labels: Ints
    labels: Ints | None


@dataclass(frozen=True, slots=True, eq=False)
class Aligned:
    """What a metric compares.

    Attributes:
        space: the compared coordinates (d), in the order of the frames' columns.
        frames: one for each valid evaluation time.
    """

    space: Space
    frames: tuple[Frame, ...]

    @property
    def unit(self) -> str:
        """The unit of a distance: that of all coordinates, or "mixed" (metres with m/s)."""
        units = {next((unit for suffix, unit in _UNITS if name.endswith(suffix)), "1") for name in self.space.names}
        return units.pop() if len(units) == 1 else "mixed"

    def distances(self, frame: Frame) -> Array:
        """Distances (n, m) of a frame's truth rows to its estimate rows: Euclidean, periodic coordinates wrapped; of directions, angles (rad)."""
        truth, estimates = frame.truth[:, None, :], frame.estimates[None, :, :]
        if self.space.names == _DIRECTION:
            from sonobench.directions import separations

            return separations(truth, estimates)
        residual = self.space.residual(truth, estimates)
        return np.sqrt(np.einsum("nmd,nmd->nm", residual, residual))


class ScoreRow(NamedTuple):
    """One row of scores.parquet, short of its trial's key.

    Attributes:
        metric: the metric's name, with its column after a dot ("gospa.missed").
        slice: "" for the whole trial; the index of the evaluation time where `pool` is "frame-rms".
        value: NaN where the metric is undefined and has no `worst`.
        weight: what the value weighs among the trials of one scene.
        unit, better, pool, coverage: as in Series; coverage is 1 where `worst` stands in for what is missing.
    """

    metric: str
    slice: str
    value: float
    weight: float
    unit: str
    better: str
    pool: str
    coverage: float


def aligned(
    truth: Truth,
    estimates: Sequence[Estimate],
    space: Space | None,
    hold_s: float | None = None,
    components: Sequence[str] | None = None,
    targets: Targets = "exists",
) -> Aligned:
    """Pair truth and estimates at every valid evaluation time.

    Args:
        truth: the recording's truth.
        estimates: of one trial, in `space`; [] is a failed trial.
        space: coordinates of the estimates' states; None only together with no estimates.
        hold_s: how long an estimate stands; by default 1.5 times the longer of the truth's and the estimates' period.
        components: names to compare; by default the position (x, y of a planar tracker), else the direction; () compares
            numbers only.
        targets: the truth rows that count: those that exist, or only those that sound.

    Raises:
        SetupError: a component is missing on either side, or the two sides share none.
        InputError: targets is neither "exists" nor "active".
    """
    if targets not in ("exists", "active"):
        raise InputError(f"targets is {targets!r}; 'exists' or 'active' is needed")
    known = truth_coordinates(truth)
    common = _common(known, space, components)
    table = np.array([known[name] for name in common.names]).reshape(len(common), *truth.exists.shape)
    columns = [] if space is None else space.index(*common.names)
    rows = [np.asarray(e.states[:, columns]) for e in estimates]
    nobody, nameless = np.zeros((0, len(common))), None if any(e.labels is None for e in estimates) else np.zeros(0, np.int64)
    counted = truth.exists if targets == "exists" else truth.active
    frames = []
    for k, held in _held(truth, [e.time_s for e in estimates], hold_s):
        here = counted[k]
        found, labels = (nobody, nameless) if held < 0 else (rows[held], estimates[held].labels)
        frames.append(Frame(float(truth.time_s[k]), table[:, k, here].T, truth.active[k, here], found, truth.label[here], labels))
    return Aligned(common, tuple(frames))


def truth_coordinates(truth: Truth) -> Mapping[str, Array]:
    """The coordinates (k, n) that a truth can be compared in, by name.

    Positions always; velocities where the truth has them; azimuth_rad and elevation_rad, in the room's axes, where its
    `parameters` name the point they are seen from (origin_x_m, origin_y_m, origin_z_m).
    """
    known = dict(zip(_POSITION, np.moveaxis(truth.position, -1, 0), strict=True))
    if truth.velocity is not None:
        known |= dict(zip(_VELOCITY, np.moveaxis(truth.velocity, -1, 0), strict=True))
    origin = [truth.parameters.get(f"origin_{name}") for name in _POSITION]
    if None not in origin:
        x, y, z = np.moveaxis(truth.position - np.array(origin, float), -1, 0)
        known |= {"azimuth_rad": np.arctan2(y, x), "elevation_rad": np.arctan2(z, np.hypot(x, y))}
    return known


def score(metric: Metric, truth: Truth, output: Sequence[Any], space: Space | Setup | None, name: str | None = None) -> list[ScoreRow]:
    """Evaluate a metric on one trial and pool its values over the trial's frames.

    Where a column speaks of only a share of the target time (coverage < 1) and has a `worst`, the rest counts as
    `worst` and the row's coverage is 1; without one the value is that of the share, NaN where there is none.

    Args:
        metric: the component.
        truth: the recording's truth.
        output: Estimates in `space`, or Scans for a metric that reads scans; [] is a failed trial.
        space: the tracker's coordinates, or the scans' setup; None where the pipeline never came to have one.
        name: what the rows are called; by default the metric's class name ("PositionError" is position-error).

    Raises:
        InputError: not columns of Series, or a column's values do not fit its weights or its pool.
    """
    title = name or re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", type(metric).__name__).lower()
    rows = []
    columns = metric.evaluate(truth, output, space)
    if not isinstance(columns, Mapping) or not all(isinstance(s, Series) for s in columns.values()):
        raise InputError(f"metric {title}: evaluate must return {{column: Series}}, got {reprlib.repr(columns)}")
    for column, series in columns.items():
        called = f"{title}.{column}" if column else title
        rows += _rows(called, _checked(called, series, truth), truth)
    return rows


def _common(known: Mapping[str, Array], space: Space | None, components: Sequence[str] | None) -> Space:
    """The compared coordinates; raises SetupError naming both sides."""
    theirs = tuple(known) if space is None else space.names
    if components is not None:
        wanted = tuple(components)
    else:
        wanted = tuple(n for n in _POSITION if n in theirs) or tuple(n for n in _DIRECTION if n in theirs)
    if (not wanted and components is None) or any(n not in theirs or n not in known for n in wanted):
        asked = f"components {list(wanted)}" if wanted else "a position or a direction"
        raise SetupError(
            f"the metric compares {asked}; the estimates have {list(theirs)}, the truth has {list(known)};"
            " name components that both sides have (a truth has directions where its parameters give origin_x_m, origin_y_m, origin_z_m)"
        )
    periods = {} if space is None else dict(zip(space.names, space.periods, strict=True))
    return Space(wanted, tuple(periods.get(n, p) for n, p in zip(wanted, Space(wanted).periods, strict=True)))


def _held(truth: Truth, times: Sequence[float], hold_s: float | None) -> list[tuple[int, int]]:
    """For each valid evaluation time its index and that of the estimate that stands there, −1 for none."""
    order = np.argsort(np.asarray(times, float), kind="stable")
    given = np.asarray(times, float)[order]
    periods = [float(np.median(np.diff(t))) for t in (truth.time_s, given) if len(t) > 1]
    if truth.period_s is not None:
        periods.append(truth.period_s)
    hold = 1.5 * max(periods, default=0.0) if hold_s is None else hold_s
    # Times are sums of periods and may count from 1970: equal instants differ by rounding.
    slack = 1e-6 * max(periods, default=0.0) + 4 * np.spacing(np.abs(truth.time_s))
    last = np.searchsorted(given, truth.time_s + slack, side="right") - 1
    fresh = last >= 0
    fresh[fresh] = (truth.time_s - slack)[fresh] - given[last[fresh]] <= hold
    return [(k, int(order[last[k]]) if fresh[k] else -1) for k in _instants(truth)]


def _instants(truth: Truth) -> list[int]:
    """Indices of the valid evaluation times."""
    return [k for k in range(len(truth.time_s)) if truth.valid is None or truth.valid[k]]


def _checked(called: str, series: Series, truth: Truth) -> Series:
    values, weights = np.asarray(series.values, float), np.asarray(series.weights, float)
    if values.ndim != 1 or values.shape != weights.shape:
        raise InputError(f"metric {called}: values {values.shape} and weights {weights.shape}; two vectors of one length are needed")
    if np.isnan(values[weights > 0]).any():
        raise InputError(f"metric {called}: a value is NaN where its weight is above 0; give it weight 0")
    instants = len(_instants(truth))
    if series.pool == "frame-rms" and len(values) != instants:
        raise InputError(f"metric {called}: {len(values)} values for {instants} valid times; frame-rms needs one for each")
    return series


def _rows(called: str, series: Series, truth: Truth) -> list[ScoreRow]:
    values, weights = np.asarray(series.values, float), np.asarray(series.weights, float)
    worst = series.worst if series.coverage < 1 else None
    about = (series.unit, series.better, series.pool, float(series.coverage) if worst is None else 1.0)
    if series.pool == "frame-rms":
        if worst is not None:
            values, weights = np.where(weights > 0, values, worst), np.where(weights > 0, weights, 1.0)
        values = np.where(weights > 0, values, math.nan)
        return [ScoreRow(called, str(k), float(v), float(w), *about) for k, v, w in zip(_instants(truth), values, weights, strict=True)]
    if worst is not None:
        values, weights = _completed(series, worst, len(_instants(truth)))
    return [ScoreRow(called, "", pooled(values, weights, series.pool), float(weights.sum()), *about)]


def _completed(series: Series, worst: float, instants: int) -> tuple[Array, Array]:
    """Values and weights with `worst` for the share that they do not cover; nothing covered weighs one per instant."""
    values, weights, share = np.asarray(series.values, float), np.asarray(series.weights, float), float(series.coverage)
    total = float(weights.sum())
    if total <= 0 or share <= 0:
        values, weights, missing = np.zeros(0), np.zeros(0), float(instants)
    else:
        missing = total * (1 - share) / share
    stand_in = worst * missing if series.pool == "rate" else worst  # a rate's values are sums already
    return np.append(values, stand_in), np.append(weights, missing)


def pooled(values: Array, weights: Array, pool: str) -> float:
    """One number of values (k,) with weights (k,): "mean", "rms", "median" or "rate"; NaN where all weights are 0."""
    counted = weights > 0
    v, w = values[counted], weights[counted]
    if not len(v):
        return math.nan
    if pool == "mean":
        return float(w @ v / w.sum())
    if pool == "rms":
        return float(np.sqrt(w @ v**2 / w.sum()))
    if pool == "rate":
        return float(v.sum() / w.sum())
    if pool == "median":
        return _median(v, w)
    raise InputError(f"pool is {pool!r}; 'mean', 'rms', 'median', 'rate' or 'frame-rms' is needed")


def _median(v: Array, w: Array) -> float:
    """Weighted median, the mean of both middle values where half of the weight lies exactly between them."""
    order = np.argsort(v, kind="stable")
    v, below = v[order], np.cumsum(w[order])
    half = below[-1] / 2
    low = int(np.searchsorted(below, half * (1 - 1e-12)))
    high = min(int(np.searchsorted(below, half * (1 + 1e-12), side="right")), len(v) - 1)
    return float(v[low] + v[high]) / 2
