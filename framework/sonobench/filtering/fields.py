"""Curves with peaks in noise as evidence: what a value says for a peak, calibrated on the curve itself.

Of a curve's values most are noise, N(0, s²); a share of them, epsilon, lies on peaks of height a > 0 with noise on top. In units
of s a peak's height is half-normal of scale A, so that a value u = value / s is on a peak rather than off it by

    G(u) = 2 / √(1 + A²) exp(σ² u² / 2) Φ(σ u),      σ² = A² / (1 + A²).

A target that shows with probability p makes a value at one of its places likelier by (1 − p) + p G / (1 − epsilon + epsilon G), since what
is on the curve without it may be a peak too (another's, an unknown echo). So no single value counts more than p / epsilon: bounded
evidence, which peaks of unknown origin cannot overrule.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sonobench.types import Array, Floats

_MAD = 1.4826  # of a Gaussian: deviation over median absolute deviation
_ROUNDS = 15
_SCALE = 3.0  # lowest A: lower peaks are not told from noise


class Peaks(NamedTuple):
    """Of a curve: deviation of its noise, scale A of its peaks' heights in units of that, share of values that lie on peaks."""

    noise: float
    scale: float
    share: float


def calibrated(values: Floats) -> Peaks | None:
    """Noise, height and share of the peaks of a curve (n,); None of a curve without noise (all but constant: it says nothing).

    The noise is the scaled median absolute value; share and height follow by expectation and maximisation.
    """
    values = np.asarray(values, float)
    noise = _MAD * float(np.median(np.abs(values), axis=0)) if values.size else 0.0
    if not noise > 0:
        return None
    u, A, share = values / noise, 2 * _SCALE, 0.05
    for _ in range(_ROUNDS):
        log_odds = np.log(share) - np.log1p(-share) + log_peak(u, A)
        on = np.exp(-np.logaddexp(0.0, -log_odds))
        square = A * A / (1 + A * A)
        height = square + (square * np.maximum(u, 0.0)) ** 2  # E a² given u, but for the truncation at 0
        A = max(math.sqrt(float(on @ height) / max(float(on.sum()), 1e-300)), _SCALE)
        share = float(np.clip(on.mean(), 1.0 / len(u), 0.5))
    return Peaks(noise, A, share)


def log_peak(u: Floats, scale: float) -> Array:
    """log G of values u in units of the noise."""
    from scipy.special import log_ndtr

    square = scale * scale / (1 + scale * scale)
    return np.asarray(math.log(2 / math.sqrt(1 + scale * scale)) + 0.5 * square * u * u + log_ndtr(math.sqrt(square) * u))


def log_shown(values: Floats, p: Floats, peaks: Peaks) -> Array:
    """log of (1 − p) + p G / (1 − share + share G) of values at places where a target shows with probability p."""
    log_g = log_peak(np.asarray(values, float) / peaks.noise, peaks.scale)
    relative = log_g - np.logaddexp(math.log1p(-peaks.share), math.log(peaks.share) + log_g)
    return np.asarray(np.log1p(p * np.expm1(relative)))


def once(places: Floats, used: Floats, width: float) -> Array:
    """Weights (…, L) of places (…, L) on a curve such that coinciding ones count as one, and ones `width` apart as separate.

    Args:
        places: (…, L).
        used: (…, L) bool; others have weight 0 and take nothing away.
        width: distance from which on two values are independent; between, they share in proportion.
    """
    at, active = np.moveaxis(np.asarray(places, float), -1, 0) / width, np.moveaxis(np.asarray(used, bool), -1, 0)
    sharing = np.ones(at.shape)
    for k in range(len(at)):
        for l in range(k):  # pair by pair: a table of all pairs at once takes three times as long
            near = np.where(active[k] & active[l], np.maximum(1.0 - np.abs(at[k] - at[l]), 0.0), 0.0)
            sharing[k] += near
            sharing[l] += near
    return np.moveaxis(np.where(active, 1.0 / sharing, 0.0), 0, -1)
