"""Several directions at once, fitted to the cumulants and covariances of a vector sensor by generalised least squares.

Sources from u_m with powers p_m and fourth cumulants kappa_m make, in Gaussian noise,

    cum_ijkl = Σ_m kappa_m a_i a_j a_k a_l,      R_ij = Σ_m p_m a_i a_j + Q_ij,      a = [1; u_m]

45 moments that err together by the covariance of `moments(…, error=True)`; the squares of what a fit leaves, weighted by its inverse, are
the fit's misfit, which for the right number of sources follows a chi-square of 45 less the number of parameters. Powers, cumulants
and noise enter linearly and are solved for in every step (variable projection, Kaufman's approximation); directions move by damped
Gauss-Newton steps on the sphere. The inverse of the fit's Fisher matrix is the directions' covariance.
A subspace needs every source to stand out of the error on its own; a fit also uses what the eigenvectors lose: the relative weight of
the moments, the ten moments that |u| = 1 makes redundant, and the covariances.
Source: Golub & Pereyra 1973 and Kaufman 1975 (variable projection); Hansen 1982 (weighted moments and the test of the misfit);
Ottersten, Stoica & Roy 1998 (covariance matching); Pati, Rezaiifar & Krishnaprasad 1993 (orthogonal matching pursuit, for one of the starts).
"""

from __future__ import annotations

from functools import cache
from typing import Any, Literal, NamedTuple

import numpy as np

from sonobench.signal.cumulants import LIVE, PAIRS, QUADRUPLES, Moments
from sonobench.signal.subspace import FREEDOM, Subspace, slopes, spectrum, spectrum_power, steering
from sonobench.sphere import across, spread_directions, stepped
from sonobench.types import Array, DirectionSpectrum, Floats

Noise = Literal["equal", "diagonal", "any"]

_CANDIDATES = 600
_STEPS = 20
_TRIED, _KEPT = 6, 3  # after so many steps only the best starts go on
_RIDGE = 1e-10
_FLOOR = 1e-8


class Fit(NamedTuple):
    """m directions: u (m, 3); R (m, 2, 2) along `sphere.across`, rad²; power (m,), None with noise "any"; cumulant (m,) and its deviation (m,).

    misfit: weighted squares of the residual; freedom: degrees of the chi-square that it follows if there are m sources.
    """

    u: Array
    R: Array
    power: Array | None
    cumulant: Array
    deviation: Array
    misfit: float
    freedom: int


class _Problem(NamedTuple):
    """Whitened: y (k,), turn (k, 45 or 35), noise (k, n) columns of the noise's parameters."""

    y: Array
    turn: Array
    noise: Array


def fit_directions(found: Moments, frame: int, noise: Noise, starts: Array) -> Fit:
    """The best fit from any of the starts.

    Args:
        found: with sampling covariance.
        frame: which of them.
        noise: covariance of the noise: "equal" on all channels, "diagonal", or "any", for which covariances tell nothing and are left out.
        starts: (s, m, 3) unit vectors.

    Raises:
        ValueError: `found` has no sampling covariance, or there is no start.
    """
    if len(starts) == 0:
        raise ValueError("a fit of directions needs at least one start")
    problem = _problem(found, frame, noise)
    u = np.array(starts, float)
    cost, theta, X = _solved(problem, u)
    damping = np.full(len(u), 1e-2)
    for count in range(_STEPS):
        if count == _TRIED:
            kept = np.argsort(cost, kind="stable")[:_KEPT]
            u, theta, X, cost, damping = u[kept], theta[kept], X[kept], cost[kept], damping[kept]
        there = stepped(u, _step(problem, u, theta, X, damping))
        new_cost, new_theta, new_X = _solved(problem, there)
        better = new_cost < cost
        u, theta = np.where(better[:, None, None], there, u), np.where(better[:, None], new_theta, theta)
        X = np.where(better[:, None, None], new_X, X)
        settled = np.abs(cost - new_cost) <= 1e-6 * (1 + cost)
        cost = np.minimum(cost, new_cost)
        damping = np.clip(np.where(better, damping / 8, damping * 8), 1e-9, 1e6)
        if settled.all():
            break
    best = int(np.argmin(cost))
    return _described(problem, u[best], theta[best], float(cost[best]))


def moments_of(u: Floats, cumulant: Floats, power: Floats) -> Array:
    """The 45 moments (45,), cumulants and then covariances, of sources from u (m, 3) with cumulants (m,) and powers (m,), without noise."""
    of_cumulant, of_power = _shares(np.asarray(u, float))
    return np.concatenate([np.asarray(cumulant) @ of_cumulant, np.asarray(power) @ of_power])


def pursued(found: Moments, frame: int, noise: Noise, m: int) -> Array:
    """A start (m, 3) by orthogonal matching pursuit: one direction after the other, each the one that explains most of what is left."""
    problem = _problem(found, frame, noise)
    candidates, cumulant, power = _candidates()
    columns = problem.turn[:, :35] @ cumulant
    chosen: list[int] = []
    used = problem.noise
    for _ in range(m):
        basis = np.linalg.qr(used)[0]
        rest = columns - basis @ (basis.T @ columns)
        left = problem.y - basis @ (basis.T @ problem.y)
        norm = (rest * rest).sum(axis=0)
        gain = np.where(norm > 1e-9 * (columns * columns).sum(axis=0), (left @ rest) ** 2 / np.maximum(norm, 1e-300), -1.0)
        k = int(np.argmax(gain))
        chosen.append(k)
        more = [columns[:, k]] + ([problem.turn[:, 35:] @ power[:, k]] if problem.turn.shape[1] == 45 else [])
        used = np.column_stack([used, *more])
    return candidates[chosen]


def random_starts(s: int, m: int, seed: int) -> Array:
    """(s, m, 3) directions that keep apart: each the farthest from the others of four drawn; the same for the same arguments."""
    rng = np.random.default_rng(seed)
    u = np.zeros((s, m, 3))
    for k in range(m):
        drawn = rng.standard_normal((s, 4, 3))
        drawn /= np.linalg.norm(drawn, axis=-1, keepdims=True)
        near = np.max(drawn @ u[:, :k].swapaxes(-1, -2), axis=-1, initial=-1.0)
        u[:, k] = drawn[np.arange(s), np.argmin(near, axis=1)]
    return u


def _problem(found: Moments, frame: int, noise: Noise) -> _Problem:
    if found.error is None:
        raise ValueError("a fit needs the moments' sampling covariance; use moments(samples, error=True)")
    size = 35 if noise == "any" else 45
    error = found.error[frame][:size, :size]
    y = np.concatenate([found.cumulant[frame], found.covariance[frame]])[:size]
    deviation = np.maximum(np.sqrt(np.maximum(np.diag(error), 0.0)), 1e-150)
    values, vectors = np.linalg.eigh(error / np.outer(deviation, deviation))
    turn = (vectors / np.sqrt(np.maximum(values, _FLOOR * max(values[-1], 1e-150)))).T / deviation
    return _Problem(turn @ y, turn, turn @ _noise_columns(noise))


@cache
def _noise_columns(noise: Noise) -> Array:
    if noise == "any":
        return np.zeros((35, 0))
    diagonal = np.zeros((45, 4))
    for k, (i, j) in enumerate(PAIRS):
        diagonal[35 + k, i] = float(i == j)
    return diagonal if noise == "diagonal" else diagonal.sum(axis=1, keepdims=True)


@cache
def _candidates() -> tuple[Array, Array, Array]:
    u = spread_directions(_CANDIDATES)
    cumulant, power = _shares(u)
    return u, cumulant.T, power.T


def _shares(u: Array) -> tuple[Any, Any]:
    """Of sources from u (…, 3): the moments of a cumulant (…, 35) and of a power (…, 10) of 1."""
    a = np.concatenate([np.ones((*u.shape[:-1], 1)), u], axis=-1)
    power = a[..., PAIRS[:, 0]] * a[..., PAIRS[:, 1]]
    return power[..., _HALVES[0]] * power[..., _HALVES[1]], power


def _share_slopes(u: Array) -> tuple[Any, Any]:
    """Derivatives (…, 2, 35) and (…, 2, 10) of `_shares` along `sphere.across`."""
    a = np.concatenate([np.ones((*u.shape[:-1], 1)), u], axis=-1)[..., None, :]
    slope = np.concatenate([np.zeros((*u.shape[:-1], 2, 1)), across(u).swapaxes(-1, -2)], axis=-1)
    i, j = PAIRS.T
    first, last = _HALVES
    power = a[..., i] * a[..., j]
    power_slope = slope[..., i] * a[..., j] + a[..., i] * slope[..., j]
    return power_slope[..., first] * power[..., last] + power[..., first] * power_slope[..., last], power_slope


_INDEX = {(int(i), int(j)): k for k, (i, j) in enumerate(PAIRS)}
_HALVES = [np.array([_INDEX[int(q[a]), int(q[a + 1])] for q in QUADRUPLES]) for a in (0, 2)]


def _linear(problem: _Problem, u: Array) -> Array:
    """Whitened columns (s, k, parameters): cumulants, powers, noise."""
    cumulant, power = _shares(u)
    parts = [problem.turn[:, :35] @ cumulant.swapaxes(-1, -2)]
    if problem.turn.shape[1] == 45:
        parts.append(problem.turn[:, 35:] @ power.swapaxes(-1, -2))
    parts.append(np.broadcast_to(problem.noise, (len(u), *problem.noise.shape)))
    return np.concatenate(parts, axis=-1)


def _normal(X: Array, damping: Array | None = None) -> Array:
    """XᵀX (s, n, n), with a ridge on its diagonal."""
    square = X.swapaxes(-1, -2) @ X
    diagonal = np.maximum(np.einsum("...ii->...i", square), 1e-150)
    n = square.shape[-1]
    more = np.full((len(X), n), _RIDGE)
    if damping is not None:
        more = more + damping
    return square + (more * diagonal)[..., None] * np.eye(n)


def _solved(problem: _Problem, u: Array) -> tuple[Array, Array, Array]:
    """Misfits (s,) of directions (s, m, 3), the linear parameters (s, n) of the least, and their columns (s, k, n)."""
    X = _linear(problem, u)
    theta = np.linalg.solve(_normal(X), (X.swapaxes(-1, -2) @ problem.y)[..., None])[..., 0]
    left = problem.y - (X @ theta[..., None])[..., 0]
    return np.asarray((left * left).sum(axis=-1), float), np.asarray(theta, float), X


def _slopes(problem: _Problem, u: Array, theta: Array) -> Array:
    """Whitened derivatives (s, k, 2m) along each direction's `sphere.across`."""
    s, m = u.shape[:2]
    cumulant, power = _share_slopes(u)
    slope = (theta[:, :m, None, None] * cumulant).reshape(s, 2 * m, 35) @ problem.turn[:, :35].T
    if problem.turn.shape[1] == 45:
        slope = slope + (theta[:, m : 2 * m, None, None] * power).reshape(s, 2 * m, 10) @ problem.turn[:, 35:].T
    return np.asarray(slope.swapaxes(-1, -2))


def _step(problem: _Problem, u: Array, theta: Array, X: Array, damping: Array) -> Array:
    """Damped Gauss-Newton steps (s, m, 2)."""
    s, m = u.shape[:2]
    D = _slopes(problem, u, theta)
    left = problem.y - (X @ theta[..., None])[..., 0]
    J = np.concatenate([X, D], axis=-1)
    n = X.shape[-1]
    damped = np.concatenate([np.zeros((s, n)), np.broadcast_to(damping[:, None], (s, 2 * m))], axis=-1)
    step = np.linalg.solve(_normal(J, damped), (J.swapaxes(-1, -2) @ left[..., None]))[..., 0]
    return np.asarray(step[:, n:].reshape(s, m, 2))


def _described(problem: _Problem, u: Array, theta: Array, cost: float) -> Fit:
    m = len(u)
    X = _linear(problem, u[None])
    J = np.concatenate([X, _slopes(problem, u[None], theta[None])], axis=-1)
    n = X.shape[-1]
    cov = np.linalg.inv(_normal(J))[0]
    own = n + 2 * np.arange(m)
    R = np.stack([cov[k : k + 2, k : k + 2] for k in own]) if m else np.zeros((0, 2, 2))
    powers = theta[m : 2 * m] if problem.turn.shape[1] == 45 else None
    deviation = np.sqrt(np.maximum(np.diag(cov)[:m], 0.0))
    return Fit(u, 0.5 * (R + R.swapaxes(-1, -2)), powers, theta[:m], deviation, cost, len(problem.y) - J.shape[-1])


def fitted_spectrum(fit: Fit, width_rad: float) -> DirectionSpectrum:
    """The expected number of sources per steradian: the spectrum of the subspace that the fitted sources span, each peak as wide as R says.

    P leaves out every b(u_m); T = Σ t_m d_m d_mᵀ with the dual vectors d_m of the b(u_m) gives each peak its own t_m, such that its area is R_m's.
    """
    b = steering(fit.u, 10)
    m = len(b)
    dual = np.linalg.pinv(b)  # (10, m)
    noise = LIVE @ LIVE.T - dual @ b
    slope = slopes(fit.u, 10)
    H = slope.swapaxes(-1, -2) @ noise @ slope
    share = np.sqrt(np.maximum(np.linalg.det(H) * np.linalg.det(fit.R), 0.0))
    freedom = 2 * spectrum_power(m, 10) / FREEDOM
    one = Subspace(0.5 * (noise + noise.T), (dual * share * freedom) @ dual.T, m, np.zeros(9))
    return spectrum(one, width_rad)


def explained(fit: Fit) -> float:
    """How probably sampling error alone leaves so large a misfit."""
    from scipy.special import gammaincc

    return float(gammaincc(0.5 * max(fit.freedom, 1), 0.5 * fit.misfit))
