"""The labelled multi-Bernoulli filter of Gaussian mixtures: tracks with a probability of existence each.

A PHD filter forgets a target that it missed: the weight of a missed one is 1 − p_D whatever was known of it. Here a track
that is as good as certain stays so: r (1 − p_D) / (1 − r p_D). Tracks compete for rows, so two that meet share none.
Source: Reuter, Vo, Vo & Dietmayer 2014, "The labeled multi-Bernoulli filter", eq. 24 to 31; here the marginal
association probabilities are summed directly (`filtering.association`), as in Williams 2015, "Marginal multi-Bernoulli filters".
Several sensors: one after the other in the order of the setup, with reduction between two; the result depends on that order.
Deviations: no δ-GLMB is enumerated. A row counts as at most e^50 times likelier a track's than clutter, which keeps ratios
finite where clutter cannot be. A frame in which no sensor was searched only predicts, and nothing is born in it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sonobench.filtering.association import marginals
from sonobench.filtering.evidence import noise_of, rows_of, searched
from sonobench.filtering.gaussian import gain, log_gaussian, symmetric
from sonobench.filtering.mixture import cap, empty, merge, prune, union
from sonobench.filtering.phd import log_intensity, patterns
from sonobench.filtering.steps import Update, bound, elapsed, initial, pose_of, survival
from sonobench.protocols import Birth, BoundMeasurement, Measurement, Mixture, Motion, State, Transform
from sonobench.types import Array, Estimate, Floats, Ints, Scan, Setup, Space
from sonobench_plugins.birth.from_detections import FromDetections
from sonobench_plugins.measurement.tdoa import Tdoa
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.transform.cubature import Cubature

_LIKELIEST = 50.0


@dataclass(frozen=True, slots=True, eq=False)
class LmbState:
    """Tracks at a time: `mixture.mode` is a component's track, whose weights add up to its existence; `labels` (n,) by track."""

    time_s: float
    mixture: Mixture
    labels: Ints
    next_label: int
    memory: State
    measurement: BoundMeasurement
    setup: Setup


@dataclass(frozen=True)
class LabelledMultiBernoulli:
    """LMB filter of one motion mode."""

    motion: Motion = field(default_factory=ConstantVelocity)  #: how targets move
    measurement: Measurement = field(default_factory=Tdoa)  #: what sensors measure of them
    transform: Transform = field(default_factory=Cubature)  #: how moments pass through the measurement
    birth: Birth = field(default_factory=FromDetections)  #: where targets appear; each component is a track's beginning
    p_s: float = 0.99  #: probability that a target survives one period (a scan, where scans have no period)
    update: Update = "iterated"  #: "iterated" over any sensors; "stacked" insists on a single one
    prune_weight: float = 1e-4  #: components at or below (existence included) are dropped
    merge_distance: float = 2.0  #: Mahalanobis distance within which a track's components join
    max_components: int = 100  #: the heaviest that are kept, over all tracks
    extract_existence: float = 0.5  #: tracks above are reported

    def __post_init__(self) -> None:
        if not (0 <= self.p_s <= 1 and 0 <= self.extract_existence <= 1):
            raise ValueError(f"p_s is {self.p_s} and extract_existence {self.extract_existence}; 0 to 1 is needed")
        if self.update not in ("iterated", "stacked"):
            raise ValueError(f"update is {self.update!r}; 'iterated' or 'stacked' is needed")
        if not (self.prune_weight >= 0 and self.merge_distance >= 0 and self.max_components >= 1):
            raise ValueError("prune_weight and merge_distance must be at least 0, max_components at least 1")

    @property
    def space(self) -> Space:
        """The motion model's."""
        return self.motion.space

    def init(self, rng: np.random.Generator, setup: Setup) -> LmbState:
        """Nobody, or whom the birth knows of, at the setup's start.

        Raises:
            SetupError: a model does not fit the setup or this filter.
        """
        model = bound(self.motion, self.measurement, setup, self.update, "lmb")
        memory = self.birth.start(self.space, setup, model)
        known = initial(self.birth, memory, len(self.space))
        mixture, labels, following = _join(empty(len(self.space)), np.zeros(0, np.int64), 0, known)
        return LmbState(setup.start_s, mixture, labels, following, memory, model, setup)

    def step(self, rng: np.random.Generator, state: LmbState, scan: Scan) -> tuple[LmbState, Estimate]:
        """Predict, give birth, update, prune, merge, cap, extract."""
        dt_s = elapsed(state.time_s, scan)
        heard = searched(scan, state.measurement.sensors)
        memory, labels, following = state.memory, state.labels, state.next_label
        mixture = self._predict(state.mixture, survival(self.p_s, dt_s, state.setup.period_s), dt_s)
        if heard and not self.birth.uses_scan:
            memory, born = self.birth.propose(rng, memory, scan, mixture)
            mixture, labels, following = _join(mixture, labels, following, born)
        for q in heard:
            mixture = prune(self._update(mixture, len(labels), state, scan, q), self.prune_weight)
            mixture = cap(merge(mixture, self.merge_distance, self.space), self.max_components)
        mixture, labels = _living(mixture, labels)
        estimate = self._extract(mixture, labels, scan.time_s)
        if heard and self.birth.uses_scan:  # the scan that proposes them must not confirm them too
            memory, born = self.birth.propose(rng, memory, scan, mixture)
            mixture, labels, following = _join(mixture, labels, following, born)
        return LmbState(scan.time_s, mixture, labels, following, memory, state.measurement, state.setup), estimate

    def _predict(self, mixture: Mixture, p_s: float, dt_s: float) -> Mixture:
        if len(mixture.w) == 0:
            return mixture
        m, P = self.motion.moments(mixture.m, mixture.P, np.zeros_like(mixture.mode), dt_s)
        return Mixture(mixture.w * p_s, m, P, mixture.mode)

    def _update(self, prior: Mixture, n: int, state: LmbState, scan: Scan, q: int) -> Mixture:
        """One sensor's update of n tracks: each component missed, then given each row, weighted by its track's marginals."""
        z_hat, spread, cross = self.transform.measure(prior.m, prior.P, state.measurement, q, pose_of(state.setup, scan, q))
        rows = rows_of(scan, q, z_hat.shape[-1])
        p_d = state.measurement.p_d(prior.m, q, scan)[..., 0]
        none = np.maximum(1.0 - np.bincount(prior.mode, prior.w * p_d, n), np.exp(-_LIKELIEST))  # absent, or there and missed
        log_w = np.log(np.maximum(prior.w * p_d, np.finfo(float).tiny))
        log_joint = np.full((len(prior.w), len(rows.z)), -np.inf)
        heard = []
        for which, valid in patterns(rows):
            noise = noise_of(state.measurement, scan, q, rows, which, z_hat)[..., valid, :][..., valid]
            residual = state.measurement.residual(rows.z[which], z_hat[:, None, :], q)[..., valid]
            S = spread[:, valid][:, :, valid][:, None] + noise
            over_clutter = log_gaussian(residual, S) - log_intensity(state.measurement, rows.z[which], q, valid)
            log_joint[:, which] = log_w[:, None] + np.minimum(over_clutter, _LIKELIEST)
            heard.append((which, *_conditioned(prior, residual, S, cross[:, None, :, valid])))
        joint = np.exp(log_joint)
        total = np.stack([np.bincount(prior.mode, column, n) for column in joint.T], axis=1) if len(rows.z) else np.zeros((n, 0))
        missed, hit = marginals(total / none[:, None])
        share = np.divide(hit, total, out=np.zeros_like(hit), where=total > 0)[prior.mode] * joint
        parts = [prior._replace(w=prior.w * (1.0 - p_d) * (missed / none)[prior.mode])]
        parts += [_flat(prior, share[:, which], m, P) for which, m, P in heard]
        return union(*parts)

    def _extract(self, mixture: Mixture, labels: Ints, time_s: float) -> Estimate:
        """Mean and covariance of every track that exists more likely than `extract_existence`."""
        existence = np.asarray(np.bincount(mixture.mode, mixture.w, len(labels)), float)
        found = np.flatnonzero(existence > self.extract_existence)
        own = (mixture.mode == found[:, None]) * mixture.w / existence[found, None]
        mean = own @ mixture.m
        off = mixture.m - mean[:, None]
        P = np.einsum("nj,njab->nab", own, mixture.P + off[..., :, None] * off[..., None, :])
        info = {"components": len(mixture.w), "tracks": len(labels)}
        return Estimate(time_s, mean, symmetric(P), labels[found], existence[found], float(existence.sum()), info)


def _conditioned(prior: Mixture, residual: Floats, S: Array, cross: Array) -> tuple[Array, Array]:
    """Means (J, m, d) and covariances (J, m, d, d) given each of m rows, by residuals (J, m, dz)."""
    K = gain(cross, S)
    mean = prior.m[:, None] + (K @ residual[..., None])[..., 0]
    P = symmetric(prior.P[:, None] - K @ np.swapaxes(cross, -1, -2))
    return mean, np.broadcast_to(P, (*residual.shape[:2], *P.shape[-2:]))


def _flat(prior: Mixture, w: Array, m: Array, P: Array) -> Mixture:
    """Components (J m) of weights (J, m)."""
    d = m.shape[-1]
    return Mixture(w.ravel(), m.reshape(-1, d), P.reshape(-1, d, d), np.repeat(prior.mode, w.shape[1]))


def _join(mixture: Mixture, labels: Ints, following: int, born: Mixture) -> tuple[Mixture, Ints, int]:
    """With a new track for every born component; existence is at most certain."""
    n, new = len(labels), len(born.w)
    own = np.arange(new, dtype=np.int64)
    both = union(mixture, born._replace(w=np.minimum(born.w, 1.0), mode=n + own))
    return both, np.concatenate([labels, following + own]), following + new


def _living(mixture: Mixture, labels: Ints) -> tuple[Mixture, Ints]:
    """Without tracks that have no component left."""
    alive, track = np.unique(mixture.mode, return_inverse=True)
    return mixture._replace(mode=track.reshape(-1).astype(np.int64)), labels[alive]
