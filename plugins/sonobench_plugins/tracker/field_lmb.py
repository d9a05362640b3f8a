"""Labelled tracks of particles on a superposed signal: one field that all sources made together, without detections.

The likelihood of a scan is taken as a product over targets, each with its own ratio g(x) against nobody (the spectrum of a subspace is
one: sources are orthogonal to the noise subspace one by one). Then the marginalised δ-GLMB filter, whose sets of labels need no
associations, is exactly a labelled multi-Bernoulli filter:

    predict   r' = p_S r, particles moved (with their modes, by a motion of several); births join as new labels
    update    η = Σ w_i g(x_i),  w_i ← w_i g(x_i) / η,  r ← r η / (1 − r + r η)

`form = "enumerated"` carries a weight for each of the 2ⁿ sets of labels instead (the paper's δ-GLMB); it gives the same to rounding, and
is there to show so.
Two labels that share a peak are one source: where two clouds cannot be told apart, the label that exists less probably goes (of equals
the younger). `report` says who is reported: labels above `extract_existence`, or as many as the cardinality's most probable number.
Source: Zhang et al., "Cum-AMMS-GLMB", section 2.2; Papi & Kim 2015, "A particle multi-target tracker for superpositional measurements
using labeled random finite sets"; Reuter, Vo, Vo & Dietmayer 2014; Vo, See, Ma & Ng 2012, "Multi-sensor joint detection and tracking
with the Bernoulli filter"; modes: McGinnity & Irwin 2000.
Deviations: p_D stands in the likelihood, with the chance of a miss. Pruning is of labels, not of sets. No roughening: motion
that is singular leaves particles where resampling doubled them. A frame without a field only predicts, and nothing is born in it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from sonobench.filtering.gaussian import root
from sonobench.filtering.label_sets import (
    best_set,
    cardinality,
    heard,
    sets_cardinality,
    sets_existence,
    sets_heard,
    sets_kept,
    sets_of,
    sets_survived,
)
from sonobench.filtering.mixture import take
from sonobench.filtering.resampling import systematic
from sonobench.filtering.steps import elapsed, refuse_adaptive, survival
from sonobench.protocols import Birth, BoundLikelihood, Likelihood, Measurement, Mixture, Motion, State
from sonobench.types import Array, Bools, Estimate, Ints, Scan, Setup, Space
from sonobench_plugins.birth.room import Room
from sonobench_plugins.likelihood.tdoa_field import TdoaField
from sonobench_plugins.motion.constant_velocity import ConstantVelocity

_ANGLES, _PLACES = ("azimuth_rad", "elevation_rad"), ("x_m", "y_m", "z_m")


class Tracks(NamedTuple):
    """n labels: label (n,), existence r (n,), particles log_w (n, N) that sum to one, x (n, N, d), mode (n, N)."""

    label: Ints
    r: Array
    log_w: Array
    x: Array
    mode: Ints


@dataclass(frozen=True, slots=True, eq=False)
class FieldLmbState:
    """Tracks at a time; `sets` (2,) · n of the enumerated form, else None."""

    time_s: float
    tracks: Tracks
    sets: Array | None
    following: int
    memory: State
    likelihood: BoundLikelihood
    setup: Setup


@dataclass(frozen=True)
class FieldLmb:
    """LMB filter of particles on fields."""

    motion: Motion = field(default_factory=ConstantVelocity)  #: how targets move; an imm, for several models
    likelihood: Likelihood = field(default_factory=TdoaField)  #: what fields say of one target
    birth: Birth = field(default_factory=Room)  #: where targets appear; each component is a label's beginning
    measurement: Measurement | None = None  #: what the birth asks about detections; None: it only asks which sensors there are
    p_s: float = 0.99  #: probability that a target survives one period (a scan, where scans have no period)
    form: Literal["lmb", "enumerated"] = "lmb"  #: "lmb", or a weight for every set of labels, which gives the same
    particles: int = 500  #: of each label
    resample_below: float = 0.5  #: a label is resampled where its effective number of particles falls below this share
    prune_existence: float = 0.01  #: labels that exist less probably are dropped
    merge_distance: float = 2.0  #: labels whose places differ by less than this many of their own deviations are one (0: never)
    most_labels: int = 16  #: the most probable that are kept
    report: Literal["existence", "cardinality"] = "existence"  #: labels above extract_existence, or the most probable number of them
    extract_existence: float = 0.5  #: for "existence"

    def __post_init__(self) -> None:
        if not all(0 <= p <= 1 for p in (self.p_s, self.extract_existence, self.prune_existence, self.resample_below)):
            raise ValueError("p_s, extract_existence, prune_existence and resample_below must lie between 0 and 1")
        if self.form not in ("lmb", "enumerated") or self.report not in ("existence", "cardinality"):
            raise ValueError(
                f"form is {self.form!r} and report {self.report!r}; 'lmb' or 'enumerated', 'existence' or 'cardinality' are needed"
            )
        if not (self.particles >= 1 and 1 <= self.most_labels <= 20 and self.merge_distance >= 0):
            raise ValueError("particles must be at least 1, most_labels between 1 and 20, merge_distance at least 0")

    @property
    def space(self) -> Space:
        """The motion model's."""
        return self.motion.space

    def init(self, rng: np.random.Generator, setup: Setup) -> FieldLmbState:
        """Nobody, or whom the birth knows of, at the setup's start.

        Raises:
            SetupError: a model does not fit the setup or this filter.
        """
        refuse_adaptive(self.motion, "field-lmb")
        model = self.likelihood.bind(self.space, setup)
        asked: Any = model if self.measurement is None else self.measurement.bind(self.space, setup)
        memory = self.birth.start(self.space, setup, asked)
        d, N = len(self.space), self.particles
        nobody = Tracks(np.zeros(0, np.int64), np.zeros(0), np.zeros((0, N)), np.zeros((0, N, d)), np.zeros((0, N), np.int64))
        state = FieldLmbState(setup.start_s, nobody, np.ones(()) if self.form == "enumerated" else None, 0, memory, model, setup)
        known = getattr(self.birth, "initial", None)
        return state if known is None else self._joined(rng, state, known(memory))

    def step(self, rng: np.random.Generator, state: FieldLmbState, scan: Scan) -> tuple[FieldLmbState, Estimate]:
        """Predict, give birth, update, merge, prune, extract, resample."""
        dt_s = elapsed(state.time_s, scan)
        silent = state.likelihood.log_ratio(np.zeros((0, len(self.space))), scan) is None
        state = self._predicted(rng, replace(state, time_s=scan.time_s), dt_s)
        if silent:
            return state, self._reported(state, self._summary(state.tracks))
        if not self.birth.uses_scan:
            state = self._born(rng, state, scan, self._summary(state.tracks))
        state = self._updated(state, scan)
        state, summary = self._reduced(state, self._summary(state.tracks))
        estimate = self._reported(state, summary)
        state = replace(state, tracks=self._resampled(rng, state.tracks))
        if self.birth.uses_scan:  # the scan that proposes them must not confirm them too
            state = self._born(rng, state, scan, summary)
        return state, estimate

    def _predicted(self, rng: np.random.Generator, state: FieldLmbState, dt_s: float) -> FieldLmbState:
        tracks, p_s = state.tracks, survival(self.p_s, dt_s, state.setup.period_s)
        n, N, d = tracks.x.shape
        x, mode = self.motion.sample(rng, tracks.x.reshape(-1, d), tracks.mode.reshape(-1), dt_s)
        moved = tracks._replace(r=tracks.r * p_s, x=np.reshape(x, (n, N, d)), mode=np.reshape(mode, (n, N)))
        return replace(state, tracks=moved, sets=None if state.sets is None else sets_survived(state.sets, p_s))

    def _born(self, rng: np.random.Generator, state: FieldLmbState, scan: Scan, live: Mixture) -> FieldLmbState:
        memory, born = self.birth.propose(rng, state.memory, scan, live)
        return self._joined(rng, replace(state, memory=memory), born)

    def _joined(self, rng: np.random.Generator, state: FieldLmbState, born: Mixture) -> FieldLmbState:
        """With a new label for every born component; modes are equally probable where the motion has several."""
        (J, d), N, tracks = born.m.shape, self.particles, state.tracks
        if J == 0:
            return state
        x = born.m[:, None] + rng.standard_normal((J, N, d)) @ np.swapaxes(root(born.P), -1, -2)
        mode = rng.permuted(np.tile(np.arange(N, dtype=np.int64) % self.motion.n_modes, (J, 1)), axis=1)
        new = Tracks(state.following + np.arange(J, dtype=np.int64), np.clip(born.w, 0.0, 1.0), np.full((J, N), -np.log(N)), x, mode)
        both = Tracks(*(np.concatenate(parts) for parts in zip(tracks, new, strict=True)))
        kept = np.sort(_likeliest(both)[: self.most_labels])
        old = len(tracks.r)
        sets = None  # those that are dropped are dropped before all sets of the others are listed
        if state.sets is not None:
            sets = np.multiply.outer(sets_kept(state.sets, kept[kept < old]), sets_of(new.r[kept[kept >= old] - old]))
        return replace(state, tracks=_taken(both, kept), sets=sets, following=state.following + J)

    def _updated(self, state: FieldLmbState, scan: Scan) -> FieldLmbState:
        tracks = state.tracks
        n, N, d = tracks.x.shape
        log_g = state.likelihood.log_ratio(tracks.x.reshape(-1, d), scan)
        log_w = tracks.log_w + (0.0 if log_g is None else np.asarray(log_g).reshape(n, N))
        top = np.max(log_w, axis=1, keepdims=True, initial=-np.inf)
        top = np.where(np.isfinite(top), top, 0.0)
        with np.errstate(divide="ignore"):
            log_eta = top[:, 0] + np.log(np.exp(log_w - top).sum(axis=1))
        dead = ~np.isfinite(log_eta)  # no particle explains the scan: the label goes, its particles stay until then
        log_w = np.where(dead[:, None], tracks.log_w, log_w - np.where(dead, 0.0, log_eta)[:, None])
        if state.sets is None:
            return replace(state, tracks=tracks._replace(r=heard(tracks.r, log_eta), log_w=log_w))
        sets = sets_heard(state.sets, log_eta)
        return replace(state, tracks=tracks._replace(r=sets_existence(sets), log_w=log_w), sets=sets)

    def _reduced(self, state: FieldLmbState, summary: Mixture) -> tuple[FieldLmbState, Mixture]:
        """Without labels that share another's peak or hardly exist; and the summary of those that are left."""
        tracks, alike = state.tracks, self._alike(summary)
        kept: list[int] = []
        for i in _likeliest(tracks):
            if tracks.r[i] >= self.prune_existence and not alike[i, kept].any():
                kept.append(int(i))
        left = np.sort(np.array(kept, np.int64))
        return _only(state, left), take(summary, left)

    def _alike(self, summary: Mixture) -> Bools:
        """Which labels (n, n) cannot be told apart by where they are."""
        columns = self._columns()
        off = self.space.residual(summary.m[:, None], summary.m)[..., columns]
        P = summary.P[:, columns][:, :, columns]
        spread = P[:, None] + P
        scale = np.sqrt(np.maximum(np.diagonal(spread, axis1=-2, axis2=-1), np.finfo(float).tiny))
        unit = (off / scale)[..., None]
        white = np.linalg.solve(spread / (scale[..., :, None] * scale[..., None, :]) + 1e-9 * np.eye(len(columns)), unit)
        return np.asarray((unit * white).sum(axis=(-2, -1)) < self.merge_distance**2)

    def _columns(self) -> list[int]:
        names = [n for n in (*_ANGLES, *_PLACES) if n in self.space.names]
        return self.space.index(*names) if names else list(range(len(self.space)))

    def _summary(self, tracks: Tracks) -> Mixture:
        """Mean and covariance of each label's particles, with its existence as weight."""
        w = np.exp(tracks.log_w)
        n = len(w)
        first = tracks.x[np.arange(n), np.argmax(w, axis=1)][:, None]
        off = self.space.residual(tracks.x, first)
        step = np.einsum("np,npd->nd", w, off)
        off = off - step[:, None]
        mean = first[:, 0] + step
        mean = mean - self._turns(mean)
        return Mixture(tracks.r, mean, np.einsum("np,npa,npb->nab", w, off, off, optimize=True), np.zeros(n, np.int64))

    def _turns(self, x: Array) -> Array:
        return np.asarray(x - self.space.residual(x, np.zeros_like(x)))

    def _reported(self, state: FieldLmbState, summary: Mixture) -> Estimate:
        tracks, sets = state.tracks, state.sets
        if self.report == "existence":
            found = np.flatnonzero(tracks.r > self.extract_existence)
        elif sets is not None:
            found = best_set(sets, int(np.argmax(sets_cardinality(sets))))
        else:
            found = np.sort(np.argsort(-tracks.r, kind="stable")[: int(np.argmax(cardinality(tracks.r)))])
        own = take(summary, found)
        count, info = float(tracks.r.sum()), {"labels": len(tracks.r)}
        return Estimate(state.time_s, own.m, own.P, tracks.label[found], own.w, count, info)

    def _resampled(self, rng: np.random.Generator, tracks: Tracks) -> Tracks:
        n, N, _ = tracks.x.shape
        log_w, x, mode = np.array(tracks.log_w), np.array(tracks.x), np.array(tracks.mode)
        for i in range(n):
            w = np.exp(tracks.log_w[i])
            if w.sum() ** 2 < self.resample_below * N * (w @ w):
                chosen = systematic(rng, w, N)
                log_w[i], x[i], mode[i] = -np.log(N), tracks.x[i, chosen], tracks.mode[i, chosen]
        return tracks._replace(log_w=log_w, x=x, mode=mode)


def _only(state: FieldLmbState, kept: Ints) -> FieldLmbState:
    return replace(state, tracks=_taken(state.tracks, kept), sets=None if state.sets is None else sets_kept(state.sets, kept))


def _likeliest(tracks: Tracks) -> Ints:
    """Labels by falling existence, of equals the older first; rounding must not decide between equals."""
    return np.lexsort((tracks.label, -np.round(tracks.r, 9))).astype(np.int64)


def _taken(tracks: Tracks, which: Ints) -> Tracks:
    return Tracks(tracks.label[which], tracks.r[which], tracks.log_w[which], tracks.x[which], tracks.mode[which])
