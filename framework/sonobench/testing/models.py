"""What motion, measurement, transform and birth must do."""

from __future__ import annotations

import copy
import dataclasses
import itertools
from typing import Any

import numpy as np

from sonobench.errors import SetupError
from sonobench.geometry import max_delay
from sonobench.protocols import Mixture
from sonobench.testing import fixtures
from sonobench.testing.kit import Case, Skip, broken, claim, need
from sonobench.testing.trackers import refused
from sonobench.types import Array, Setup, Space

_MOTION, _MEASUREMENT, _TRANSFORM, _BIRTH = ("motion",), ("measurement",), ("transform",), ("birth",)
_SPACES = (
    Space.of("x_m", "vx_m_s", "y_m", "vy_m_s"),
    Space.of("x_m", "vx_m_s", "y_m", "vy_m_s", "z_m", "vz_m_s"),
    Space.of("x_m", "y_m", "z_m"),
)


def _covariances(n: int, d: int, seed: int = 0) -> Array:
    root = np.random.default_rng(seed).standard_normal((n, d, d)) * 0.3
    return np.asarray(root @ np.swapaxes(root, 1, 2) + 0.01 * np.eye(d))


def _gaussians(space: Space, n: int = 5) -> tuple[Array, Array, Any]:
    """n Gaussians around the middle of the room, slow; mode 0."""
    rng = np.random.default_rng(8)
    middle = [1.5 if name in ("x_m", "y_m", "z_m") else 0.2 for name in space.names]
    return np.array(middle) + 0.3 * rng.standard_normal((n, len(space))), _covariances(n, len(space)), np.zeros(n, np.int64)


def _frozen(*arrays: Any) -> list[Any]:
    copies = [np.array(a) for a in arrays]
    for one in copies:
        one.flags.writeable = False
    return copies


def _untouched(call: Any, *arrays: Any) -> Any:
    try:
        return call(*_frozen(*arrays))
    except ValueError as error:
        if "read-only" in str(error):
            broken(f"writes into its arguments ({error}); build new arrays")
        raise


@claim("motion.runs", _MOTION)
def motion_runs(case: Case) -> None:
    """A motion model has a Space, at least one mode, and predicts Gaussians and particles."""
    motion = case.component
    need(isinstance(motion.space, Space), f"space is {type(motion.space).__name__}; a Space is needed")
    need(isinstance(motion.n_modes, int) and motion.n_modes >= 1, f"n_modes is {motion.n_modes!r}; an integer of at least 1 is needed")
    x, P, mode = _gaussians(motion.space)
    motion.moments(x, P, mode, 0.1)
    x1, _ = motion.sample(np.random.default_rng(0), x, mode, 0.1)
    motion.log_density(np.asarray(x1), x, mode, 0.1)


@claim("motion.mutation", _MOTION, ["motion.runs"])
def motion_mutation(case: Case) -> None:
    """Arguments are left as they came."""
    x, P, mode = _gaussians(case.component.space)
    _untouched(lambda *a: case.component.moments(*a, 0.1), x, P, mode)
    _untouched(lambda *a: case.component.sample(np.random.default_rng(0), *a, 0.1), x, mode)
    _untouched(lambda *a: case.component.log_density(*a, 0.1), x, x, mode)


@claim("motion.shapes", _MOTION, ["motion.mutation"])
def motion_shapes(case: Case) -> None:
    """Means (n, d), covariances (n, d, d), particles (n, d) with modes (n,), densities (n,); none is NaN, no targets is fine."""
    motion = case.component
    for n in (5, 0):
        x, P, mode = (a[:n] for a in _gaussians(motion.space))
        m1, P1 = motion.moments(x, P, mode, 0.1)
        x1, mode1 = motion.sample(np.random.default_rng(0), x, mode, 0.1)
        density = motion.log_density(np.asarray(x1), x, mode, 0.1)
        got = [np.shape(a) for a in (m1, P1, x1, mode1, density)]
        need(got == [x.shape, P.shape, x.shape, (n,), (n,)], f"{n} targets of {len(motion.space)} coordinates give shapes {got}")
        need(not any(np.isnan(a).any() for a in (m1, P1, x1, density)), "gives NaN")


@claim("motion.seed", _MOTION, ["motion.mutation"])
def motion_seed(case: Case) -> None:
    """The same generator seed draws the same particles."""
    x, _, mode = _gaussians(case.component.space)
    first, second = (np.asarray(case.component.sample(np.random.default_rng(3), x, mode, 0.1)[0]) for _ in range(2))
    need(np.array_equal(first, second), "two draws from one seed differ; draw only from the generator that is passed")


@claim("motion.batch", _MOTION, ["motion.shapes"])
def motion_batch(case: Case) -> None:
    """A component's prediction does not depend on those beside it."""
    x, P, mode = _gaussians(case.component.space)
    whole = case.component.moments(x, P, mode, 0.1)
    for j in range(len(x)):
        alone = case.component.moments(x[j : j + 1], P[j : j + 1], mode[j : j + 1], 0.1)
        for name, a, b in zip(("mean", "covariance"), alone, whole, strict=True):
            need(
                np.allclose(a[0], b[j], rtol=1e-9, atol=1e-12), f"the predicted {name} of component {j} depends on the components beside it"
            )


@claim("motion.covariance", _MOTION, ["motion.shapes"])
def motion_covariance(case: Case) -> None:
    """Predicted covariances are symmetric and positive semidefinite."""
    x, P, mode = _gaussians(case.component.space)
    for dt_s in (1e-3, 0.1, 2.0):
        predicted = np.asarray(case.component.moments(x, P, mode, dt_s)[1])
        need(np.allclose(predicted, np.swapaxes(predicted, 1, 2), rtol=1e-9), f"a covariance over {dt_s} s is not symmetric")
        low = np.linalg.eigvalsh(predicted).min() / np.abs(predicted).max()
        need(low > -1e-9, f"a covariance over {dt_s} s has the eigenvalue {low:.2g} of its largest entry")


@claim("motion.still", _MOTION, ["motion.shapes", "motion.seed"])
def motion_still(case: Case) -> None:
    """No time, no motion: dt_s = 0 leaves Gaussians and particles where they are."""
    x, P, mode = _gaussians(case.component.space)
    m1, P1 = case.component.moments(x, P, mode, 0.0)
    need(np.allclose(m1, x) and np.allclose(P1, P), "moments over dt_s = 0 change the Gaussian")
    need(np.allclose(case.component.sample(np.random.default_rng(0), x, mode, 0.0)[0], x), "particles move over dt_s = 0")


@claim("motion.samples", _MOTION, ["motion.shapes", "motion.seed", "motion.still"])
def motion_samples(case: Case) -> None:
    """Drawn particles have the predicted mean and covariance."""
    motion, rng, n = case.component, np.random.default_rng(6), 40000
    x, P, mode = (a[:1] for a in _gaussians(motion.space))
    before = x + rng.standard_normal((n, x.shape[1])) @ np.linalg.cholesky(P[0]).T
    for dt_s in (0.1, 0.7):
        m1, P1 = (np.asarray(a)[0] for a in motion.moments(x, P, mode, dt_s))
        after = np.asarray(motion.sample(rng, before, np.zeros(n, np.int64), dt_s)[0])
        deviation = np.sqrt(np.diag(P1)) + 1e-12
        off = np.abs(after.mean(axis=0) - m1) / (deviation / np.sqrt(n))
        need(
            off.max() < 6,
            f"over {dt_s} s the particles' mean of {motion.space.names[int(off.argmax())]} is {off.max():.0f} standard errors off the predicted mean",
        )
        spread = np.abs(np.cov(after.T).reshape(P1.shape) - P1) / np.outer(deviation, deviation)
        need(
            spread.max() < 0.06,
            f"over {dt_s} s the particles' covariance differs from the predicted one by {spread.max():.2f} of its scale",
        )


@claim("motion.density", _MOTION, ["motion.shapes", "motion.seed"])
def motion_density(case: Case) -> None:
    """log_density is finite at what sample draws, and a density of full rank integrates to one."""
    motion, rng, n = case.component, np.random.default_rng(9), 20000
    x0 = np.repeat(_gaussians(motion.space)[0][:1], n, axis=0)
    mode = np.zeros(n, np.int64)
    drawn = np.asarray(motion.sample(rng, x0, mode, 0.5)[0])
    own = np.asarray(motion.log_density(drawn, x0, mode, 0.5))
    need(np.isfinite(own).all(), f"log_density is not finite at {np.mean(~np.isfinite(own)):.0%} of what sample draws")
    deviation = drawn.std(axis=0)
    if deviation.min() == 0 or np.linalg.eigvalsh(np.corrcoef(drawn.T)).min() < 1e-8:
        return  # a degenerate model: its density lives on a lower dimension
    cov = 1.5 * np.cov(drawn.T)
    root = np.linalg.cholesky(cov)
    e = rng.standard_normal(drawn.shape)
    proposal = -0.5 * np.sum(e**2, axis=1) - np.log(np.diag(root)).sum() - 0.5 * len(root) * np.log(2 * np.pi)
    ratio = np.exp(np.asarray(motion.log_density(drawn.mean(axis=0) + e @ root.T, x0, mode, 0.5)) - proposal)
    error = 6 * ratio.std() / np.sqrt(n) + 0.01
    need(abs(ratio.mean() - 1) < error, f"exp(log_density) integrates to {ratio.mean():.3f} ± {error / 6:.3f}; 1 is needed")


def _bound(case: Case, grouping: str | None = None, nominal: Any = None) -> tuple[Any, Space, Setup]:
    """The measurement bound to the first space and setup that it takes.

    Raises:
        SetupError: it takes none.
    """
    reasons: list[str] = []
    for space, name in itertools.product(_SPACES, (grouping,) if grouping else ("pairs", "stack", "both")):
        setup = fixtures.setup(name)
        setup = setup if nominal is None else dataclasses.replace(setup, nominal={**setup.nominal, **nominal})
        try:
            return case.component.bind(space, setup), space, setup
        except SetupError as error:
            reasons.append(str(error))
    raise SetupError("; ".join(dict.fromkeys(reasons)))


@claim("measurement.runs", _MEASUREMENT)
def measurement_runs(case: Case) -> None:
    """A measurement binds to a setup and answers for each of its sensors."""
    bound, space, setup = _bound(case)
    x = _gaussians(space)[0]
    need(len(bound.sensors) > 0, "bound to sensors () of a setup that has some")
    for q in bound.sensors:
        bound.jacobian(x, q)
        z = np.asarray(bound.h(x, q))[..., 0, :]
        bound.residual(z, z, q), bound.R(q), bound.p_d(x, q), bound.log_clutter(z, q)
    need(all(0 <= q < len(setup.sensors) for q in bound.sensors), f"sensors are {bound.sensors}; the setup has {len(setup.sensors)}")


@claim("measurement.mutation", _MEASUREMENT, ["measurement.runs"])
def measurement_mutation(case: Case) -> None:
    """Arguments are left as they came."""
    bound, space, _ = _bound(case)
    x = _gaussians(space)[0]
    for q in bound.sensors:
        z = np.asarray(bound.h(np.array(x), q))[..., 0, :]
        for call in (lambda a, q=q: bound.h(a, q), lambda a, q=q: bound.jacobian(a, q), lambda a, q=q: bound.p_d(a, q)):
            _untouched(call, x)
        _untouched(lambda a, b, q=q: bound.residual(a, b, q), z, z)
        _untouched(lambda a, q=q: bound.log_clutter(a, q), z)


@claim("measurement.shapes", _MEASUREMENT, ["measurement.mutation"])
def measurement_shapes(case: Case) -> None:
    """h (…, L, dz), jacobian (…, L, dz, d), p_d (…, L), R (dz, dz), log_clutter (…,), for any batch axes."""
    bound, space, setup = _bound(case)
    d, modes = len(space), bound.n_modes
    x = np.broadcast_to(_gaussians(space)[0], (2, 5, d)).copy()
    for q in bound.sensors:
        dz = len(setup.sensors[q].space)
        z = np.asarray(bound.h(x, q))
        got = [np.shape(a) for a in (z, bound.jacobian(x, q), bound.p_d(x, q), bound.R(q), bound.log_clutter(z[..., 0, :], q))]
        wanted = [(2, 5, modes, dz), (2, 5, modes, dz, d), (2, 5, modes), (dz, dz), (2, 5)]
        need(got == wanted, f"sensor {setup.sensors[q].name}: shapes of h, jacobian, p_d, R, log_clutter are {got}; {wanted} are needed")


@claim("measurement.residual", _MEASUREMENT, ["measurement.shapes"])
def measurement_residual(case: Case) -> None:
    """residual is z − ẑ, wrapped where the sensor's space is periodic."""
    bound, space, setup = _bound(case)
    x = _gaussians(space)[0]
    for q in bound.sensors:
        z = np.asarray(bound.h(x, q))[:, 0, :]
        periods = np.array(setup.sensors[q].space.periods)
        found, wanted = np.asarray(bound.residual(z + periods, z[::-1], q)), setup.sensors[q].space.residual(z, z[::-1])
        need(np.allclose(found, wanted), f"sensor {setup.sensors[q].name}: residual is {found[0].tolist()}; {wanted[0].tolist()} is needed")


@claim("measurement.jacobian", _MEASUREMENT, ["measurement.residual"])
def measurement_jacobian(case: Case) -> None:
    """The Jacobian is the slope of h."""
    bound, space, setup = _bound(case)
    x = _gaussians(space)[0]
    for q in bound.sensors:
        found = np.asarray(bound.jacobian(x, q))
        scale = np.abs(found).max() + 1e-300
        for j, name in enumerate(space.names):
            step = 1e-5 * np.eye(len(space))[j]
            slope = bound.residual(np.asarray(bound.h(x + step, q)), np.asarray(bound.h(x - step, q)), q) / 2e-5
            need(
                np.allclose(found[..., j], slope, rtol=1e-4, atol=1e-5 * scale),
                f"sensor {setup.sensors[q].name}: dh/d{name} is {found[0, 0, :, j].tolist()}, finite differences give {np.asarray(slope)[0, 0].tolist()}",
            )


@claim("measurement.noise", _MEASUREMENT, ["measurement.shapes"])
def measurement_noise(case: Case) -> None:
    """R is symmetric and positive definite, p_d lies in [0, 1]."""
    bound, space, setup = _bound(case)
    x = _gaussians(space)[0]
    for q in bound.sensors:
        R, p_d = np.asarray(bound.R(q)), np.asarray(bound.p_d(x, q))
        definite = np.allclose(R, R.T) and np.linalg.eigvalsh(R / np.abs(R).max()).min() > 0
        need(definite, f"sensor {setup.sensors[q].name}: R {R.tolist()} is not symmetric and positive definite")
        need(((p_d >= 0) & (p_d <= 1)).all(), f"sensor {setup.sensors[q].name}: p_d is {p_d.min()} to {p_d.max()}")


@claim("measurement.clutter", _MEASUREMENT, ["measurement.shapes"])
def measurement_clutter(case: Case) -> None:
    """The clutter intensity integrates to the expected number of false rows, and is 0 far outside."""
    for grouping in ("pairs", "stack"):
        try:
            bound, _, setup = _bound(case, grouping, {"delay_std_s": 1e-8})
        except SetupError:
            continue
        own = getattr(case.component, "clutter_per_scan", None)
        expected = setup.nominal["clutter_per_scan"] if own is None else own
        for q in bound.sensors:
            unit = setup.sensors[q]
            if unit.kind != "tdoa":
                raise Skip(f"the kit cannot integrate over sensors of kind {unit.kind!r}")
            limit = 1.25 * max_delay(unit.elements, unit.pairs, setup.c_m_s)
            z = np.random.default_rng(4).uniform(-limit, limit, (60000, len(limit)))
            density = np.exp(np.asarray(bound.log_clutter(z, q))) * np.prod(2 * limit)
            error = 6 * density.std() / np.sqrt(len(z)) + 0.02 * expected
            need(
                abs(density.mean() - expected) < error,
                f"sensor {unit.name}: the clutter intensity integrates to {density.mean():.3g}, {expected:g} a scan is expected",
            )
            far = np.asarray(bound.log_clutter(np.full((1, len(limit)), 1.0), q))
            need(np.all(far == -np.inf), f"sensor {unit.name}: log_clutter of a delay of 1 s is {far[0]:.3g}; −inf is needed")


@claim("measurement.foreign", _MEASUREMENT, ["measurement.runs"])
def measurement_foreign(case: Case) -> None:
    """A setup without the sensors that it reads is refused at bind by a SetupError that names both sides."""
    _, space, setup = _bound(case)
    x = _gaussians(space)[0]

    def begin(strange: Setup) -> None:
        bound = case.component.bind(space, strange)
        for q in bound.sensors:
            shape, unit = np.shape(bound.h(x, q)), strange.sensors[q]
            if shape[-1] != len(unit.space):
                raise ValueError(f"h of sensor {unit.name} has shape {shape} for {len(unit.space)} coordinates")

    refused(begin, "bind", setup)


def _linear(d: int = 4, dz: int = 2) -> fixtures.LinearMeasurement:
    rng = np.random.default_rng(12)
    return fixtures.LinearMeasurement(rng.standard_normal((dz, d)), rng.standard_normal(dz))


@claim("transform.runs", _TRANSFORM)
def transform_runs(case: Case) -> None:
    """A transform gives points, and the moments of a measurement."""
    m, P, _ = _gaussians(_SPACES[0])
    need(len(case.component.points(m, P)) == 2, "points must return (points, weights)")
    need(len(case.component.measure(m, P, _linear(), 0)) == 3, "measure must return (ẑ, covariance, cross-covariance)")


@claim("transform.mutation", _TRANSFORM, ["transform.runs"])
def transform_mutation(case: Case) -> None:
    """Arguments are left as they came."""
    m, P, _ = _gaussians(_SPACES[0])
    _untouched(case.component.points, m, P)
    _untouched(lambda a, b: case.component.measure(a, b, _linear(), 0), m, P)


@claim("transform.shapes", _TRANSFORM, ["transform.mutation"])
def transform_shapes(case: Case) -> None:
    """Points (…, p, d) with weights (p,); ẑ (…, dz), covariance (…, dz, dz), cross-covariance (…, d, dz)."""
    m, P, _ = _gaussians(_SPACES[0])
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
    m, P, _ = _gaussians(_SPACES[0])
    x, w = (np.asarray(a) for a in case.component.points(m, P))
    need(abs(w.sum() - 1) < 1e-9, f"the weights sum to {w.sum()}")
    need(np.allclose(np.einsum("p,npd->nd", w, x), m), "the points' weighted mean is not the mean")


@claim("transform.linear", _TRANSFORM, ["transform.shapes"])
def transform_linear(case: Case) -> None:
    """Gaussians pass through a linear function exactly."""
    m, P, _ = _gaussians(_SPACES[0])
    through = _linear()
    z, S, C = case.component.measure(m, P, through, 0)
    wanted = {"ẑ": m @ through.H.T + through.b, "the covariance": through.H @ P @ through.H.T, "the cross-covariance": P @ through.H.T}
    for (name, exact), got in zip(wanted.items(), (z, S, C), strict=True):
        need(np.allclose(got, exact, rtol=1e-7, atol=1e-9), f"{name} of a linear function is off by {np.abs(got - exact).max():.2g}")


def _begun(case: Case) -> tuple[Any, Any, Space, list[Any]]:
    """(memory, live, space, scans) on the first space and setup that the birth takes.

    Raises:
        SetupError: it takes none.
    """
    reasons: list[str] = []
    for space, grouping in itertools.product(_SPACES, ("stack", "pairs")):
        setup = fixtures.setup(grouping)
        try:
            memory = case.component.start(space, setup, fixtures.DelayMeasurement(space, setup))
        except SetupError as error:
            reasons.append(str(error))
            continue
        live = Mixture(np.zeros(0), np.zeros((0, len(space))), np.zeros((0, len(space), len(space))), np.zeros(0, np.int64))
        return memory, live, space, fixtures.scans(setup, fixtures.regular(3))
    raise SetupError("; ".join(dict.fromkeys(reasons)))


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
    for silent in (False, True):
        for w, m, P, mode in _proposals(case, silent=silent):
            n = len(w)
            shapes = [np.shape(a) for a in (w, m, P, mode)]
            need(shapes == [(n,), (n, d), (n, d, d), (n,)], f"shapes of w, m, P, mode are {shapes} for {d} coordinates")
            need(all(np.isfinite(a).all() for a in (w, m, P)), "a born component holds NaN or infinity")
            need((np.asarray(w) >= 0).all(), f"a weight is {np.min(w) if n else 0}; at least 0 is needed")
            need(np.asarray(mode).dtype.kind in "iu", f"mode is {np.asarray(mode).dtype}; integers are needed")
            if n:
                need(np.allclose(P, np.swapaxes(P, 1, 2)), "a born covariance is not symmetric")
                need((np.linalg.eigvalsh(P) > -1e-9 * np.abs(P).max()).all(), "a born covariance has a negative eigenvalue")


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
