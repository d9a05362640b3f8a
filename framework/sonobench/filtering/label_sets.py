"""Which labels exist: independent probabilities (labelled multi-Bernoulli), or a weight for every set of labels (marginalised δ-GLMB).

Where a scan's likelihood is a product over targets, every set of labels is updated by the product of the same factors: no set is told
from another by more than its members, weights that factorise stay so, and the 2ⁿ of them are worth no more than the n probabilities

    r' = r η / (1 − r + r η),      η = ∫ g(x) p(x) dx.

Sets are arrays of shape (2,) · n, axis i telling whether label i is a member.
Source: Reuter, Vo, Vo & Dietmayer 2014, "The labeled multi-Bernoulli filter"; Papi & Kim 2015, "A particle multi-target tracker for
superpositional measurements using labeled random finite sets"; Fantacci & Papi 2016, "Scalable multisensor multitarget tracking using the
marginalized δ-GLMB density".
"""

from __future__ import annotations

import numpy as np

from sonobench.types import Array, Ints


def heard(r: Array, log_eta: Array) -> Array:
    """Existence (n,) after a scan that is e^log_eta (n,) times likelier with the target than without."""
    with np.errstate(divide="ignore"):
        log_odds = np.log(r) - np.log1p(-r)
    impossible = np.isneginf(log_eta)
    return np.where(impossible, 0.0, np.exp(-np.logaddexp(0.0, -(log_odds + np.where(impossible, 0.0, log_eta)))))


def sets_of(r: Array) -> Array:
    """Weights (2,) · n of all sets of labels that exist independently with probabilities r (n,)."""
    sets = np.ones(())
    for one in r:
        sets = sets[..., None] * np.array([1.0 - one, one])
    return sets


def sets_survived(sets: Array, p_s: float) -> Array:
    """Every member survives with probability p_s: a smaller set is fed by all larger ones."""
    step = np.array([[1.0, 1.0 - p_s], [0.0, p_s]])
    for axis in range(sets.ndim):
        sets = np.moveaxis(np.tensordot(step, sets, (1, axis)), 0, axis)
    return sets


def sets_heard(sets: Array, log_eta: Array) -> Array:
    """Weights after a scan: each set's times the product of its members' factors, summing to one.

    Raises:
        ValueError: no set explains the scan.
    """
    with np.errstate(divide="ignore"):
        log_w = np.log(sets)
    for axis, one in enumerate(log_eta):
        shape = [1] * sets.ndim
        shape[axis] = 2
        log_w = log_w + np.array([0.0, one]).reshape(shape)
    top = log_w.max()
    if not np.isfinite(top):
        raise ValueError("no set of labels explains the scan; every weight is zero")
    w = np.exp(log_w - top)
    return np.asarray(w / w.sum())


def sets_kept(sets: Array, kept: Ints) -> Array:
    """Weights of the sets of some labels, whatever becomes of the others."""
    return np.asarray(sets.sum(axis=tuple(i for i in range(sets.ndim) if i not in set(kept.tolist()))))


def sets_existence(sets: Array) -> Array:
    """Probability (n,) that each label exists."""
    return np.array([sets.take(1, axis=i).sum() for i in range(sets.ndim)])


def sets_cardinality(sets: Array) -> Array:
    """Probability (n + 1,) of each number of members."""
    number = sum((np.arange(2).reshape([2 if j == i else 1 for j in range(sets.ndim)]) for i in range(sets.ndim)), np.zeros((), np.int64))
    return np.asarray(np.bincount(np.broadcast_to(number, sets.shape).ravel(), sets.ravel(), sets.ndim + 1), np.float64)


def best_set(sets: Array, size: int) -> Ints:
    """The members of the heaviest set of `size` labels."""
    indices = np.indices(sets.shape).reshape(sets.ndim, sets.size)
    own = np.flatnonzero(indices.sum(axis=0) == size)
    return np.flatnonzero(indices[:, own[np.argmax(sets.ravel()[own])]]).astype(np.int64)


def cardinality(r: Array) -> Array:
    """Probability (n + 1,) of each number of independent labels."""
    found = np.ones(1)
    for one in r:
        found = np.convolve(found, [1.0 - one, one])
    return found
