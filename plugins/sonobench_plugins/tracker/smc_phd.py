"""The bootstrap particle PHD filter (SMC-PHD), also for targets that cause several detections and for several sensors jointly.

With a measurement model of L > 1 modes (echoes) a sensor's update is the exact multi-detection one (MD-PHD). Several sensors
are taken one after the other ("iterated", whose result depends on their order), or at once ("joint", the exact update of all).
Source: Vo, Singh & Doucet 2005, "Sequential Monte Carlo methods for multitarget filtering with random finite sets", section
III; the thesis of Liang 2016, chapter 4. Extraction of targets from the particles:
- "balls": the balls of radius cluster_m that hold most weight, one after the other, as long as they hold more than extract_weight;
- "measurement": the rows whose share of the weights is above extract_weight (Zhao, Zheng & Liu 2010, also Ristic et al. 2010);
- "k-means": as many clusters as the weights round to (Vo, Singh & Doucet 2005; what Liang calls the standard filter);
- "labels": particles hand on the label of their target (Liang 2016, section 5.2.2, see `filtering.labels`); only here estimates are tracks.
Deviations: Liang prints Q as 4×4 beside a 4×2 gain and leaves R, births and clutter region open; here they are the models'.
eq. 4-26 lacks its sum over particles. Section 5.2.2 hands labels on, but names nobody; `filtering.labels` says who is named when.
A frame in which no sensor was searched only predicts, and nothing is born in it. Eq. 5-23, a product over sensors, is a
single-target formula (its mass explodes), and is not here; eq. 5-29 is, without listing partitions (`filtering.multidetection`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from sonobench.errors import SetupError
from sonobench.filtering.evidence import searched
from sonobench.filtering.gaussian import root
from sonobench.filtering.kinematics import position_columns
from sonobench.filtering.labels import UNLABELLED, Place, relabelled
from sonobench.filtering.multidetection import evidence, factors
from sonobench.filtering.particles import Cloud, balls, clustered, empty_cloud, join, labelled, shared
from sonobench.filtering.phd import reweigh
from sonobench.filtering.resampling import RESAMPLERS, Resampling
from sonobench.filtering.steps import JointUpdate, bound, elapsed, initial, pose_of, survival
from sonobench.protocols import Birth, BoundMeasurement, Measurement, Mixture, Motion, State
from sonobench.types import Array, Estimate, Ints, Scan, Setup, Space
from sonobench_plugins.birth.from_detections import FromDetections
from sonobench_plugins.measurement.tdoa import Tdoa
from sonobench_plugins.motion.langevin import Langevin

Extraction = Literal["balls", "measurement", "k-means", "labels"]


@dataclass(frozen=True, slots=True, eq=False)
class ParticleState:
    """Posterior particles at a time, the next label, the birth's memory, and the models of the setup."""

    time_s: float
    cloud: Cloud
    following: int
    memory: State
    measurement: BoundMeasurement
    setup: Setup


@dataclass(frozen=True)
class ParticlePhd:
    """Bootstrap SMC-PHD filter; particles carry their motion mode."""

    motion: Motion = field(default_factory=Langevin)  #: how targets move
    measurement: Measurement = field(default_factory=Tdoa)  #: what sensors measure of them
    birth: Birth = field(default_factory=FromDetections)  #: where targets appear
    p_s: float = 0.99  #: probability that a target survives one period (a scan, where scans have no period)
    update: JointUpdate = "iterated"  #: "iterated" over any sensors; "joint": all at once; "stacked" insists on a single one
    cut: float = (
        1e-6  #: of several detections a target: joint origins less probable than this beside others; 0 is exact; info says what was used
    )
    particles: int = 500  #: after resampling, for each expected target
    most_particles: int = 4000  #: after resampling, in all
    born_particles: int = 200  #: for each component that the birth proposes
    resampling: Resampling = "systematic"  #: "systematic", "stratified" or "residual"
    extraction: Extraction = "balls"  #: "balls", "measurement", "k-means" or "labels": what a target is, see above
    extract_weight: float = 0.5  #: balls, rows or labels above are reported
    cluster_m: float = 0.4  #: radius of a ball; of labels, what is near
    multiplicity: bool = True  #: report a ball as often as its weight rounds to

    def __post_init__(self) -> None:
        if not 0 <= self.p_s <= 1:
            raise ValueError(f"p_s is {self.p_s}; 0 to 1 is needed")
        for name, choices in (
            ("update", get_args(JointUpdate)),
            ("extraction", get_args(Extraction)),
            ("resampling", get_args(Resampling)),
        ):
            if getattr(self, name) not in choices:
                raise ValueError(f"{name} is {getattr(self, name)!r}; one of {list(choices)} is needed")
        if not 0 <= self.cut < 1:
            raise ValueError(f"cut is {self.cut}; at least 0 and below 1 is needed")
        if min(self.particles, self.most_particles, self.born_particles) < 1 or not (self.extract_weight > 0 and self.cluster_m > 0):
            raise ValueError("numbers of particles must be at least 1, extract_weight and cluster_m above 0")

    @property
    def space(self) -> Space:
        """The motion model's."""
        return self.motion.space

    def init(self, rng: np.random.Generator, setup: Setup) -> ParticleState:
        """Nobody, or whom the birth knows of, at the setup's start.

        Raises:
            SetupError: a model does not fit the setup or this filter.
        """
        model = bound(self.motion, self.measurement, setup, self.update, "smc-phd", several=True, modes=True)
        position_columns(self.space, "smc-phd")
        if self.extraction == "measurement" and (len(model.sensors) != 1 or model.n_modes != 1):
            raise SetupError(
                f'smc-phd with extraction = "measurement" reads one sensor and one detection a target, measurement '
                f'{type(self.measurement).__name__} reads {len(model.sensors)} and predicts up to {model.n_modes}; use extraction = "balls"'
            )
        memory = self.birth.start(self.space, setup, model)
        cloud = self._sampled(rng, initial(self.birth, memory, len(self.space)))
        return ParticleState(time_s=setup.start_s, cloud=cloud, following=0, memory=memory, measurement=model, setup=setup)

    def step(self, rng: np.random.Generator, state: ParticleState, scan: Scan) -> tuple[ParticleState, Estimate]:
        """Predict, update, extract, resample."""
        dt_s = elapsed(state.time_s, scan)
        heard = searched(scan, state.measurement.sensors)
        memory, shares = state.memory, None
        info: dict[str, float] = {}
        cloud = self._predict(rng, state, dt_s)
        if heard and not self.birth.uses_scan:
            memory, born = self.birth.propose(rng, memory, scan, _summary(cloud))
            cloud = join(cloud, self._sampled(rng, born))
        for sensors in [heard] if self.update == "joint" and heard else [(q,) for q in heard]:
            log_w, shares, told = self._update(cloud, state, scan, sensors)
            cloud, info = cloud._replace(log_w=log_w), {k: max(v, info.get(k, 0.0)) for k, v in told.items()}
        following = state.following
        if self._labelled:
            cloud, following = relabelled(rng, cloud, self._place(), following)
        found, labels = self._extract(rng, cloud, shares)
        mass = float(np.exp(cloud.log_w).sum())
        estimate = Estimate(scan.time_s, found.m, found.P, labels, found.w, mass, {"particles": len(cloud.log_w), **info})
        if heard:
            cloud = self._resample(rng, cloud, mass)
            if self.birth.uses_scan:  # the scan that proposes them must not confirm them too
                memory, born = self.birth.propose(rng, memory, scan, found)
                cloud = join(cloud, self._sampled(rng, born))
        return ParticleState(scan.time_s, cloud, following, memory, state.measurement, state.setup), estimate

    @property
    def _labelled(self) -> bool:
        return self.extraction == "labels"

    def _place(self) -> Place:
        return Place(position_columns(self.space, "smc-phd"), self.cluster_m, self.extract_weight)

    def _predict(self, rng: np.random.Generator, state: ParticleState, dt_s: float) -> Cloud:
        cloud, p_s = state.cloud, survival(self.p_s, dt_s, state.setup.period_s)
        if len(cloud.log_w) == 0 or p_s == 0:
            return empty_cloud(len(self.space), self._labelled)
        x, mode = self.motion.sample(rng, cloud.x, cloud.mode, dt_s)
        return Cloud(cloud.log_w + np.log(p_s), x, mode, cloud.label)

    def _sampled(self, rng: np.random.Generator, born: Mixture) -> Cloud:
        """Particles of a birth mixture, born_particles for each component, of the component's weight together; nobody's yet."""
        J, d = born.m.shape
        noise = rng.standard_normal((J, self.born_particles, d)) @ np.swapaxes(root(born.P), -1, -2)
        kept = born.w > 0
        log_w = np.log(born.w[kept] / self.born_particles)
        x = (born.m[:, None] + noise)[kept].reshape(-1, d)
        label = np.full(len(x), UNLABELLED, np.int64) if self._labelled else None
        return Cloud(np.repeat(log_w, self.born_particles), x, np.repeat(born.mode[kept], self.born_particles), label)

    def _update(
        self, cloud: Cloud, state: ParticleState, scan: Scan, sensors: tuple[int, ...]
    ) -> tuple[Array, Array | None, Mapping[str, float]]:
        """New log weights; the share of each row in them where a row is one target's only detection; else the cut and rows left out."""
        model, q = state.measurement, sensors[0]
        if model.n_modes == 1 and len(sensors) == 1:
            z_hat = model.h(cloud.x, q, pose_of(state.setup, scan, q))[..., 0, :]
            return *reweigh(cloud.log_w, cloud.x, z_hat, scan, model, q), {}
        found = factors(cloud.log_w, *evidence(cloud.x, scan, model, state.setup, sensors), cut=self.cut)
        with np.errstate(divide="ignore"):
            return cloud.log_w + np.log(found.factor), None, {"cut": found.cut, "left_out": found.left_out}

    def _extract(self, rng: np.random.Generator, cloud: Cloud, shares: Array | None) -> tuple[Mixture, Ints | None]:
        """Targets, and their labels where particles have some."""
        if self._labelled:
            return labelled(cloud, self.extract_weight)
        if self.extraction == "measurement" and shares is not None:
            return shared(cloud, shares, self.extract_weight), None
        columns, radius, weight = self._place()
        if self.extraction == "k-means":
            return clustered(rng, cloud, columns), None
        return balls(cloud, columns, radius, weight, self.multiplicity), None

    def _resample(self, rng: np.random.Generator, cloud: Cloud, mass: float) -> Cloud:
        """Equal weights that keep the mass, `particles` for each expected target, at least for one."""
        if mass <= 0:
            return empty_cloud(len(self.space), self._labelled)
        n = min(max(round(self.particles * mass), self.particles), self.most_particles)
        chosen = RESAMPLERS[self.resampling](rng, np.exp(cloud.log_w), n)
        label = None if cloud.label is None else cloud.label[chosen]
        return Cloud(np.full(n, np.log(mass / n)), np.take(cloud.x, chosen, axis=0), cloud.mode[chosen], label)


def _summary(cloud: Cloud) -> Mixture:
    """Particles as components without spread: what a birth may look at."""
    n, d = cloud.x.shape
    return Mixture(np.exp(cloud.log_w), cloud.x, np.zeros((n, d, d)), cloud.mode)
