"""The δ-generalised labelled multi-Bernoulli filter of Gaussian tracks, for detections of any kind.

It holds hypotheses of which labels exist and which row of which scan each of them caused, with their probabilities: the Bayes filter of
labelled sets, short only of the hypotheses that it drops. Prediction and update are one step, whose children are drawn by a Gibbs sampler or
ranked by Murty's algorithm (`filtering.glmb`). Each track is one Gaussian, exact for linear Gaussian models; others through `transform`.
Source: Vo & Vo 2013, "Labeled random finite sets and multi-object conjugate priors"; Vo, Vo & Hoang 2017, "An efficient implementation of the
generalized labeled multi-Bernoulli filter".
Several sensors: one after the other in the order of the setup, truncated between two; only the first step lets targets die.
Deviations: births that a birth model takes from the scan join after the update, and are decided on in the next step. A row counts as at most
e^50 times likelier a track's than clutter, a miss as at least e^-50, which keeps ratios finite where clutter or a miss cannot be. A frame in
which no sensor was searched only predicts, and nothing is born in it. p_D is taken at a track's mean.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, get_args

import numpy as np

from sonobench.filtering.evidence import noise_of, rows_of, searched
from sonobench.filtering.gaussian import gain, symmetric
from sonobench.filtering.glmb import MISSED, Hypotheses, Truncation, children, cut, existence, heaviest, likeliest, nobody, sampled, shares
from sonobench.filtering.mixture import empty, union
from sonobench.filtering.phd import log_densities, log_intensity, patterns
from sonobench.filtering.steps import Update, bound, elapsed, initial, pose_of, survival
from sonobench.protocols import Birth, BoundMeasurement, Measurement, Mixture, Motion, State, Transform
from sonobench.types import Array, Estimate, Floats, Ints, Scan, Setup, Space
from sonobench_plugins.birth.from_detections import FromDetections
from sonobench_plugins.measurement.tdoa import Tdoa
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.transform.cubature import Cubature

_LIKELIEST = 50.0


@dataclass(frozen=True, slots=True, eq=False)
class GlmbState:
    """Hypotheses over `labels` (L,) whose tracks are the components of `tracks` (their w is not used); `born` is decided on next."""

    time_s: float
    hypotheses: Hypotheses
    tracks: Mixture
    labels: Ints
    born: Mixture
    next_label: int
    memory: State
    measurement: BoundMeasurement
    setup: Setup


class _Heard(NamedTuple):
    """Rows `which` of one pattern of components: residual (T, m, dz), S (T, m or 1, dz, dz), cross (T, d, dz)."""

    which: Ints
    residual: Floats
    S: Array
    cross: Array


@dataclass(frozen=True)
class DeltaGlmb:
    """δ-GLMB filter of one motion mode."""

    motion: Motion = field(default_factory=ConstantVelocity)  #: how targets move
    measurement: Measurement = field(default_factory=Tdoa)  #: what sensors measure of them
    transform: Transform = field(default_factory=Cubature)  #: how moments pass through the measurement
    birth: Birth = field(default_factory=FromDetections)  #: where targets appear; each component is a label that may begin
    p_s: float = 0.99  #: probability that a target survives one period (a scan, where scans have no period)
    update: Update = "iterated"  #: "iterated" over any sensors; "stacked" insists on a single one
    truncation: Truncation = "gibbs"  #: "gibbs" draws children, "murty" ranks them (dearer, and no random number is drawn)
    samples: int = 1000  #: of the Gibbs sampler, a scan
    max_hypotheses: int = 200  #: the heaviest that are kept
    prune_weight: float = 1e-5  #: hypotheses lighter than this beside the heaviest are dropped

    def __post_init__(self) -> None:
        if not 0 <= self.p_s <= 1:
            raise ValueError(f"p_s is {self.p_s}; 0 to 1 is needed")
        for name, choices in (("update", get_args(Update)), ("truncation", get_args(Truncation))):
            if getattr(self, name) not in choices:
                raise ValueError(f"{name} is {getattr(self, name)!r}; one of {list(choices)} is needed")
        if min(self.samples, self.max_hypotheses) < 1 or not 0 <= self.prune_weight < 1:
            raise ValueError("samples and max_hypotheses must be at least 1, prune_weight at least 0 and below 1")

    @property
    def space(self) -> Space:
        """The motion model's."""
        return self.motion.space

    def init(self, rng: np.random.Generator, setup: Setup) -> GlmbState:
        """Nobody, or whom the birth knows of, at the setup's start.

        Raises:
            SetupError: a model does not fit the setup or this filter.
        """
        model = bound(self.motion, self.measurement, setup, self.update, "delta-glmb")
        memory = self.birth.start(self.space, setup, model)
        none = empty(len(self.space))
        known = initial(self.birth, memory, len(self.space))
        return GlmbState(setup.start_s, nobody(), none, np.zeros(0, np.int64), known, 0, memory, model, setup)

    def step(self, rng: np.random.Generator, state: GlmbState, scan: Scan) -> tuple[GlmbState, Estimate]:
        """Predict, give birth and update at once, extract."""
        dt_s = elapsed(state.time_s, scan)
        heard = searched(scan, state.measurement.sensors)
        p_s = survival(self.p_s, dt_s, state.setup.period_s)
        old = union(state.tracks._replace(w=np.full(len(state.tracks.w), p_s)), state.born._replace(w=np.minimum(state.born.w, 1.0) * p_s))
        old = old if len(old.w) == 0 else self._moved(old, dt_s)
        memory, new = state.memory, empty(len(self.space))
        live = _summary(self.space, state.hypotheses, old, len(state.tracks.w))
        if heard and not self.birth.uses_scan:
            memory, new = self.birth.propose(rng, memory, scan, live)
        tracks = union(old, new._replace(w=np.minimum(new.w, 1.0), mode=np.zeros_like(new.mode)))
        hypotheses, labels = _with(state.hypotheses, state.labels, len(state.tracks.w), len(tracks.w), state.next_label)
        for q in heard or (None,):
            hypotheses, tracks = self._decided(rng, hypotheses, tracks, state, scan, q)
        hypotheses, labels = _living(hypotheses, labels)
        estimate = self._extract(hypotheses, tracks, labels, scan.time_s)
        born = empty(len(self.space))
        if heard and self.birth.uses_scan:  # the scan that proposes them must not confirm them too
            memory, born = self.birth.propose(rng, memory, scan, _summary(self.space, hypotheses, tracks, len(tracks.w)))
        following = state.next_label + len(state.born.w) + len(new.w)
        after = GlmbState(scan.time_s, hypotheses, tracks, labels, born, following, memory, state.measurement, state.setup)
        return after, estimate

    def _moved(self, tracks: Mixture, dt_s: float) -> Mixture:
        m, P = self.motion.moments(tracks.m, tracks.P, np.zeros_like(tracks.mode), dt_s)
        return Mixture(tracks.w, m, P, np.zeros_like(tracks.mode))

    def _decided(
        self, rng: np.random.Generator, before: Hypotheses, tracks: Mixture, state: GlmbState, scan: Scan, q: int | None
    ) -> tuple[Hypotheses, Mixture]:
        """One joint step: tracks, which are there with probability w, are gone, missed, or seen by sensor q."""
        log_weight, heard = self._weights(tracks, state, scan, q)
        if self.truncation == "murty":
            parent, choice = heaviest(before, log_weight, self.max_hypotheses, self.prune_weight)
        else:
            parent, choice = sampled(rng, before, log_weight, self.samples)
        after, of, chosen = children(before, log_weight, parent, choice)
        after = cut(after, self.max_hypotheses, self.prune_weight)
        kept, number = np.unique(after.of[after.of >= 0], return_inverse=True)
        renumbered = np.full(after.of.shape, -1, np.int64)
        renumbered[after.of >= 0] = number.reshape(-1)
        return Hypotheses(after.log_w, renumbered), _conditioned(tracks, of[kept], chosen[kept] - MISSED - 1, heard)

    def _weights(self, tracks: Mixture, state: GlmbState, scan: Scan, q: int | None) -> tuple[Array, list[_Heard]]:
        """log weights (T, 2 + m) of every track's choices, over those of all rows being clutter; and what conditions a track on a row."""
        with np.errstate(divide="ignore"):
            log_there, log_gone = np.log(tracks.w), np.log1p(-tracks.w)
        if q is None or len(tracks.w) == 0:
            return np.stack([log_gone, log_there], axis=1), []
        z_hat, spread, cross = self.transform.measure(tracks.m, tracks.P, state.measurement, q, pose_of(state.setup, scan, q))
        rows = rows_of(scan, q, z_hat.shape[-1])
        p_d = state.measurement.p_d(tracks.m, q, scan)[..., 0]
        log_ratio = np.empty((len(tracks.w), len(rows.z)))
        heard = []
        for which, valid in patterns(rows):
            noise = noise_of(state.measurement, scan, q, rows, which, z_hat)[..., valid, :][..., valid]
            residual = state.measurement.residual(rows.z[which], z_hat[:, None, :], q)[..., valid]
            S = spread[:, valid][:, :, valid][:, None] + noise
            log_g = log_densities(residual, S)
            log_kappa = log_intensity(state.measurement, rows.z[which], q, valid)
            log_ratio[:, which] = log_g - np.maximum(log_kappa, log_g.max(axis=0) - _LIKELIEST)
            heard.append(_Heard(which, residual, S, cross[..., valid]))
        with np.errstate(divide="ignore"):
            missed, seen = np.log(np.maximum(1.0 - p_d, np.exp(-_LIKELIEST))), np.log(p_d)
        return np.column_stack([log_gone, log_there + missed, (log_there + seen)[:, None] + log_ratio]), heard

    def _extract(self, hypotheses: Hypotheses, tracks: Mixture, labels: Ints, time_s: float) -> Estimate:
        """The tracks of the heaviest hypothesis of the likeliest number of targets."""
        row, r = likeliest(hypotheses), existence(hypotheses)
        found = np.flatnonzero(row >= 0)
        info = {"hypotheses": len(hypotheses.log_w), "tracks": len(tracks.w)}
        own = row[found]
        return Estimate(time_s, tracks.m[own], tracks.P[own], labels[found], r[found], float(r.sum()), info)


def _conditioned(tracks: Mixture, of: Ints, row: Ints, heard: list[_Heard]) -> Mixture:
    """Tracks `of` given `row`, −1 for none; they are there for certain."""
    m, P = tracks.m[of].copy(), tracks.P[of].copy()
    for part in heard:
        mine = np.flatnonzero(np.isin(row, part.which))
        t, j = of[mine], np.searchsorted(part.which, row[mine])
        cross, S = part.cross[t], part.S[t, np.minimum(j, part.S.shape[1] - 1)]
        K = gain(cross, S)
        m[mine] += (K @ part.residual[t, j][..., None])[..., 0]
        P[mine] = symmetric(P[mine] - K @ np.swapaxes(cross, -1, -2))
    return Mixture(np.ones(len(of)), m, P, np.zeros(len(of), np.int64))


def _with(hypotheses: Hypotheses, labels: Ints, first: int, last: int, following: int) -> tuple[Hypotheses, Ints]:
    """With new labels for the tracks `first` to `last`, which every hypothesis has."""
    new = np.arange(first, last, dtype=np.int64)
    of = np.concatenate([hypotheses.of, np.tile(new, (len(hypotheses.of), 1))], axis=1)
    return Hypotheses(hypotheses.log_w, of), np.concatenate([labels, following + np.arange(len(new), dtype=np.int64)])


def _living(hypotheses: Hypotheses, labels: Ints) -> tuple[Hypotheses, Ints]:
    """Without labels that no hypothesis has."""
    alive = (hypotheses.of >= 0).any(axis=0)
    return Hypotheses(hypotheses.log_w, np.ascontiguousarray(hypotheses.of[:, alive])), labels[alive]


def _summary(space: Space, hypotheses: Hypotheses, tracks: Mixture, n: int) -> Mixture:
    """A component a label, of its existence, mean and covariance over the first n tracks: what a birth may look at."""
    w = shares(hypotheses, n)
    there = hypotheses.of.T >= 0
    label = np.full(n, -1)
    for i, (of, here) in enumerate(zip(hypotheses.of.T, there, strict=True)):
        label[of[here]] = i
    own = (label == np.arange(len(there))[:, None]) * w
    r = own.sum(axis=1)
    own = own / np.maximum(r, np.finfo(float).tiny)[:, None]
    lead = (
        tracks.m[:n][own.argmax(axis=1)] if own.size else np.zeros((len(own), tracks.m.shape[1]))
    )  # what is periodic averages by its differences from one of them
    m = lead + np.einsum("ln,lnd->ld", own, space.residual(tracks.m[:n], lead[:, None]))
    off = space.residual(tracks.m[:n], m[:, None])
    P = np.einsum("ln,nab->lab", own, tracks.P[:n]) + np.einsum("ln,lna,lnb->lab", own, off, off)
    return Mixture(np.minimum(r, 1.0), m, symmetric(P), np.zeros(len(r), np.int64))
