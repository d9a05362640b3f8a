"""Fourth-order cumulants and covariances of the four channels of a vector sensor, and how much they err.

With y = (p, vx, vy, vz) a source from u reads s a, a = [1; u], and Gaussian noise of whatever covariance has no fourth-order cumulant:

    c_ijkl = cum(y_i, y_j, y_k, y_l) = Σ_m kappa_m a_i a_j a_k a_l

of which 35 differ. As a matrix over pairs of channels, C = Σ_m kappa_m b_m b_mᵀ with b = a ⊗ a: 16 × 16, or 10 × 10 over the distinct
products, those of two different channels weighted by √2 so that b·b' = (a·a')² as before. Since |u| = 1, p² − vx² − vy² − vz² is 0 on
every b: C has a direction in which there is only error, and sources span at most 9.
Everything is computed from sums of products: the mean of b bᵀ holds all fourth moments. Arrays come as frames (f, N, 4).
Source: Fisher 1930 (k-statistics); McCullagh 1987, "Tensor methods in statistics", chapter 4 (several variables);
Porat & Friedlander 1991, "Direction finding algorithms based on high-order statistics"; Chevalier, Albera, Ferréol & Comon 2005 (virtual arrays).
"""

from __future__ import annotations

import math
from itertools import combinations_with_replacement, permutations
from typing import Any, Literal, NamedTuple

import numpy as np

from sonobench.types import Array, Floats, Ints

Mean = Literal["zero", "unknown"]

_CHUNK = 2048
_BLOCKS = 64


def _constant(values: Any, dtype: Any = np.float64) -> Any:
    array = np.array(values, dtype)
    array.flags.writeable = False
    return array


#: (10, 2) distinct pairs of channels
PAIRS: Ints = _constant(list(combinations_with_replacement(range(4), 2)), np.int64)
#: (35, 4) distinct quadruples of channels
QUADRUPLES: Ints = _constant(list(combinations_with_replacement(range(4), 4)), np.int64)
#: (10,) what a product of channels weighs in b, so that b·b' = (a·a')²
WEIGHTS: Array = _constant(np.where(PAIRS[:, 0] == PAIRS[:, 1], 1.0, math.sqrt(2.0)))
#: (10,) unit vector along p² − vx² − vy² − vz², which no source reaches
DEAD: Array = _constant([0.5 * ((i == j) - 2 * (i == j > 0)) for i, j in PAIRS])
#: (10, 9) orthonormal basis of what is left
LIVE: Array = _constant(np.linalg.svd(DEAD[None])[2][1:].T)

_PAIR = np.zeros((4, 4), np.int64)
_PAIR[PAIRS[:, 0], PAIRS[:, 1]] = _PAIR[PAIRS[:, 1], PAIRS[:, 0]] = np.arange(10)
_QUADRUPLE = np.zeros((4, 4, 4, 4), np.int64)
for _k, _quadruple in enumerate(QUADRUPLES):
    for _order in permutations(_quadruple):
        _QUADRUPLE[_order] = _k
_FIRST, _LAST = _PAIR[QUADRUPLES[:, 0], QUADRUPLES[:, 1]], _PAIR[QUADRUPLES[:, 2], QUADRUPLES[:, 3]]
#: the three ways to split ijkl into two pairs
_SPLITS = [[(_PAIR[q[a], q[b]], _PAIR[q[c], q[d]]) for a, b, c, d in ((0, 1, 2, 3), (0, 2, 1, 3), (0, 3, 1, 2))] for q in QUADRUPLES]
_LEFT, _RIGHT = (np.array([[split[side] for split in splits] for splits in _SPLITS]) for side in (0, 1))
_IN_TEN = _QUADRUPLE[PAIRS[:, None, 0], PAIRS[:, None, 1], PAIRS[None, :, 0], PAIRS[None, :, 1]]
_IN_SIXTEEN = _QUADRUPLE.reshape(16, 16)

_EACH, _FOUR = np.arange(35)[:, None].repeat(3, axis=1), np.arange(35)[:, None].repeat(4, axis=1)
#: of ijkl without its l-th: the pair of the first two, and the third
_REST_PAIR = np.array([[_PAIR[tuple(np.delete(q, l)[:2])] for l in range(4)] for q in QUADRUPLES])
_REST = np.array([[np.delete(q, l)[2] for l in range(4)] for q in QUADRUPLES])


class Moments(NamedTuple):
    """What frames say: cumulant (f, 35) by `QUADRUPLES`, covariance (f, 10) by `PAIRS`; error (f, 45, 45) sampling covariance of the two, or None."""

    cumulant: Array
    covariance: Array
    error: Array | None


def moments(samples: Floats, mean: Mean = "unknown", error: bool = False) -> Moments:
    """Unbiased fourth-order cumulants and covariances of frames (f, N, 4).

    Args:
        samples: real; N of at least 4.
        mean: "zero": the samples are known to have none; "unknown": each frame's own is taken out. Unbiased for independent samples.
        error: whether the sampling covariance is wanted too, which takes several times as long. It comes from the frame's own eighth
            moments (delta method), times what the means of blocks of a frame scatter more than independent samples would.

    Raises:
        ValueError: another shape, or frames too short.
    """
    samples = np.asarray(samples)
    if samples.ndim != 3 or samples.shape[2] != 4 or samples.shape[1] < 4:
        raise ValueError(f"samples have shape {samples.shape}; frames (f, N, 4) of at least 4 samples (p, vx, vy, vz) are needed")
    found = [_of_frame(np.array(frame.T, np.float64, order="C"), mean, error) for frame in samples]
    f = len(found)
    return Moments(
        np.array([c for c, _, _ in found]).reshape(f, 35),
        np.array([r for _, r, _ in found]).reshape(f, 10),
        np.array([e for _, _, e in found]).reshape(f, 45, 45) if error else None,
    )


def products(a: Floats) -> Array:
    """b (…, 10) of a (…, 4): a_i a_j, weighted; |b| = |a|²."""
    a = np.asarray(a)
    return np.asarray(a[..., PAIRS[:, 0]] * a[..., PAIRS[:, 1]] * WEIGHTS)


def quartics(a: Floats) -> Array:
    """a_i a_j a_k a_l (…, 35) of a (…, 4)."""
    a = np.asarray(a)
    pairs = a[..., PAIRS[:, 0]] * a[..., PAIRS[:, 1]]
    return np.asarray(pairs[..., _FIRST] * pairs[..., _LAST])


def full_matrix(cumulant: Floats) -> Array:
    """The 16 × 16 cumulant matrix over b = a ⊗ a, (…, 16, 16), of distinct cumulants (…, 35)."""
    return np.asarray(cumulant[..., _IN_SIXTEEN])


def distinct_matrix(cumulant: Floats) -> Array:
    """The cumulant matrix over `products`, (…, 10, 10), with the same eigenvalues but for six zeros."""
    return np.asarray(cumulant[..., _IN_TEN] * np.outer(WEIGHTS, WEIGHTS))


def live_matrix(cumulant: Floats) -> Array:
    """The cumulant matrix without the dead direction, (…, 9, 9), in the basis `LIVE`."""
    return np.asarray(LIVE.T @ distinct_matrix(cumulant) @ LIVE)


def covariance_matrix(covariance: Floats) -> Array:
    """(…, 4, 4) of distinct covariances (…, 10)."""
    return np.asarray(covariance[..., _PAIR])


def _of_frame(y: Array, mean: Mean, error: bool) -> tuple[Array, Array, Array | None]:
    n = y.shape[1]
    if mean == "unknown":
        y -= y.mean(axis=1, keepdims=True)
    if error:
        gram, blocks, block = _products(y)
        level = gram[45]
        fourth, second = level[:35], level[35:45]
    else:
        fourth, second = _plain(y)
    split = (second[_LEFT] * second[_RIGHT]).sum(axis=1)
    if mean == "unknown":
        cumulant = n * n * ((n + 1) * fourth - (n - 1) * split) / ((n - 1.0) * (n - 2.0) * (n - 3.0))
        covariance = second * n / (n - 1)
    else:
        cumulant = ((n + 2) * fourth - n * split) / (n - 1)
        covariance = second
    return cumulant, covariance, _error(gram, blocks, block, n, mean) if error else None


def _plain(y: Array) -> tuple[Array, Array]:
    """Fourth (35,) and second (10,) moments: all fourth ones are in the products of the ten pairs."""
    n = y.shape[1]
    buffer = np.empty((10, min(_CHUNK, n)))
    gram, second = np.zeros((10, 10)), np.zeros(10)
    for start in range(0, n, _CHUNK):
        part = y[:, start : start + _CHUNK]
        pairs = _pairs(part, buffer[:, : part.shape[1]])
        gram += pairs @ pairs.T
        second += pairs.sum(axis=1)
    return gram[_FIRST, _LAST] / n, second / n


def _pairs(y: Array, out: Array) -> Array:
    for k, (i, j) in enumerate(PAIRS.tolist()):
        np.multiply(y[i], y[j], out=out[k])
    return out


def _products(y: Array) -> tuple[Array, Array, int]:
    """Means (50, 50) of products two by two of the 35 quartics, the 10 pairs, 1 and the 4 channels; means (50, blocks) of blocks, and their size."""
    n = y.shape[1]
    block = max(n // _BLOCKS, 1)
    size = min(max(_CHUNK // block, 1) * block, n)
    gram, means = np.zeros((50, 50)), []
    buffer = np.empty((50, size))
    buffer[45] = 1.0
    for start in range(0, n, size):
        part = y[:, start : start + size]
        m = part.shape[1]
        one = buffer[:, :m]
        pairs = _pairs(part, one[35:45])
        for k, (first, last) in enumerate(zip(_FIRST, _LAST, strict=True)):
            np.multiply(pairs[first], pairs[last], out=one[k])
        one[46:] = part
        gram += one @ one.T
        whole = m // block
        means.append(one[:, : whole * block].reshape(50, whole, block).mean(axis=2))
    return gram / n, np.concatenate(means, axis=1), block


def _error(gram: Array, blocks: Array, block: int, n: int, mean: Mean) -> Array:
    """Sampling covariance (45, 45) of cumulants and covariances.

    Each estimate moves with a sample by its influence, linear in the sample's products: y_i y_j y_k y_l − Σ R_ij y_k y_l, and with an
    unknown mean − Σ m_ijk y_l. The mean of the influences' squares is the variance of one sample's share.
    """
    second, third = gram[45, 35:45], gram[35:45, 46:]
    rows = np.zeros((45, 50))
    rows[:, :45] = np.eye(45)
    np.subtract.at(rows, (_EACH, 35 + _LEFT), second[_RIGHT])
    np.subtract.at(rows, (_EACH, 35 + _RIGHT), second[_LEFT])
    if mean == "unknown":
        np.subtract.at(rows, (_FOUR, 46 + QUADRUPLES), third[_REST_PAIR, _REST])
    rows[:, 45] = -rows @ gram[45]  # so that influences have no mean
    single = rows @ gram @ rows.T
    single = 0.5 * (single + single.T)
    return single / n * _dependence(single, rows @ blocks, block)


def _dependence(single: Array, means: Array, block: int) -> float:
    """How much more the blocks' means (45, k) scatter than those of independent samples would, averaged over independent directions."""
    values, vectors = np.linalg.eigh(single / np.maximum(np.sqrt(np.outer(d := np.diag(single), d)), 1e-300))
    kept = values > 1e-9 * values[-1]
    if means.shape[1] < 8 or not kept.any():
        return 1.0
    white = (vectors[:, kept] / np.sqrt(values[kept])).T @ (means / np.sqrt(np.maximum(d, 1e-300))[:, None])
    return float(max(block * np.mean(np.var(white, axis=1, ddof=1)), 0.1))
