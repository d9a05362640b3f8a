"""Track before detect: a Bernoulli filter of particles on the scans' fields, for one target that may come and go.

Nothing is detected: each particle's weight is multiplied by how much likelier the fields are with the target there than without one, so
that weak evidence adds up over frames, and the probability that there is a target at all, r, comes with it.

    predict   r' = p_B (1 − r) + p_S r,     particles: survivors moved, and newborn uniform over the room
    update    w_i ← w_i g_i / (1 − r' + Σ w_j g_j),     r = Σ w_i

Source: Ristic, Vo, Vo & Farina 2013, "A tutorial on Bernoulli filters", sections III and V; regularised resampling: Musso, Oudjane &
Le Gland 2001; resampling by other than the weights: Liu, Chen & Logvinenko 2001.
Deviations: particles are drawn by the square root of their weights and keep the other half of it, so that a small probability of a target
elsewhere keeps particles until more is known. Where the cloud has several humps the heaviest is reported, not the mean. A frame without a field only predicts, and
nothing is born in it. Beyond the room's box there is no target. p_B and p_S are of one period and follow the time that passed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from sonobench.errors import SetupError
from sonobench.filtering.bernoulli import updated
from sonobench.filtering.gaussian import root
from sonobench.filtering.kinematics import position_columns, variances
from sonobench.filtering.particles import Cloud, balls, empty_cloud, gathered, join
from sonobench.filtering.resampling import systematic
from sonobench.filtering.steps import elapsed, refuse_adaptive, survival
from sonobench.protocols import BoundLikelihood, Likelihood, Motion
from sonobench.types import Array, Estimate, Scan, Setup, Space
from sonobench_plugins.likelihood.tdoa_field import TdoaField
from sonobench_plugins.motion.constant_velocity import ConstantVelocity

_HUMP = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class TbdState:
    """Posterior at a time: `cloud`'s weights sum to the probability of existence; corners (2, n) of the room in the state's positions."""

    time_s: float
    cloud: Cloud
    likelihood: BoundLikelihood
    corners_m: Array
    period_s: float | None


@dataclass(frozen=True)
class TrackBeforeDetect:
    """Bernoulli particle filter; particles carry their motion mode."""

    motion: Motion = field(default_factory=ConstantVelocity)  #: how the target moves
    likelihood: Likelihood = field(default_factory=TdoaField)  #: what fields say of it
    p_birth: float = 0.05  #: probability that a target appears within one period (a scan, where scans have no period)
    p_s: float = 0.99  #: probability that it survives one period
    particles: int = 2000  #: after resampling
    born_particles: int = 2000  #: newborn each scan, uniform over the room
    born_speed_m_s: float = 0.5  #: deviation of each velocity coordinate of the newborn
    kernel: float = 0.1  #: width of the kernel that resampled particles are spread by, as a share of the best one for a Gaussian cloud
    report_existence: float = 0.5  #: the target is reported when it exists more probably
    cluster_m: float = 0.3  #: radius of the hump that is reported

    def __post_init__(self) -> None:
        if not all(0 <= p <= 1 for p in (self.p_birth, self.p_s, self.report_existence)):
            raise ValueError(f"p_birth {self.p_birth}, p_s {self.p_s}, report_existence {self.report_existence}: 0 to 1 is needed")
        if min(self.particles, self.born_particles) < 1:
            raise ValueError("numbers of particles must be at least 1")
        if not (self.kernel >= 0 and self.born_speed_m_s >= 0 and self.cluster_m > 0):
            raise ValueError("kernel and born_speed_m_s must be at least 0, cluster_m above 0")

    @property
    def space(self) -> Space:
        """The motion model's."""
        return self.motion.space

    def init(self, rng: np.random.Generator, setup: Setup) -> TbdState:
        """Nobody.

        Raises:
            SetupError: a model does not fit the setup or this filter, or the room is not known.
        """
        refuse_adaptive(self.motion, "tbd")
        model = self.likelihood.bind(self.space, setup)
        n = len(position_columns(self.space, "tbd"))
        variances(self.space, 0.0, 0.0, "tbd")
        if setup.box_m is None:
            raise SetupError(
                "tbd lets targets appear anywhere in the room and needs its box; the recording is in free field or does not say"
            )
        return TbdState(setup.start_s, empty_cloud(len(self.space)), model, setup.box_m[:, :n], setup.period_s)

    def step(self, rng: np.random.Generator, state: TbdState, scan: Scan) -> tuple[TbdState, Estimate]:
        """Predict, give birth, update, report, resample."""
        dt_s = elapsed(state.time_s, scan)
        old = self._moved(rng, state, dt_s)
        born = self._born(rng, state, dt_s)
        cloud = join(old, born)
        log_ratio = state.likelihood.log_ratio(cloud.x, scan)
        if log_ratio is None:
            estimate, _ = self._reported(old, scan.time_s)
            return replace(state, time_s=scan.time_s, cloud=old), estimate
        absent = max(1.0 - float(np.exp(cloud.log_w).sum()), 0.0)
        _, log_w = updated(absent, cloud.log_w, log_ratio)
        cloud = cloud._replace(log_w=log_w)
        estimate, hump = self._reported(cloud, scan.time_s)
        return replace(state, time_s=scan.time_s, cloud=self._resampled(rng, cloud, hump)), estimate

    def _moved(self, rng: np.random.Generator, state: TbdState, dt_s: float) -> Cloud:
        """The survivors, where they are now; who left the room is no target any more."""
        cloud = state.cloud
        if len(cloud.log_w) == 0 or self.p_s == 0:
            return empty_cloud(len(self.space))
        x, mode = self.motion.sample(rng, cloud.x, cloud.mode, dt_s)
        low, high = state.corners_m
        at = x[:, position_columns(self.space, "tbd")]
        kept = ((at >= low) & (at <= high)).all(axis=1)
        return Cloud(cloud.log_w[kept] + np.log(survival(self.p_s, dt_s, state.period_s)), x[kept], mode[kept])

    def _born(self, rng: np.random.Generator, state: TbdState, dt_s: float) -> Cloud:
        """Newborn particles, uniform over the room, with the probability that somebody appeared."""
        n, columns = self.born_particles, position_columns(self.space, "tbd")
        low, high = state.corners_m
        x = rng.standard_normal((n, len(self.space))) * np.sqrt(variances(self.space, 0.0, self.born_speed_m_s, "tbd"))
        x[:, columns] = rng.uniform(low, high, (n, len(columns)))
        there = min(float(np.exp(state.cloud.log_w).sum()), 1.0)
        none = survival(1.0 - self.p_birth, dt_s, state.period_s)
        with np.errstate(divide="ignore"):
            log_w = np.log((1.0 - none) * (1.0 - there) / n)
        return Cloud(np.full(n, log_w), x, np.zeros(n, np.int64))

    def _reported(self, cloud: Cloud, time_s: float) -> tuple[Estimate, Array]:
        """The heaviest hump, if there is a target at all, and the covariance (d, d) of the hump."""
        r, d = float(np.exp(cloud.log_w).sum()), len(self.space)
        if not r > 0:
            return Estimate(time_s, np.zeros((0, d)), np.zeros((0, d, d)), existence=np.zeros(0), count=0.0), np.zeros((d, d))
        found = balls(cloud, position_columns(self.space, "tbd"), self.cluster_m, _HUMP * r, False)
        m, P = (found.m[0], found.P[0]) if len(found.w) else gathered(cloud.x, np.exp(cloud.log_w))
        n = int(r > self.report_existence)
        estimate = Estimate(time_s, m[None][:n], P[None][:n], existence=np.full(n, r), count=r, info={"particles": len(cloud.log_w)})
        return estimate, P

    def _resampled(self, rng: np.random.Generator, cloud: Cloud, hump: Array) -> Cloud:
        """Drawn by the square root of the weights, which drawn ones make up for, and spread by the hump's kernel."""
        n, d = self.particles, len(self.space)
        r = float(np.exp(cloud.log_w).sum())
        if not r > 0:
            return empty_cloud(d)
        log_w = cloud.log_w - np.max(cloud.log_w)
        chosen = systematic(rng, np.exp(0.5 * log_w), n)
        kept = 0.5 * log_w[chosen]
        width = self.kernel * (4.0 / (n * (d + 2.0))) ** (1.0 / (d + 4.0))
        x = cloud.x[chosen] + width * rng.standard_normal((n, d)) @ root(hump).T
        return Cloud(kept + np.log(r) - np.log(np.exp(kept).sum()), x, cloud.mode[chosen])
