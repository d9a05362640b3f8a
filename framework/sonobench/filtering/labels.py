"""Which target a particle belongs to: labels that particles hand on, so that estimates are tracks.

A label is a number from 0 on, never used twice. Born particles have none (`UNLABELLED`) until they are many enough to be a
target. Prediction, update and resampling hand labels on (Liang 2016, eq. 5-18); what the thesis leaves open (who names the born ones, what
becomes of two labels on one target, or of two targets under one label) is decided after each update, by `relabelled`:

1. Unlabelled particles near a target's mean are that target's, where it holds at least as much as they do.
2. Those that are left and hold more than a target's least weight in a ball are a new target.
3. A target whose weight rounds to more than one is split, by k-means; the heaviest part keeps the label.
4. Two targets that together weigh one, and that cannot be told apart in the whole state, are one, under the older label.

The third keeps two targets apart that meet; the fourth takes velocities, so that a missed target is not swallowed by one that it crosses.
Source: Liang 2016, section 5.2.2; the idea of labelled particles is that of Panta, Vo & Singh 2007, "Novel data association schemes for the
probability hypothesis density filter", and of Lin, Bar-Shalom & Kirubarajan 2006, "Track labeling and PHD filter for multitarget tracking".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sonobench.filtering.particles import Cloud, gathered, k_means, places
from sonobench.types import Array, Bools, Ints

UNLABELLED = -1
_ONE = 1.5  # weights below are one target's


class Place(NamedTuple):
    """What a target is: columns of the position in a state, the radius of its ball, the least weight."""

    columns: list[int]
    radius: float
    weight: float


def relabelled(rng: np.random.Generator, cloud: Cloud, place: Place, following: int) -> tuple[Cloud, int]:
    """The cloud with its labels (see above) after an update, and the next label; random numbers are drawn only to split.

    Args:
        rng: for the seeds of k-means.
        cloud: with labels below `following`, or UNLABELLED.
        place: of a target.
        following: the next label that was never used.
    """
    x, w, label = cloud.x[:, place.columns], np.exp(cloud.log_w), np.array(cloud.label)
    _adopt(x, w, label, place.radius)
    free = np.flatnonzero(label == UNLABELLED)
    for inside in places(x[free], w[free], place.radius, place.weight):
        label[free[inside]] = following
        following += 1
    following = _split(rng, x, w, label, following)
    _merge(cloud.x, x, w, label, place.radius)
    return cloud._replace(label=label), following


def _adopt(x: Array, w: Array, label: Ints, radius: float) -> None:
    """Give labels, in place, to unlabelled particles near a target of at least their weight."""
    free = label == UNLABELLED
    if free.all() or not free.any():
        return
    names, mass, mean = _summed(x[~free], w[~free], label[~free])
    square = np.sum((x[free][:, None] - mean) ** 2, axis=-1)
    nearest = np.argmin(square, axis=1)
    near = square[np.arange(len(square)), nearest] <= radius**2
    weight = np.bincount(nearest[near], w[free][near], len(names))
    taken = near & (weight <= mass)[nearest]
    label[np.flatnonzero(free)[taken]] = names[nearest[taken]]


def _split(rng: np.random.Generator, x: Array, w: Array, label: Ints, following: int) -> int:
    """New labels, in place, for all but the heaviest part of what weighs more than one target; the next label."""
    known = label != UNLABELLED
    names, mass, _ = _summed(x[known], w[known], label[known])
    for name, weight in zip(names, mass, strict=True):
        if weight < _ONE:
            continue
        own = np.flatnonzero(label == name)
        of = k_means(rng, x[own], w[own], int(np.rint(weight)))
        parts = np.bincount(of, w[own])
        for part in np.flatnonzero(parts > 0):
            if part != np.argmax(parts):
                label[own[of == part]] = following
                following += 1
    return following


def _merge(states: Array, x: Array, w: Array, label: Ints, radius: float) -> None:
    """Give the older label, in place, to both of two targets that are one."""
    known = label != UNLABELLED
    names, mass, mean = _summed(x[known], w[known], label[known])
    near = np.sum((mean[:, None] - mean) ** 2, axis=-1) <= radius**2
    for i, j in np.argwhere(np.triu(near & (mass[:, None] + mass < _ONE), 1)):
        older, younger = label == names[i], label == names[j]
        if older.any() and younger.any() and _alike(states, w, older, younger):
            label[younger] = names[i]


def _alike(states: Array, w: Array, a: Bools, b: Bools) -> bool:
    """Whether the means of two clouds differ by no more than they are spread: a squared Mahalanobis distance of at most d."""
    (m, P), (n, Q) = (gathered(states[own], w[own]) for own in (a, b))
    spread = P + Q
    std = np.sqrt(np.maximum(np.diag(spread), 1e-12 * (m**2 + n**2) + np.finfo(float).tiny))  # of a single particle there is none
    off, scaled = (m - n) / std, spread / np.outer(std, std)
    return bool(off @ np.linalg.solve(scaled + 1e-6 * np.eye(len(m)), off) <= len(m))


def _summed(x: Array, w: Array, label: Ints) -> tuple[Ints, Array, Array]:
    """Labels (n,) of positive weight in rising order, their weights (n,) and means (n, k)."""
    total = np.bincount(label, w).astype(float)
    names = np.flatnonzero(total > 0).astype(np.int64)
    mean = np.stack([np.bincount(label, w * column)[names] for column in x.T], axis=1) / total[names, None]
    return names, total[names], mean
