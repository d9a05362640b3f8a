"""The cardinality-balanced multi-target multi-Bernoulli filter (CBMeMBer) of Gaussian mixtures, for detections.

A union of independent targets, each with a probability of existence r and a Gaussian mixture. Each scan leaves every target as it is when missed,
and adds one for each row, to which all targets contribute, with the existence that makes the expected number right:

    missed   r (1 − p_D) / (1 − r p_D)
    row z    r_U = Σ_i r_i (1 − r_i) ρ_i / (1 − r_i p_D)²  /  (κ + Σ_i r_i ρ_i / (1 − r_i p_D)),   ρ_i = <p_i, p_D g_z>
             its density is the sum of r_i / (1 − r_i) p_i p_D g_z

Source: Vo, Vo & Cantoni 2009, "The cardinality balanced multi-target multi-Bernoulli filter and its implementations", IEEE Trans. Signal Processing 57,
eq. 38 to 45; it corrects the bias of Mahler's filter, and takes p_D to be high.
Several sensors: one after the other in the order of the setup. No labels.
Deviations: existence is at most .999, as r / (1 − r) must stay finite. A row counts as at most e^50 times likelier a target's than clutter. A
frame in which no sensor was searched only predicts, and nothing is born in it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sonobench.filtering.evidence import noise_of, rows_of, searched
from sonobench.filtering.gaussian import gain, symmetric
from sonobench.filtering.label_sets import cardinality
from sonobench.filtering.mixture import cap, empty, merge, prune, take, union
from sonobench.filtering.phd import log_densities, log_intensity, patterns
from sonobench.filtering.steps import Update, bound, elapsed, initial, pose_of, survival
from sonobench.protocols import Birth, BoundMeasurement, Measurement, Mixture, Motion, State, Transform
from sonobench.types import Array, Estimate, Floats, Ints, Scan, Setup, Space
from sonobench_plugins.birth.from_detections import FromDetections
from sonobench_plugins.measurement.tdoa import Tdoa
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.transform.cubature import Cubature

_LIKELIEST = 50.0
_SUREST = 0.999


@dataclass(frozen=True, slots=True, eq=False)
class CbMemberState:
    """Targets at a time: `mixture.mode` is a component's target, 0 on, whose weights add up to its existence."""

    time_s: float
    mixture: Mixture
    memory: State
    measurement: BoundMeasurement
    setup: Setup


@dataclass(frozen=True)
class GaussianCbMember:
    """CBMeMBer filter of one motion mode."""

    motion: Motion = field(default_factory=ConstantVelocity)  #: how targets move
    measurement: Measurement = field(default_factory=Tdoa)  #: what sensors measure of them
    transform: Transform = field(default_factory=Cubature)  #: how moments pass through the measurement
    birth: Birth = field(default_factory=FromDetections)  #: where targets appear; each component is a target that may begin
    p_s: float = 0.99  #: probability that a target survives one period (a scan, where scans have no period)
    update: Update = "iterated"  #: "iterated" over any sensors; "stacked" insists on a single one
    prune_existence: float = 1e-3  #: targets that exist less probably are dropped
    prune_weight: float = 1e-5  #: components at or below (existence included) are dropped
    merge_distance: float = 2.0  #: Mahalanobis distance within which a target's components join
    max_components: int = 200  #: the heaviest that are kept, over all targets

    def __post_init__(self) -> None:
        if not (0 <= self.p_s <= 1 and 0 <= self.prune_existence < 1):
            raise ValueError(f"p_s is {self.p_s} and prune_existence {self.prune_existence}; 0 to 1 is needed")
        if self.update not in ("iterated", "stacked"):
            raise ValueError(f"update is {self.update!r}; 'iterated' or 'stacked' is needed")
        if not (self.prune_weight >= 0 and self.merge_distance >= 0 and self.max_components >= 1):
            raise ValueError("prune_weight and merge_distance must be at least 0, max_components at least 1")

    @property
    def space(self) -> Space:
        """The motion model's."""
        return self.motion.space

    def init(self, rng: np.random.Generator, setup: Setup) -> CbMemberState:
        """Nobody, or whom the birth knows of, at the setup's start.

        Raises:
            SetupError: a model does not fit the setup or this filter.
        """
        model = bound(self.motion, self.measurement, setup, self.update, "gm-cbmember")
        memory = self.birth.start(self.space, setup, model)
        mixture = _joined(empty(len(self.space)), initial(self.birth, memory, len(self.space)))
        return CbMemberState(setup.start_s, mixture, memory, model, setup)

    def step(self, rng: np.random.Generator, state: CbMemberState, scan: Scan) -> tuple[CbMemberState, Estimate]:
        """Predict, give birth, update, prune, merge, cap, extract."""
        dt_s = elapsed(state.time_s, scan)
        heard = searched(scan, state.measurement.sensors)
        memory, mixture = state.memory, self._predict(state.mixture, survival(self.p_s, dt_s, state.setup.period_s), dt_s)
        if heard and not self.birth.uses_scan:
            memory, born = self.birth.propose(rng, memory, scan, mixture)
            mixture = _joined(mixture, born)
        for q in heard:
            mixture = self._reduced(self._update(mixture, state, scan, q))
        estimate = self._extract(mixture, scan.time_s)
        if heard and self.birth.uses_scan:  # the scan that proposes them must not confirm them too
            memory, born = self.birth.propose(rng, memory, scan, mixture)
            mixture = _joined(mixture, born)
        return CbMemberState(scan.time_s, mixture, memory, state.measurement, state.setup), estimate

    def _predict(self, mixture: Mixture, p_s: float, dt_s: float) -> Mixture:
        if len(mixture.w) == 0:
            return mixture
        m, P = self.motion.moments(mixture.m, mixture.P, np.zeros_like(mixture.mode), dt_s)
        return Mixture(mixture.w * p_s, m, P, mixture.mode)

    def _update(self, prior: Mixture, state: CbMemberState, scan: Scan, q: int) -> Mixture:
        """Targets that were missed, then one for each row."""
        r = np.minimum(existence(prior), _SUREST)
        n = len(r)
        prior = prior._replace(w=prior.w * (r / np.maximum(existence(prior), np.finfo(float).tiny))[prior.mode])
        z_hat, spread, cross = self.transform.measure(prior.m, prior.P, state.measurement, q, pose_of(state.setup, scan, q))
        rows = rows_of(scan, q, z_hat.shape[-1])
        p_d = state.measurement.p_d(prior.m, q, scan)[..., 0]
        absent = np.maximum(1.0 - np.bincount(prior.mode, prior.w * p_d, n), np.exp(-_LIKELIEST))  # 1 − r p_D
        parts = [prior._replace(w=prior.w * (1.0 - p_d) / absent[prior.mode])]
        for which, valid in patterns(rows) if n else ():
            noise = noise_of(state.measurement, scan, q, rows, which, z_hat)[..., valid, :][..., valid]
            residual = state.measurement.residual(rows.z[which], z_hat[:, None, :], q)[..., valid]
            S = spread[:, valid][:, :, valid][:, None] + noise
            log_g = log_densities(residual, S)
            log_kappa = log_intensity(state.measurement, rows.z[which], q, valid)
            joint = (prior.w * p_d)[:, None] * np.exp(log_g - np.maximum(log_kappa, log_g.max(axis=0) - _LIKELIEST))  # r ρ / κ
            r_u = balanced(np.stack([np.bincount(prior.mode, column, n) for column in joint.T], axis=1), r, absent)
            share = joint / (1.0 - r)[prior.mode, None]
            total = share.sum(axis=0)
            w = np.divide(share * r_u, total, out=np.zeros_like(share), where=total > 0)
            parts.append(_conditioned(prior, w, residual, S, cross[..., valid], n + which, self.prune_weight))
        return union(*parts)

    def _reduced(self, mixture: Mixture) -> Mixture:
        r = existence(mixture)
        mixture = prune(take(mixture, r[mixture.mode] > self.prune_existence), self.prune_weight)
        return _numbered(cap(merge(mixture, self.merge_distance, self.space), self.max_components))

    def _extract(self, mixture: Mixture, time_s: float) -> Estimate:
        """The heaviest components of the likeliest number of targets, those of highest existence."""
        r = existence(mixture)
        n = int(np.argmax(cardinality(r))) if len(r) else 0
        best = [int(np.flatnonzero(mixture.mode == i)[np.argmax(mixture.w[mixture.mode == i])]) for i in np.argsort(-r, kind="stable")[:n]]
        found = take(mixture, np.array(best, np.int64))
        info = {"components": len(mixture.w), "targets": len(r)}
        return Estimate(time_s, found.m, found.P, None, r[found.mode], float(r.sum()), info)


def existence(mixture: Mixture) -> Array:
    """Probability (n,) that each target exists."""
    return np.asarray(np.bincount(mixture.mode, mixture.w), float)


def balanced(joint: Array, r: Array, absent: Array) -> Array:
    """Existence (m,) of the targets that rows add, of joint (n, m) = r ρ / κ, existence r (n,) before and absent (n,) = 1 − r p_D."""
    above = (joint * ((1.0 - r) / absent**2)[:, None]).sum(axis=0)
    return np.minimum(above / (1.0 + (joint / absent[:, None]).sum(axis=0)), _SUREST)


def _conditioned(prior: Mixture, w: Array, residual: Floats, S: Array, cross: Array, target: Ints, above: float) -> Mixture:
    """Components of weights w (J, m) above a weight, given each row, as those of targets (m,)."""
    j, k = np.nonzero(w > above)
    K = gain(cross[j], S[j, np.minimum(k, S.shape[1] - 1)])
    m = prior.m[j] + (K @ residual[j, k][..., None])[..., 0]
    P = symmetric(prior.P[j] - K @ np.swapaxes(cross[j], -1, -2))
    return Mixture(w[j, k], m, P, target[k].astype(np.int64))


def _joined(mixture: Mixture, born: Mixture) -> Mixture:
    """With a new target for every born component; existence is at most certain."""
    n = int(mixture.mode.max(initial=-1)) + 1
    return union(mixture, born._replace(w=np.minimum(born.w, _SUREST), mode=n + np.arange(len(born.w), dtype=np.int64)))


def _numbered(mixture: Mixture) -> Mixture:
    """Targets numbered from 0 on without gaps."""
    return mixture._replace(mode=np.unique(mixture.mode, return_inverse=True)[1].reshape(-1).astype(np.int64))
