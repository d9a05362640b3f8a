"""Hypotheses of the δ-GLMB filter: which labels exist, and which of its tracks each of them has.

A hypothesis is a row of `of` (H, L): for every label the number of its track (a Gaussian, or whatever a caller keeps), −1 where it does not
exist. One step gives each track one choice: 0, it is gone; 1, it is missed; 2 + j, it caused row j. No two tracks choose the same row. A child's
weight is its parent's times the product of its choices' weights. There are far too many children to list, so they are truncated: to the
heaviest, by Murty's algorithm, or to those that a Gibbs sampler meets, whose stationary distribution is the children's weights.
Source: Vo & Vo 2013, "Labeled random finite sets and multi-object conjugate priors"; Vo, Vo & Hoang 2017, "An efficient implementation of the
generalized labeled multi-Bernoulli filter", section III (joint prediction and update) and IV (Gibbs sampler).
"""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Literal, NamedTuple

import numpy as np

from sonobench.filtering.ranked import ranked
from sonobench.types import Array, Ints

Truncation = Literal["gibbs", "murty"]
GONE, MISSED, FIRST_ROW = 0, 1, 2


class Hypotheses(NamedTuple):
    """log_w (H,), which are normalised, and of (H, L): the track of each label, −1 where it does not exist."""

    log_w: Array
    of: Ints


@cache
def glmb_kernels() -> ModuleType:
    """The compiled loop, imported at its first use."""
    from sonobench.filtering import glmb_kernels

    return glmb_kernels


def nobody() -> Hypotheses:
    """The one hypothesis of no label."""
    return Hypotheses(np.zeros(1), np.zeros((1, 0), np.int64))


def sampled(rng: np.random.Generator, before: Hypotheses, log_weight: Array, samples: int) -> tuple[Ints, Ints]:
    """Different children that Gibbs sampling meets: parents (K,), choices (K, L), −1 where the label has no track.

    Args:
        rng: one number is drawn for each sample and label.
        before: the parents, which get samples by the root of their weights, at least one each.
        log_weight: (T, 2 + m) of each track's choices.
        samples: in all.
    """
    share = np.exp(0.5 * (before.log_w - before.log_w.max()))
    sweeps = np.ceil(samples * share / share.sum()).astype(np.int64)
    top = log_weight.max(axis=1, initial=-np.inf, keepdims=True)
    weight = np.exp(log_weight - np.where(np.isfinite(top), top, 0.0))
    S, L = int(sweeps.sum()), before.of.shape[1]
    table = np.empty((S, 1 + L), np.int64)
    parent, choice = np.empty(S, np.int64), np.empty((S, L), np.int64)
    glmb_kernels().gibbs(weight, np.ascontiguousarray(before.of), sweeps, FIRST_ROW, rng.random((S, L)), parent, choice)
    table[:, 0], table[:, 1:] = parent, choice
    different = np.unique(table, axis=0)
    return different[:, 0], different[:, 1:]


def heaviest(before: Hypotheses, log_weight: Array, most: int, least: float) -> tuple[Ints, Ints]:
    """The `most` heaviest children, less those lighter than `least` of the heaviest; as of `sampled`."""
    there = before.of >= 0
    tables = [log_weight[of[here]] for of, here in zip(before.of, there, strict=True)]
    parents: list[int] = []
    choices: list[Ints] = []
    floor = -np.inf
    for log_w, h, choice in ranked(before.log_w, tables, FIRST_ROW):
        if not parents and least > 0:
            floor = log_w + np.log(least)
        if len(parents) >= most or log_w < floor:
            break
        row = np.full(before.of.shape[1], -1, np.int64)
        row[there[h]] = choice
        parents.append(h)
        choices.append(row)
    return np.array(parents, np.int64), np.array(choices, np.int64).reshape(len(parents), before.of.shape[1])


def children(before: Hypotheses, log_weight: Array, parent: Ints, choice: Ints) -> tuple[Hypotheses, Ints, Ints]:
    """Hypotheses after these choices, in falling order of weight, and their tracks: each one's track before, and its choice (T',).

    Children of different parents that have the same tracks become one.
    """
    T, c = log_weight.shape
    of = before.of[parent]
    there = choice >= 0
    log = np.where(there, log_weight[np.where(there, of, 0), np.where(there, choice, 0)] if T else 0.0, 0.0)
    log_w = before.log_w[parent] + log.sum(axis=1)
    key = np.where(choice >= MISSED, of * c + choice, -1)
    rows, which = np.unique(key, axis=0, return_inverse=True)
    top = float(log_w.max())
    total = np.bincount(which.reshape(-1), np.exp(log_w - top), len(rows))
    with np.errstate(divide="ignore"):
        log_w = np.log(total) - np.log(total.sum())
    order = np.lexsort([*rows.T, -log_w])
    rows, log_w = rows[order], log_w[order]
    kept = np.unique(rows[rows >= 0])
    new = np.where(rows >= 0, np.searchsorted(kept, rows), -1)
    return Hypotheses(log_w, new.astype(np.int64)), kept // c, kept % c


def cut(hypotheses: Hypotheses, most: int, least: float) -> Hypotheses:
    """The `most` first of hypotheses in falling order, less those lighter than `least` of the first, normalised."""
    n = max(int(np.count_nonzero(hypotheses.log_w >= hypotheses.log_w[0] + (np.log(least) if least > 0 else -np.inf))), 1)
    log_w = hypotheses.log_w[: min(n, most)]
    return Hypotheses(log_w - np.log(np.exp(log_w).sum()), hypotheses.of[: min(n, most)])


def existence(hypotheses: Hypotheses) -> Array:
    """Probability that each label exists (L,)."""
    return np.asarray(np.minimum(np.exp(hypotheses.log_w) @ (hypotheses.of >= 0), 1.0))


def shares(hypotheses: Hypotheses, tracks: int) -> Array:
    """Probability of each track (T,)."""
    there = hypotheses.of >= 0
    w = np.broadcast_to(np.exp(hypotheses.log_w)[:, None], there.shape)[there]
    return np.asarray(np.bincount(hypotheses.of[there], w, tracks), float)


def likeliest(hypotheses: Hypotheses) -> Ints:
    """The row (L,) of the heaviest hypothesis of the likeliest number of labels (Vo & Vo 2013, section V-C)."""
    number = (hypotheses.of >= 0).sum(axis=1)
    best = int(np.argmax(np.bincount(number, np.exp(hypotheses.log_w))))
    return np.asarray(hypotheses.of[np.argmax(np.where(number == best, hypotheses.log_w, -np.inf))])
