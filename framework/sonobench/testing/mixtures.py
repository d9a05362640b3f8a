"""What transforms and births must do."""

from __future__ import annotations

import copy
import dataclasses
import itertools
from typing import Any

import numpy as np

from sonobench.errors import SetupError
from sonobench.protocols import Mixture
from sonobench.testing import fixtures
from sonobench.testing.kit import Case, claim, need, unmet, untouched
from sonobench.types import Space

_TRANSFORM, _BIRTH, _SPAWN = ("transform",), ("birth",), ("spawn",)


def _linear(d: int = 4, dz: int = 2) -> fixtures.LinearMeasurement:
    rng = np.random.default_rng(12)
    return fixtures.LinearMeasurement(rng.standard_normal((dz, d)), rng.standard_normal(dz))


@claim("transform.runs", _TRANSFORM)
def transform_runs(case: Case) -> None:
    """A transform gives points, and the moments of a measurement."""
    m, P, _ = fixtures.gaussians(fixtures.SPACES[0])
    need(len(case.component.points(m, P)) == 2, "points must return (points, weights)")
    need(len(case.component.measure(m, P, _linear(), 0)) == 3, "measure must return (ẑ, covariance, cross-covariance)")


@claim("transform.mutation", _TRANSFORM, ["transform.runs"])
def transform_mutation(case: Case) -> None:
    """Arguments are left as they came."""
    m, P, _ = fixtures.gaussians(fixtures.SPACES[0])
    untouched(case.component.points, m, P)
    untouched(lambda a, b: case.component.measure(a, b, _linear(), 0), m, P)


@claim("transform.shapes", _TRANSFORM, ["transform.mutation"])
def transform_shapes(case: Case) -> None:
    """Points (…, p, d) with weights (p,); ẑ (…, dz), covariance (…, dz, dz), cross-covariance (…, d, dz)."""
    m, P, _ = fixtures.gaussians(fixtures.SPACES[0])
    for batch in ((5,), (), (0,)):
        mean, cov = (m, P) if batch == (5,) else (m[0], P[0]) if batch == () else (m[:0], P[:0])
        x, w = case.component.points(mean, cov)
        got = [np.shape(x)[:-2], np.shape(x)[-1], np.shape(x)[-2], *map(np.shape, case.component.measure(mean, cov, _linear(), 0))]
        wanted = [batch, 4, len(w), (*batch, 2), (*batch, 2, 2), (*batch, 4, 2)]
        need(
            got == wanted, f"Gaussians of batch shape {batch}: (points', weights', ẑ's, covariances') shapes are {got}; {wanted} are needed"
        )


@claim("transform.points", _TRANSFORM, ["transform.mutation"])
def transform_points(case: Case) -> None:
    """The points' weighted mean is the mean, and their weights sum to one."""
    m, P, _ = fixtures.gaussians(fixtures.SPACES[0])
    x, w = (np.asarray(a) for a in case.component.points(m, P))
    need(abs(w.sum() - 1) < 1e-9, f"the weights sum to {w.sum()}")
    need(np.allclose(np.einsum("p,npd->nd", w, x), m), "the points' weighted mean is not the mean")


@claim("transform.linear", _TRANSFORM, ["transform.shapes"])
def transform_linear(case: Case) -> None:
    """Gaussians pass through a linear function exactly."""
    m, P, _ = fixtures.gaussians(fixtures.SPACES[0])
    through = _linear()
    z, S, C = case.component.measure(m, P, through, 0)
    wanted = {"ẑ": m @ through.H.T + through.b, "the covariance": through.H @ P @ through.H.T, "the cross-covariance": P @ through.H.T}
    for (name, exact), got in zip(wanted.items(), (z, S, C), strict=True):
        need(np.allclose(got, exact, rtol=1e-7, atol=1e-9), f"{name} of a linear function is off by {np.abs(got - exact).max():.2g}")


def _begun(case: Case) -> tuple[Any, Any, Space, list[Any]]:
    """(memory, live, space, scans) on the first space and setup that the birth takes.

    Raises:
        Skip: it takes none.
    """
    reasons: list[str] = []
    for space, grouping in itertools.product(fixtures.SPACES, ("stack", "pairs", "positions", "directions")):
        setup = fixtures.setup(grouping)
        try:
            memory = case.component.start(space, setup, fixtures.SensorMeasurement(space, setup))
        except SetupError as error:
            reasons.append(str(error))
            continue
        live = Mixture(np.zeros(0), np.zeros((0, len(space))), np.zeros((0, len(space), len(space))), np.zeros(0, np.int64))
        return memory, live, space, fixtures.scans(setup, fixtures.regular(3))
    raise unmet(reasons)


def _proposals(case: Case, seed: int = 2, silent: bool = False) -> list[Mixture]:
    memory, live, _, scans = _begun(case)
    rng = np.random.default_rng(seed)
    found = []
    for scan in scans:
        shown = dataclasses.replace(scan, detections=()) if silent else scan
        memory, born = case.component.propose(rng, memory, shown, live)
        found.append(born)
    return found


def _alike(a: Mixture, b: Mixture) -> bool:
    return all(np.shape(x) == np.shape(y) and np.array_equal(x, y) for x, y in zip(a, b, strict=True))


@claim("birth.runs", _BIRTH)
def birth_runs(case: Case) -> None:
    """A birth model starts on a setup and proposes mixtures."""
    need(isinstance(case.component.uses_scan, bool), f"uses_scan is {case.component.uses_scan!r}; True or False is needed")
    for born in _proposals(case):
        need(len(born) == 4, f"propose gave {type(born).__name__}; (memory, Mixture(w, m, P, mode)) is needed")


@claim("birth.mixture", _BIRTH, ["birth.runs"])
def birth_mixture(case: Case) -> None:
    """Born components are w (J,) ≥ 0, m (J, d), P (J, d, d) symmetric and positive semidefinite, mode (J,) of integers."""
    d = len(_begun(case)[2])
    memory, *_ = _begun(case)
    known = getattr(case.component, "initial", None)
    for born in [*_proposals(case), *_proposals(case, silent=True), *([] if known is None else [known(memory)])]:
        _sound(born, d)


def _sound(born: Mixture, d: int) -> None:
    w, m, P, mode = born
    n = len(w)
    shapes = [np.shape(a) for a in (w, m, P, mode)]
    need(shapes == [(n,), (n, d), (n, d, d), (n,)], f"shapes of w, m, P, mode are {shapes} for {d} coordinates")
    need(all(np.isfinite(a).all() for a in (w, m, P)), "a born component holds NaN or infinity")
    need((np.asarray(w) >= 0).all(), f"a weight is {np.min(w) if n else 0}; at least 0 is needed")
    need(np.asarray(mode).dtype.kind in "iu", f"mode is {np.asarray(mode).dtype}; integers are needed")
    if n:
        need(np.allclose(P, np.swapaxes(P, 1, 2)), "a born covariance is not symmetric")
        need((np.linalg.eigvalsh(P) > -1e-9 * np.abs(P).max()).all(), "a born covariance has a negative eigenvalue")


@claim("spawn.mixture", _SPAWN)
def spawn_mixture(case: Case) -> None:
    """What splits off is w (J,) ≥ 0, m (J, d), P (J, d, d) symmetric and positive semidefinite, mode (J,); nothing splits off nobody."""
    d = _spawned(case)[0]
    nobody = Mixture(np.zeros(0), np.zeros((0, d)), np.zeros((0, d, d)), np.zeros(0, np.int64))
    for born in (_spawned(case)[1], case.component.spawned(nobody)):
        _sound(born, d)
    need(len(case.component.spawned(nobody).w) == 0, "components split off an empty mixture")


@claim("spawn.mutation", _SPAWN, ["spawn.mixture"])
def spawn_mutation(case: Case) -> None:
    """Spawning is a function of the mixture, which it leaves alone: twice gives the same."""
    need(_alike(_spawned(case)[1], _spawned(case)[1]), "two calls with one mixture give different components")


def _spawned(case: Case) -> tuple[int, Mixture]:
    """The state's dimension, and what splits off a mixture in the first space that fits.

    Raises:
        Skip: none fits.
    """
    reasons: list[str] = []
    for space in fixtures.SPACES:
        m, P, mode = fixtures.gaussians(space)
        for array in (m, P):
            array.flags.writeable = False
        try:
            return len(space), case.component.spawned(Mixture(np.full(len(m), 0.7), m, P, mode))
        except SetupError as error:
            reasons.append(str(error))
    raise unmet(reasons)


@claim("birth.seed", _BIRTH, ["birth.runs"])
def birth_seed(case: Case) -> None:
    """The same generator seed proposes the same."""
    need(
        all(map(_alike, _proposals(case), _proposals(case))),
        "two runs from one seed propose differently; draw only from the generator that is passed",
    )


@claim("birth.mutation", _BIRTH, ["birth.seed"])
def birth_mutation(case: Case) -> None:
    """Proposing changes neither memory nor scan: twice from one memory gives the same."""
    memory, live, _, scans = _begun(case)
    rng = np.random.default_rng(2)
    memory, _ = case.component.propose(rng, memory, scans[0], live)
    branches = []
    for _ in range(2):
        own = copy.deepcopy(rng)
        following, first = case.component.propose(own, memory, scans[1], live)
        branches.append((first, case.component.propose(own, following, scans[2], live)[1]))
    need(all(map(_alike, *branches)), "a second proposal from the same memory differs; build a new memory, do not write into the old one")


@claim("birth.uses_scan", _BIRTH, ["birth.seed"])
def birth_uses_scan(case: Case) -> None:
    """Proposals that say they do not use the scan do not depend on its rows."""
    if case.component.uses_scan:
        return
    need(
        all(map(_alike, _proposals(case), _proposals(case, silent=True))),
        "uses_scan is False, yet the proposals change with the scan's rows, which would then count twice; set uses_scan to True",
    )
