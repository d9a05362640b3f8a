"""Directions from the subspace that the sources span in a vector sensor's covariance (order 1) or cumulant (order 2) matrix.

A matrix C = Σ_m w_m b_m b_mᵀ of m sources has m eigenvalues that are not 0, of either sign (a uniform source has a negative kurtosis), and
every source's b = b(u), here of length 1, is orthogonal to the other eigenvectors U_n. Of an estimate Ĉ = C + ΔC,

    e(u) = U_nᵀ b(u) ≈ −U_nᵀ ΔC C⁺ b(u)      where a source is,

so each component of e has about the variance s(u) = b(u)ᵀ T b(u), T = C⁺ E[ΔC P_n ΔC] C⁺ / dim U_n, which follows from the sampling
covariance of the moments: a weak source's direction, of which the matrix knows less, is expected to miss the subspace by more.
Source: Schmidt 1986 (MUSIC); Porat & Friedlander 1991 (cumulants); Kaveh & Barabell 1986 and Stoica & Nehorai 1989 (perturbation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal, NamedTuple

import numpy as np

from sonobench.protocols import Directions
from sonobench.signal.cumulants import LIVE, PAIRS, WEIGHTS, Moments, covariance_matrix, live_matrix, products
from sonobench.sphere import across, spread_directions, stepped
from sonobench.types import Array, DirectionSpectrum, Floats, Ints

Rule = Literal["error", "threshold", "gap", "given"]

_GRID = 10_000
_NEIGHBOURS = 8
_REFINED = 8
_SAME = float(np.cos(np.radians(1.0)))


@dataclass(frozen=True)
class Order:
    """How many sources a matrix shows, told by its eigenvalues sorted by magnitude.

    Attributes:
        rule: "error": the fewest such that what is left is explained by sampling error; "threshold": those above a share of the largest;
            "gap": before the largest ratio of two that follow each other; "given": `sources`.
        sources: how many, for "given".
        threshold: share of the largest magnitude.
        significance: for "error", how improbable what is left must be as sampling error for there to be one more.
        most: never more.
    """

    rule: Rule
    sources: int
    threshold: float
    significance: float
    most: int

    def __post_init__(self) -> None:
        if self.rule not in ("error", "threshold", "gap", "given"):
            raise ValueError(f"order is {self.rule!r}; 'error', 'threshold', 'gap' or 'given' is needed")
        if not (0 < self.threshold < 1 and 0 < self.significance < 1):
            raise ValueError(f"threshold is {self.threshold}, significance {self.significance}; between 0 and 1 is needed")
        if not (self.most >= 1 and 0 <= self.sources and (self.rule != "given" or self.sources <= self.most)):
            raise ValueError(f"sources is {self.sources}, most {self.most}; at least 1, and no more sources than that, is needed")

    def count(self, magnitudes: Floats, left: Floats, most: int) -> int:
        """Sources, at most `most`, of sorted magnitudes (d,); `left` (most + 1,), for "error": p-values beyond the first k."""
        if self.rule == "given":
            return min(self.sources, most)
        if not magnitudes[0] > 0:
            return 0
        if self.rule == "threshold":
            return int(min((magnitudes > self.threshold * magnitudes[0]).sum(), most))
        if self.rule == "gap":
            return 1 + int(np.argmax(magnitudes[:most] / np.maximum(magnitudes[1 : most + 1], 1e-12 * magnitudes[0])))
        fits = np.flatnonzero(left >= self.significance)
        return int(fits[0]) if len(fits) else most


class Subspace(NamedTuple):
    """Of one frame, over b (4 or 10): noise (b, b) projector, spread (b, b) the matrix T above, m sources, values (d,) sorted eigenvalues."""

    noise: Array
    spread: Array
    m: int
    values: Array


def subspace(found: Moments, frame: int, cumulants: bool, order: Order) -> Subspace:
    """The subspace of one frame's cumulants (noise takes no part) or covariances (equal white noise on all channels is presumed).

    Raises:
        ValueError: `found` has no sampling covariance.
    """
    if found.error is None:
        raise ValueError("subspaces need the moments' sampling covariance; use moments(samples, error=True)")
    error = found.error[frame]
    if not cumulants:
        return _of_matrix(covariance_matrix(found.covariance[frame]), _covariance_basis(), error[35:, 35:], True, order)
    one = _of_matrix(live_matrix(found.cumulant[frame]), _cumulant_basis(), error[:35, :35], False, order)
    return one._replace(noise=LIVE @ one.noise @ LIVE.T, spread=LIVE @ one.spread @ LIVE.T)


def _of_matrix(matrix: Array, basis: Array, error: Array, floor: bool, order: Order) -> Subspace:
    """`basis` (k, d, d): what each distinct moment adds to the matrix; `floor`: whether noise adds a multiple of the identity."""
    d = len(matrix)
    values, vectors = np.linalg.eigh(matrix)
    values = values - values[0] if floor else values
    sort = np.argsort(-np.abs(values), kind="stable")
    values, vectors = values[sort], vectors[:, sort]
    most = min(order.most, d - 2 if floor else d - 1)
    left = _p_values(values, vectors, basis, error, floor, most) if order.rule == "error" else np.zeros(0)
    m = order.count(np.abs(values), left, most)
    if m == 0:
        return Subspace(np.eye(d), np.zeros((d, d)), 0, values)
    lift = values[m:].mean() if floor else 0.0
    inverse = (vectors[:, :m] / (values[:m] - lift)) @ vectors[:, :m].T
    noise = vectors[:, m:] @ vectors[:, m:].T
    spread = np.tensordot(error, basis @ noise, 1)  # (k, d, d)
    square = np.tensordot(spread, basis, ((0, 2), (0, 1)))
    return Subspace(noise, inverse @ (square + square.T) @ inverse / (2 * (d - m)), m, values)


def _p_values(values: Array, vectors: Array, basis: Array, error: Array, floor: bool, most: int) -> Array:
    """How probably sampling error alone leaves as large eigenvalues as there are beyond the first k = 0 … most.

    The sum of squares of what is left is a weighted sum of chi-squares, taken as one of as many degrees as have its mean and variance.
    """
    from scipy.special import gammaincc

    turned = vectors.T @ basis @ vectors
    found = np.zeros(most + 1)
    for k in range(most + 1):
        rest, level = turned[:, k:, k:], 0.0
        if floor:
            level = values[k:].mean()
            rest = rest - np.trace(rest, axis1=1, axis2=2)[:, None, None] * np.eye(len(values) - k) / (len(values) - k)
        flat = rest.reshape(len(basis), -1)
        spread = flat @ flat.T @ error
        mean, square = max(float(np.trace(spread)), 1e-300), max(float((spread * spread.T).sum()), 1e-300)
        found[k] = gammaincc(0.5 * mean**2 / square, 0.5 * ((values[k:] - level) ** 2).sum() * mean / square)
    return found


@cache
def _cumulant_basis() -> Array:
    return live_matrix(np.eye(35))


@cache
def _covariance_basis() -> Array:
    return covariance_matrix(np.eye(10))


@cache
def grid() -> tuple[Array, Array, Array, Ints]:
    """10000 directions some 2° apart: u (n, 3), b of length 1 of covariances (n, 4) and of cumulants (n, 10), nearest others (n, 8)."""
    from scipy.spatial import cKDTree

    u = spread_directions(_GRID)
    near = np.asarray(cKDTree(u).query(u, _NEIGHBOURS + 1)[1][:, 1:], np.int64)
    made = (u, steering(u, 4), steering(u, 10), near)
    for one in made:
        one.flags.writeable = False
    return made


def steering(u: Floats, b: int) -> Array:
    """b(u) of length 1 (…, b) of unit vectors (…, 3): [1; u]/√2, or its distinct products."""
    u = np.asarray(u)
    a = np.concatenate([np.ones((*u.shape[:-1], 1)), u], axis=-1) * 0.5**0.5
    return a if b == 4 else products(a)


def slopes(u: Floats, b: int) -> Array:
    """Derivatives (…, b, 2) of `steering` along `sphere.across`."""
    plane = across(u) * 0.5**0.5
    change = np.concatenate([np.zeros((*plane.shape[:-2], 1, 2)), plane], axis=-2)
    if b == 4:
        return change
    a = steering(u, 4)[..., None]
    i, j = PAIRS.T
    return np.asarray((change[..., i, :] * a[..., j, :] + a[..., i, :] * change[..., j, :]) * WEIGHTS[:, None])


#: degrees of freedom of the variance that a source's miss is expected to have: heavier tails than a Gaussian's
FREEDOM = 4.0


def spectrum(one: Subspace, width_rad: float) -> DirectionSpectrum:
    """The expected number of sources per steradian, in total as many as the subspace holds.

    A source's miss e, of dim U_n = n components of variance s(u) that is known up to `FREEDOM` degrees c, has a density proportional to
    (1 + |e|² / (c s))^(−(c + n)/2) (Student's); its integral over the sphere is made the number of sources.

    Args:
        one: of either matrix.
        width_rad: no peak is narrower; it stands for what is not sampling error (a source's motion within the frame, the sensor's).
    """
    b = len(one.noise)
    power = spectrum_power(one.m, b)
    spread = FREEDOM * one.spread + 2 * power * width_rad**2 * np.eye(b)
    if one.m == 0:
        return DirectionSpectrum(one.noise[None], spread[None], np.zeros(1), np.array([power]), np.ones(1, bool))
    _, of_covariances, of_cumulants, _ = grid()
    directions = of_covariances if b == 4 else of_cumulants
    ratio = np.maximum(_quadratic(directions, one.noise), 0.0) / _quadratic(directions, spread)
    total = 4 * np.pi * float(np.mean(np.exp(-power * np.log1p(ratio))))
    return DirectionSpectrum(one.noise[None], spread[None], np.array([one.m / total]), np.array([power]), np.ones(1, bool))


def spectrum_power(m: int, b: int) -> float:
    """Exponent of the spectrum of m sources over b products."""
    return 0.5 * (FREEDOM + (4 if b == 4 else 9) - m)


class Peaks(NamedTuple):
    """Directions u (k, 3) that fit a subspace, the best first; null (k,) the share of b(u) outside it; R (k, 2, 2) along `sphere.across`, rad²."""

    u: Array
    null: Array
    R: Array


def peaks(one: Subspace, most: int) -> Peaks:
    """The lowest local minima of bᵀ P b on the grid, refined by Gauss-Newton steps; R from the miss that is expected."""
    if one.m == 0 or most == 0:
        return Peaks(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2)))
    b = len(one.noise)
    u, of_covariances, of_cumulants, near = grid()
    null = _quadratic(of_covariances if b == 4 else of_cumulants, one.noise)
    low = np.flatnonzero((null[:, None] <= null[near]).all(axis=1))
    low = low[np.argsort(null[low], kind="stable")][: most + _REFINED]
    at, best = u[low], null[low]
    for _ in range(_REFINED):
        at_b, slope = steering(at, b), slopes(at, b)
        turned = slope.swapaxes(-1, -2) @ one.noise
        H, g = turned @ slope, (turned @ at_b[..., None])[..., 0]
        H = H + 1e-9 * np.eye(2)
        there = stepped(at, -np.linalg.solve(H, g[..., None])[..., 0])
        value = _quadratic(steering(there, b), one.noise)
        at, best = np.where((value < best)[:, None], there, at), np.minimum(value, best)
    order = _apart(at, best, most)
    at, slope = at[order], slopes(at[order], b)
    H = slope.swapaxes(-1, -2) @ one.noise @ slope
    variance = _quadratic(steering(at, b), one.spread)
    return Peaks(at, best[order], variance[:, None, None] * np.linalg.inv(H + 1e-9 * np.eye(2)))


def _apart(u: Array, null: Array, most: int) -> Ints:
    """The best of directions that lie within a degree of each other, the best first."""
    kept: list[int] = []
    for k in np.argsort(null, kind="stable"):
        if len(kept) < most and all(u[k] @ u[j] < _SAME for j in kept):
            kept.append(int(k))
    return np.array(kept, np.int64)


def _quadratic(b: Array, matrix: Array) -> Array:
    return np.asarray(((b @ matrix) * b).sum(axis=-1))


def _in_angles(R: Floats, u: Floats) -> Array:
    """Covariances (…, 2, 2) along `sphere.across` as ones of azimuth and elevation; straight up and down the azimuth's is large but finite."""
    u = np.asarray(u)
    scale = np.stack([1.0 / np.maximum(np.hypot(u[..., 0], u[..., 1]), 1e-3), np.ones(u.shape[:-1])], axis=-1)
    return np.asarray(R * scale[..., :, None] * scale[..., None, :])


def found_peaks(found: Moments, cumulants: bool, order: Order) -> Directions:
    """Directions of the peaks of every frame's subspace, as many as it holds; score −10 log10 of what b(u) has outside it."""
    rows = []
    for frame in range(len(found.cumulant)):
        one = subspace(found, frame, cumulants, order)
        tops = peaks(one, one.m)
        rows.append((tops.u, tops.R, -10 * np.log10(np.maximum(tops.null, 1e-30))))
    return gathered(rows, order.most)


def gathered(rows: Sequence[tuple[Array, Array, Array]], most: int) -> Directions:
    """Directions of frames from u (k, 3), R (k, 2, 2) along `sphere.across` and score (k,) of each; rows that stand for nothing fill up to `most`."""
    f = len(rows)
    u, valid = np.tile([1.0, 0.0, 0.0], (f, most, 1)), np.zeros((f, most), bool)
    R, score = np.tile(np.eye(2), (f, most, 1, 1)), np.zeros((f, most))
    for frame, (there, spread, value) in enumerate(rows):
        k = len(there)
        u[frame, :k], valid[frame, :k], score[frame, :k] = there, True, value
        R[frame, :k] = _in_angles(spread, there)
    return Directions(u, valid, R, score)
