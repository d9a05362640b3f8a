"""What motion and measurement must do."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np

from sonobench.errors import SetupError
from sonobench.filtering.steps import adapts
from sonobench.testing import fixtures
from sonobench.testing.kit import Case, Skip, claim, need, unmet, untouched
from sonobench.testing.trackers import refused
from sonobench.types import Setup, Space

_MOTION, _MEASUREMENT = ("motion",), ("measurement",)


@claim("motion.runs", _MOTION)
def motion_runs(case: Case) -> None:
    """A motion model has a Space, at least one mode, and predicts Gaussians and particles."""
    motion = case.component
    need(isinstance(motion.space, Space), f"space is {type(motion.space).__name__}; a Space is needed")
    need(isinstance(motion.n_modes, int) and motion.n_modes >= 1, f"n_modes is {motion.n_modes!r}; an integer of at least 1 is needed")
    x, P, mode = fixtures.gaussians(motion.space)
    motion.moments(x, P, mode, 0.1, memory=None)
    x1, _ = motion.sample(np.random.default_rng(0), x, mode, 0.1, memory=None)
    motion.log_density(np.asarray(x1), x, mode, 0.1, memory=None)


@claim("motion.mutation", _MOTION, ["motion.runs"])
def motion_mutation(case: Case) -> None:
    """Arguments are left as they came."""
    x, P, mode = fixtures.gaussians(case.component.space)
    untouched(lambda *a: case.component.moments(*a, 0.1), x, P, mode)
    untouched(lambda *a: case.component.sample(np.random.default_rng(0), *a, 0.1), x, mode)
    untouched(lambda *a: case.component.log_density(*a, 0.1), x, x, mode)


@claim("motion.shapes", _MOTION, ["motion.mutation"])
def motion_shapes(case: Case) -> None:
    """Means (n, d), covariances (n, d, d), particles (n, d) with modes (n,), densities (n,); none is NaN, no targets is fine."""
    motion = case.component
    for n in (5, 0):
        x, P, mode = (a[:n] for a in fixtures.gaussians(motion.space))
        m1, P1 = motion.moments(x, P, mode, 0.1)
        x1, mode1 = motion.sample(np.random.default_rng(0), x, mode, 0.1)
        density = motion.log_density(np.asarray(x1), x, mode, 0.1)
        got = [np.shape(a) for a in (m1, P1, x1, mode1, density)]
        need(got == [x.shape, P.shape, x.shape, (n,), (n,)], f"{n} targets of {len(motion.space)} coordinates give shapes {got}")
        need(not any(np.isnan(a).any() for a in (m1, P1, x1, density)), "gives NaN")


@claim("motion.seed", _MOTION, ["motion.mutation"])
def motion_seed(case: Case) -> None:
    """The same generator seed draws the same particles."""
    x, _, mode = fixtures.gaussians(case.component.space)
    first, second = (np.asarray(case.component.sample(np.random.default_rng(3), x, mode, 0.1)[0]) for _ in range(2))
    need(np.array_equal(first, second), "two draws from one seed differ; draw only from the generator that is passed")


@claim("motion.batch", _MOTION, ["motion.shapes"])
def motion_batch(case: Case) -> None:
    """A component's prediction does not depend on those beside it."""
    x, P, mode = fixtures.gaussians(case.component.space)
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
    x, P, mode = fixtures.gaussians(case.component.space)
    for dt_s in (1e-3, 0.1, 2.0):
        predicted = np.asarray(case.component.moments(x, P, mode, dt_s)[1])
        need(np.allclose(predicted, np.swapaxes(predicted, 1, 2), rtol=1e-9), f"a covariance over {dt_s} s is not symmetric")
        low = np.linalg.eigvalsh(predicted).min() / np.abs(predicted).max()
        need(low > -1e-9, f"a covariance over {dt_s} s has the eigenvalue {low:.2g} of its largest entry")


@claim("motion.still", _MOTION, ["motion.shapes", "motion.seed"])
def motion_still(case: Case) -> None:
    """No time, no motion: dt_s = 0 leaves Gaussians and particles where they are."""
    x, P, mode = fixtures.gaussians(case.component.space)
    m1, P1 = case.component.moments(x, P, mode, 0.0)
    need(np.allclose(m1, x) and np.allclose(P1, P), "moments over dt_s = 0 change the Gaussian")
    need(np.allclose(case.component.sample(np.random.default_rng(0), x, mode, 0.0)[0], x), "particles move over dt_s = 0")


@claim("motion.samples", _MOTION, ["motion.shapes", "motion.seed", "motion.still"])
def motion_samples(case: Case) -> None:
    """Drawn particles have the predicted mean and covariance."""
    for dt_s in (0.1, 0.7):
        _draws_as_predicted(case.component, dt_s, None)


def _draws_as_predicted(motion: Any, dt_s: float, memory: Any, so: str = "") -> None:
    rng, n = np.random.default_rng(6), 40000
    x, P, mode = (a[:1] for a in fixtures.gaussians(motion.space))
    before = x + rng.standard_normal((n, x.shape[1])) @ np.linalg.cholesky(P[0]).T
    m1, P1 = (np.asarray(a)[0] for a in motion.moments(x, P, mode, dt_s, memory))
    after = np.asarray(motion.sample(rng, before, np.zeros(n, np.int64), dt_s, memory)[0])
    deviation = np.sqrt(np.diag(P1)) + 1e-12
    off = np.abs(after.mean(axis=0) - m1) / (deviation / np.sqrt(n))
    name = motion.space.names[int(off.argmax())]
    need(
        off.max() < 6,
        f"over {dt_s} s{so} the particles' mean of {name} is {off.max():.0f} standard errors off the predicted mean",
    )
    spread = np.abs(np.cov(after.T).reshape(P1.shape) - P1) / np.outer(deviation, deviation)
    need(
        spread.max() < 0.06,
        f"over {dt_s} s{so} the particles' covariance differs from the predicted one by {spread.max():.2f} of its scale",
    )


@claim("motion.adapts", _MOTION, ["motion.samples"])
def motion_adapts(case: Case) -> None:
    """A model that learns from updates keeps what it learns in the memory alone, and draws with it what it predicts with it."""
    motion = case.component
    if not adapts(motion):
        return
    x, P, mode = fixtures.gaussians(motion.space)
    fresh = [np.asarray(a) for a in motion.moments(x, P, mode, 0.1)]
    rng, memory = np.random.default_rng(4), None
    for _ in range(10):
        prior = np.asarray(motion.moments(x[:1], P[:1], mode[:1], 0.1, memory)[0])[0]
        posterior = prior + 2.0 * np.sqrt(np.diag(P[0])) * rng.standard_normal(len(prior))
        learnt = motion.adapt(memory, prior, posterior, 0.1)
        one = motion.moments(x, P, mode, 0.1, learnt)
        untouched(lambda *a, kept=memory: motion.adapt(kept, *a, 0.1), prior, posterior)
        again = motion.moments(x, P, mode, 0.1, motion.adapt(memory, prior, posterior, 0.1))
        need(
            all(map(np.array_equal, one, again)),
            "two updates from one memory give different ones; build a new memory, do not write into the old one",
        )
        memory = learnt
    now = motion.moments(x, P, mode, 0.1)
    need(all(map(np.array_equal, fresh, now)), "what it learnt stays without the memory; keep all of it in the memory")
    _draws_as_predicted(motion, 0.1, memory, " after updates")


@claim("motion.density", _MOTION, ["motion.shapes", "motion.seed"])
def motion_density(case: Case) -> None:
    """log_density is finite at what sample draws, and a density of full rank integrates to one."""
    motion, rng, n = case.component, np.random.default_rng(9), 20000
    x0 = np.repeat(fixtures.gaussians(motion.space)[0][:1], n, axis=0)
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


@claim("motion.branches", _MOTION, ["motion.shapes"])
def motion_branches(case: Case) -> None:
    """A model of several modes branches: probabilities sum to one, and the branches have the moments together."""
    motion = case.component
    if motion.n_modes == 1:
        return
    x, P, _ = fixtures.gaussians(motion.space)
    mode = np.arange(len(x)) % motion.n_modes
    p, m, C = (np.asarray(a) for a in motion.branches(x, P, mode, 0.7))
    n, d = x.shape
    got = [p.shape, m.shape, C.shape]
    wanted = [(n, motion.n_modes), (n, motion.n_modes, d), (n, motion.n_modes, d, d)]
    need(got == wanted, f"probabilities, means and covariances have shapes {got}; {wanted} are needed")
    need((p >= 0).all() and np.allclose(p.sum(axis=1), 1), f"the next modes' probabilities sum to {p.sum(axis=1).tolist()}")
    mean = np.einsum("nj,njd->nd", p, m)
    off = m - mean[:, None]
    cov = np.einsum("nj,njab->nab", p, C + off[..., :, None] * off[..., None, :])
    found = motion.moments(x, P, mode, 0.7)
    need(np.allclose(found[0], mean) and np.allclose(found[1], cov), "moments are not those of the branches together")


def _bound(case: Case, grouping: str | None = None, nominal: Any = None) -> tuple[Any, Space, Setup]:
    """The measurement bound to the first space and setup that it takes.

    Raises:
        Skip: it takes none.
    """
    reasons: list[str] = []
    for space, name in itertools.product(
        fixtures.SPACES, (grouping,) if grouping else ("pairs", "stack", "both", "positions", "directions")
    ):
        setup = fixtures.setup(name)
        setup = setup if nominal is None else dataclasses.replace(setup, nominal={**setup.nominal, **nominal})
        try:
            return case.component.bind(space, setup), space, setup
        except SetupError as error:
            reasons.append(str(error))
    raise unmet(reasons)


@claim("measurement.runs", _MEASUREMENT)
def measurement_runs(case: Case) -> None:
    """A measurement binds to a setup and answers for each of its sensors."""
    bound, space, setup = _bound(case)
    x = fixtures.gaussians(space)[0]
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
    x = fixtures.gaussians(space)[0]
    for q in bound.sensors:
        z = np.asarray(bound.h(np.array(x), q))[..., 0, :]
        for call in (lambda a, q=q: bound.h(a, q), lambda a, q=q: bound.jacobian(a, q), lambda a, q=q: bound.p_d(a, q)):
            untouched(call, x)
        untouched(lambda a, b, q=q: bound.residual(a, b, q), z, z)
        untouched(lambda a, q=q: bound.log_clutter(a, q), z)


@claim("measurement.shapes", _MEASUREMENT, ["measurement.mutation"])
def measurement_shapes(case: Case) -> None:
    """h (…, L, dz), jacobian (…, L, dz, d), p_d (…, L), R (dz, dz), log_clutter (…,), for any batch axes."""
    bound, space, setup = _bound(case)
    d, modes = len(space), bound.n_modes
    x = np.broadcast_to(fixtures.gaussians(space)[0], (2, 5, d)).copy()
    for q in bound.sensors:
        dz = len(setup.sensors[q].space)
        z = np.asarray(bound.h(x, q))
        got = [np.shape(a) for a in (z, bound.jacobian(x, q), bound.p_d(x, q), bound.R(q), bound.log_clutter(z[..., 0, :], q))]
        wanted = [(2, 5, modes, dz), (2, 5, modes, dz, d), (2, 5, modes), (dz, dz), (2, 5)]
        need(got == wanted, f"sensor {setup.sensors[q].name}: shapes of h, jacobian, p_d, R, log_clutter are {got}; {wanted} are needed")


@claim("measurement.residual", _MEASUREMENT, ["measurement.shapes"])
def measurement_residual(case: Case) -> None:
    """residual is z − ẑ, wrapped where the sensor's space is periodic, or what `moved` undoes where the space is curved."""
    bound, space, setup = _bound(case)
    x = fixtures.gaussians(space)[0]
    for q in bound.sensors:
        z = np.asarray(bound.h(x, q))[:, 0, :]
        periods = np.array(setup.sensors[q].space.periods)
        found, wanted = np.asarray(bound.residual(z + periods, z[::-1], q)), setup.sensors[q].space.residual(z, z[::-1])
        if hasattr(bound, "moved"):
            off = setup.sensors[q].space.residual(np.asarray(bound.moved(z[::-1], found, q)), z)
            need(np.allclose(off, 0), f"sensor {setup.sensors[q].name}: moved by the residual, ẑ is {off[0].tolist()} off z")
            continue
        need(np.allclose(found, wanted), f"sensor {setup.sensors[q].name}: residual is {found[0].tolist()}; {wanted[0].tolist()} is needed")


@claim("measurement.jacobian", _MEASUREMENT, ["measurement.residual"])
def measurement_jacobian(case: Case) -> None:
    """The Jacobian is the slope of h."""
    bound, space, setup = _bound(case)
    x = fixtures.gaussians(space)[0]
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
    x = fixtures.gaussians(space)[0]
    for q in bound.sensors:
        R, p_d = np.asarray(bound.R(q)), np.asarray(bound.p_d(x, q))
        definite = np.allclose(R, R.T) and np.linalg.eigvalsh(R / np.abs(R).max()).min() > 0
        need(definite, f"sensor {setup.sensors[q].name}: R {R.tolist()} is not symmetric and positive definite")
        need(((p_d >= 0) & (p_d <= 1)).all(), f"sensor {setup.sensors[q].name}: p_d is {p_d.min()} to {p_d.max()}")


@claim("measurement.clutter", _MEASUREMENT, ["measurement.shapes"])
def measurement_clutter(case: Case) -> None:
    """The clutter intensity integrates to the expected number of false rows, and is 0 far outside."""
    kinds: set[str] = set()
    for grouping, kind in (("pairs", "tdoa"), ("stack", "tdoa"), ("positions", "position"), ("directions", "direction")):
        try:
            bound, _, setup = _bound(case, grouping, {"delay_std_s": 1e-8, "position_std_m": 1e-4})
        except Skip:
            continue  # the grouping that it does take is asked; measurement.shapes held, so there is one
        if kinds - {kind}:
            continue  # that it takes foreign sensors too is another claim's matter
        kinds.add(kind)
        own = getattr(case.component, "clutter_per_scan", None)
        expected = setup.nominal["clutter_per_scan"] if own is None else own
        for q in bound.sensors:
            unit = setup.sensors[q]
            if unit.kind == "direction":
                _even_over_sphere(bound, q, expected)
                continue
            if unit.kind not in ("tdoa", "position"):
                raise Skip(f"the kit cannot integrate over sensors of kind {unit.kind!r}")
            low, high = fixtures.limits(unit, setup.c_m_s)
            middle, reach = (low + high) / 2, 1.25 * (high - low) / 2
            far = 1.0 if unit.kind == "tdoa" else 100.0
            while reach.max() < far and np.isfinite(bound.log_clutter(middle + np.diag(reach), q)).any():
                reach = 1.25 * reach  # echoes reach beyond the aperture
            z = np.random.default_rng(4).uniform(middle - reach, middle + reach, (60000, len(reach)))
            density = np.exp(np.asarray(bound.log_clutter(z, q))) * np.prod(2 * reach)
            error = 6 * density.std() / np.sqrt(len(z)) + 0.02 * expected
            need(
                abs(density.mean() - expected) < error,
                f"sensor {unit.name}: the clutter intensity integrates to {density.mean():.3g}, {expected:g} a scan is expected",
            )
            there = np.asarray(bound.log_clutter(np.full((1, len(reach)), far), q))
            what = "a delay of 1 s" if unit.kind == "tdoa" else "a place 100 m away"
            need(np.all(there == -np.inf), f"sensor {unit.name}: log_clutter of {what} is {there[0]:.3g}; −inf is needed")


def _even_over_sphere(bound: Any, q: int, expected: float) -> None:
    """Clutter of directions is per steradian."""
    u = np.random.default_rng(4).uniform(-1.0, 1.0, (20000, 2))
    density = np.exp(np.asarray(bound.log_clutter(np.stack([np.pi * u[:, 0], np.arcsin(u[:, 1])], axis=1), q)))
    whole, error = 4 * np.pi * density.mean(), 4 * np.pi * 6 * density.std() / np.sqrt(len(u)) + 0.02 * expected
    need(abs(whole - expected) < error, f"the clutter intensity integrates to {whole:.3g} over the sphere, {expected:g} a scan is expected")


@claim("measurement.foreign", _MEASUREMENT, ["measurement.runs"])
def measurement_foreign(case: Case) -> None:
    """A setup without the sensors that it reads is refused at bind by a SetupError that names both sides."""
    _, space, setup = _bound(case)
    x = fixtures.gaussians(space)[0]

    def begin(strange: Setup) -> None:
        bound = case.component.bind(space, strange)
        for q in bound.sensors:
            shape, unit = np.shape(bound.h(x, q)), strange.sensors[q]
            if shape[-1] != len(unit.space):
                raise ValueError(f"h of sensor {unit.name} has shape {shape} for {len(unit.space)} coordinates")

    refused(begin, "bind", setup)
