"""What a tracker must do with any scans."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from sonobench import pipeline
from sonobench.errors import SetupError
from sonobench.testing import fixtures
from sonobench.testing.kit import Case, Skip, broken, claim, need, unmet
from sonobench.types import Detections, Estimate, Scan, Setup

_TRACKER = ("tracker",)
_FRAMES = 8
_SEED = 5


def told(tracker: Any) -> Setup:
    """The first synthetic setup that the tracker takes.

    Raises:
        Skip: it takes none.
    """
    refused: list[str] = []
    for grouping in ("pairs", "stack", "both", "positions", "directions"):
        setup = fixtures.setup(grouping)
        try:
            tracker.init(np.random.default_rng(_SEED), setup)
        except SetupError as error:
            refused.append(str(error))
        else:
            return setup
    raise unmet(refused)


def run(tracker: Any, setup: Setup, scans: Sequence[Scan], seed: int = _SEED) -> list[Estimate]:
    """Estimates without the pipeline's guard, so that one fault is one finding."""
    rng = np.random.default_rng(seed)
    offline = getattr(tracker, "run", None)
    if callable(offline):
        return list(offline(rng, setup, scans))
    state, estimates = tracker.init(rng, setup), []
    for scan in scans:
        state, estimate = tracker.step(rng, state, scan)
        estimates.append(estimate)
    return estimates


def same(a: Estimate, b: Estimate, tolerance: float = 1e-9) -> bool:
    """Whether two estimates hold the same states, as sets."""
    x, y = np.asarray(a.states), np.asarray(b.states)
    if x.shape != y.shape or not len(x):
        return x.shape == y.shape
    return bool(np.allclose(x[np.lexsort(np.round(x.T, 6))], y[np.lexsort(np.round(y.T, 6))], rtol=0, atol=tolerance))


def number(estimate: Estimate) -> float:
    """The expected number where it is given, else the number of states."""
    return len(estimate.states) if estimate.count is None else float(estimate.count)


def _steps_only(tracker: Any) -> None:
    if callable(getattr(tracker, "run", None)):
        raise Skip("a smoother's run() has no state between scans")


@claim("tracker.runs", _TRACKER)
def runs(case: Case) -> None:
    """A tracker takes ordinary scans and gives an estimate for each."""
    setup = told(case.component)
    estimates = run(case.component, setup, fixtures.scans(setup, fixtures.regular(_FRAMES)))
    need(all(isinstance(e, Estimate) for e in estimates), f"gave {[type(e).__name__ for e in estimates][:3]}; Estimates are needed")


@claim("tracker.estimates", _TRACKER, ["tracker.runs"])
def estimates_fit(case: Case) -> None:
    """One estimate a scan, at the scan's time, in the tracker's space."""
    setup = told(case.component)
    try:
        pipeline.track(case.component, setup, fixtures.scans(setup, fixtures.regular(_FRAMES)), np.random.default_rng(_SEED))
    except pipeline.InvalidOutput as fault:
        broken(str(fault))


@claim("tracker.finite", _TRACKER, ["tracker.runs"])
def finite(case: Case) -> None:
    """No NaN leaves a tracker, and covariances are symmetric and positive semidefinite."""
    setup = told(case.component)
    for estimate in run(case.component, setup, fixtures.scans(setup, fixtures.regular(_FRAMES))):
        _finite(estimate)


def _finite(estimate: Estimate) -> None:
    for name in ("states", "covs", "existence", "count"):
        value = getattr(estimate, name)
        need(value is None or np.isfinite(value).all(), f"{name} at {estimate.time_s} s hold NaN or infinity")
    need(estimate.existence is None or (estimate.existence >= 0).all(), f"existence at {estimate.time_s} s is negative")
    need(estimate.count is None or estimate.count >= 0, f"count at {estimate.time_s} s is {estimate.count}")
    if estimate.covs is not None and len(estimate.covs):
        scale = np.abs(estimate.covs).max(axis=(1, 2), keepdims=True) + 1e-300
        unit = estimate.covs / scale
        need(np.allclose(unit, np.swapaxes(unit, 1, 2), atol=1e-8), f"a covariance at {estimate.time_s} s is not symmetric")
        low = np.linalg.eigvalsh(unit).min()
        need(low > -1e-8, f"a covariance at {estimate.time_s} s has the eigenvalue {low:.2g} of its largest entry; none below 0 is needed")


@claim("tracker.seed", _TRACKER, ["tracker.runs"])
def seed(case: Case) -> None:
    """The same generator seed gives the same estimates."""
    setup = told(case.component)
    scans = fixtures.scans(setup, fixtures.regular(_FRAMES))
    for a, b in zip(run(case.component, setup, scans), run(case.component, setup, scans), strict=True):
        need(
            same(a, b, 0.0),
            f"two runs from one seed differ at {a.time_s} s; draw only from the generator that is passed, keep nothing outside the state",
        )


@claim("tracker.mutation", _TRACKER, ["tracker.seed"])
def mutation(case: Case) -> None:
    """A step changes neither state nor scan: two steps from one state give the same."""
    tracker = case.component
    _steps_only(tracker)
    setup = told(tracker)
    *before, here, after = fixtures.scans(setup, fixtures.regular(4))
    rng = np.random.default_rng(_SEED)
    state = tracker.init(rng, setup)
    for scan in before:
        state, _ = tracker.step(rng, state, scan)
    branches = []
    for _ in range(2):
        own = copy.deepcopy(rng)
        following, first = tracker.step(own, state, here)
        branches.append((first, tracker.step(own, following, after)[1]))
    need(
        all(same(a, b, 0.0) for a, b in zip(*branches, strict=True)),
        "a second step from the same state gives another estimate; build a new state, do not write into the old one",
    )


@claim("tracker.state", _TRACKER, ["tracker.seed"])
def state_travels(case: Case) -> None:
    """A tracker's state survives pickling and goes on the same."""
    tracker = case.component
    _steps_only(tracker)
    setup = told(tracker)
    *before, last = fixtures.scans(setup, fixtures.regular(4))
    rng = np.random.default_rng(_SEED)
    state = tracker.init(rng, setup)
    for scan in before:
        state, _ = tracker.step(rng, state, scan)
    try:
        again = pickle.loads(pickle.dumps(state))
    except Exception as error:
        broken(f"its state cannot be pickled ({type(error).__name__}: {error}); hold arrays and dataclasses, no functions or generators")
    here, there = (tracker.step(copy.deepcopy(rng), s, last)[1] for s in (state, again))
    need(same(here, there, 0.0), "a pickled state goes on with other estimates than the state itself")


@claim("tracker.nothing", _TRACKER, ["tracker.seed"])
def nothing(case: Case) -> None:
    """No rows at all are an ordinary thing, and a set of 0 rows is the same as no set."""
    setup = told(case.component)
    times = fixtures.regular(_FRAMES)
    dz = {len(s.space) for s in setup.sensors}
    empty = tuple(Detections(np.zeros((0, d)), np.zeros(0, int)) for d in dz)
    bare = [fixtures.silent(setup, t, True) for t in times]
    with_sets = [Scan(s.time_s, s.searched, empty) for s in bare]
    for a, b in zip(run(case.component, setup, bare), run(case.component, setup, with_sets), strict=True):
        need(same(a, b), f"a set of 0 rows and no set give different estimates at {a.time_s} s")


@claim("tracker.searched", _TRACKER, ["tracker.nothing"])
def searched(case: Case) -> None:
    """A sensor that did not search says nothing: it is no miss.

    Where three scans of misses lower the expected number of targets by a quarter, three scans without a search must
    leave it higher than the misses do, unless the last scan alone decides it.
    """
    setup = told(case.component)
    warm = fixtures.scans(setup, fixtures.regular(_FRAMES), clutter=0)
    if _forgets(case.component, setup, warm):
        return
    later = fixtures.PERIOD_S * np.arange(_FRAMES + 1, _FRAMES + 4)
    silence, misses = (
        [number(e) for e in run(case.component, setup, [*warm, *(fixtures.silent(setup, t, s) for t in later)])][_FRAMES - 1 :]
        for s in (False, True)
    )
    for k in range(1, 4):
        if misses[k] < 0.75 * misses[0]:
            need(
                silence[k] > misses[k],
                f"{k} scans that searched nothing lower the expected number from {silence[0]:.3g} to {silence[k]:.3g}, as {k} misses do "
                f"({misses[k]:.3g}); apply a miss only to sensors whose `searched` is True",
            )


def _forgets(tracker: Any, setup: Setup, scans: Sequence[Scan]) -> bool:
    """Whether the last scan alone decides the last estimate."""
    silence = [fixtures.silent(setup, s.time_s, False) for s in scans[:-1]]
    return same(run(tracker, setup, scans)[-1], run(tracker, setup, [*silence, scans[-1]])[-1])


@claim("tracker.many", _TRACKER, ["tracker.finite"])
def many(case: Case) -> None:
    """Forty rows a sensor are taken."""
    setup = told(case.component)
    for estimate in run(case.component, setup, fixtures.scans(setup, fixtures.regular(3), clutter=38)):
        _finite(estimate)


@claim("tracker.irregular", _TRACKER, ["tracker.finite"])
def irregular(case: Case) -> None:
    """Scans may come at any times, and a setup may have no period."""
    import dataclasses

    setup = dataclasses.replace(told(case.component), period_s=None)
    times = np.cumsum([0.03, 0.1, 0.1, 0.45, 0.02, 0.1, 1.3, 0.001])
    for estimate in run(case.component, setup, fixtures.scans(setup, times)):
        _finite(estimate)


@claim("tracker.dt", _TRACKER, ["tracker.seed", "tracker.searched"])
def uses_dt(case: Case) -> None:
    """A tracker with memory moves it by the time that passed, not by the number of scans.

    The same rows five times slower must change the last estimate, unless the last scan alone decides it.
    """
    import dataclasses

    tracker, setup = case.component, told(case.component)
    times = fixtures.regular(_FRAMES)
    scans = fixtures.scans(setup, times)
    last = run(tracker, setup, scans)[-1]
    if _forgets(tracker, setup, scans):
        return
    slow = dataclasses.replace(setup, period_s=5 * fixtures.PERIOD_S)
    stretched = [dataclasses.replace(s, time_s=5 * s.time_s) for s in scans]
    need(
        not same(last, run(tracker, slow, stretched)[-1]),
        "the same rows at five times the interval give the same last estimate; predict over scan.time_s minus the state's time",
    )


@claim("tracker.rows", _TRACKER, ["tracker.seed"])
def rows(case: Case) -> None:
    """The order of a scan's rows carries no meaning."""
    setup = told(case.component)
    scans = fixtures.scans(setup, fixtures.regular(_FRAMES))
    shuffle = np.random.default_rng(11)
    others = [fixtures.permuted(s, shuffle) for s in scans]
    for a, b in zip(run(case.component, setup, scans), run(case.component, setup, others), strict=True):
        need(
            same(a, b) and abs(number(a) - number(b)) < 1e-6,
            f"the same rows in another order give other estimates at {a.time_s} s: {a.states.tolist()} and {b.states.tolist()}",
        )


@claim("tracker.planar", _TRACKER, ["tracker.finite"])
def planar(case: Case) -> None:
    """Microphones and talkers in one plane are a setup like any other, for a planar state."""
    if "z_m" in case.component.space.names:
        raise Skip("its space has z_m, which a planar setup does not tell")
    taken = told(case.component).sensors
    grouping = "pairs" if len(taken) == 4 else {"tdoa": "stack", "position": "positions"}.get(taken[0].kind, "directions")
    setup = fixtures.setup(grouping, planar=True)
    try:
        estimates = run(case.component, setup, fixtures.scans(setup, fixtures.regular(_FRAMES)))
    except SetupError as error:
        raise unmet([error]) from None
    for estimate in estimates:
        _finite(estimate)


@claim("tracker.foreign", _TRACKER, ["tracker.runs"])
def foreign(case: Case) -> None:
    """A setup without the sensors that it reads is refused at init by a SetupError that names both sides."""
    refused(lambda strange: run(case.component, strange, [fixtures.silent(strange, 0.1, True)]), "init", told(case.component))


def refused(begin: Callable[[Setup], Any], what: str, taken: Setup) -> None:
    """`begin` can do with a setup of foreign sensors, or raises a SetupError that names what came and what was needed."""
    strange = fixtures.foreign_setup()
    try:
        begin(strange)
    except SetupError as error:
        came, needed = {strange.sensors[0].kind, strange.sensors[0].name}, {s.kind for s in taken.sensors}
        need(any(w in str(error) for w in came), f"{what} refuses foreign sensors without naming them ({sorted(came)}): {error}")
        need(
            any(w in str(error) for w in needed),
            f"{what} refuses foreign sensors without naming those it reads ({sorted(needed)}): {error}",
        )
    except Exception as error:
        broken(
            f"{what} meets foreign sensors with {type(error).__name__}: {error}; look sensors up with Setup.of_kind, or raise a SetupError"
        )
