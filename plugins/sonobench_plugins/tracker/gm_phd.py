"""The Gaussian-mixture PHD filter, whose moments pass through h by a component: EK-, UK- and CK-PHD are three of its presets.

Source: Vo & Ma 2006, "The Gaussian mixture probability hypothesis density filter", tables I to III; Chen, Chen, Yin & Hou
2012, eq. 15 to 35 (cubature). Several sensors: the iterated corrector of Mahler 2003, section V-C, one sensor after the
other in the order of the setup, with reduction between two; its result depends on that order.
Deviations: the clutter intensity is a density (see the measurement model), not the count that Chen et al. print. A frame
in which no sensor was searched only predicts, and nothing is born or spawned in it: births stand for targets that begin to
be observed, and would add up to one that nobody observed. The points of a transform are drawn anew from the predicted Gaussian
before the update (eq. 27), so that they carry the process noise; points kept from the prediction would not, and the gain would
be too small. The iterated corrector's result depends on the order of its sensors; the exact joint one is smc-phd's.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sonobench.filtering.evidence import searched
from sonobench.filtering.mixture import any_mode, cap, empty, extract, merge, predict, union
from sonobench.filtering.phd import Moments, correct
from sonobench.filtering.steps import Update, bound, elapsed, initial, pose_of, survival
from sonobench.protocols import Birth, BoundMeasurement, Measurement, Mixture, Motion, Spawn, State, Transform
from sonobench.types import Estimate, Scan, Setup, Space
from sonobench_plugins.birth.from_detections import FromDetections
from sonobench_plugins.measurement.tdoa import Tdoa
from sonobench_plugins.motion.langevin import Langevin
from sonobench_plugins.transform.cubature import Cubature


@dataclass(frozen=True, slots=True, eq=False)
class PhdState:
    """Posterior mixture at a time, the birth's memory, and the models of the setup."""

    time_s: float
    mixture: Mixture
    memory: State
    measurement: BoundMeasurement
    setup: Setup


@dataclass(frozen=True)
class GaussianMixturePhd:
    """GM-PHD filter; under a motion of several modes components branch and merge within a mode, and are joined over modes to be reported."""

    motion: Motion = field(default_factory=Langevin)  #: how targets move
    measurement: Measurement = field(default_factory=Tdoa)  #: what sensors measure of them
    transform: Transform = field(default_factory=Cubature)  #: how moments pass through the measurement
    birth: Birth = field(default_factory=FromDetections)  #: where targets appear
    spawn: Spawn | None = None  #: where targets split off others; None: nowhere
    p_s: float = 0.99  #: probability that a target survives one period (a scan, where scans have no period)
    update: Update = "iterated"  #: "iterated" over any sensors; "stacked" insists on a single one
    prune_weight: float = 1e-5  #: components at or below are dropped
    merge_distance: float = 2.0  #: Mahalanobis distance within which components join (Vo & Ma's U is its square)
    max_components: int = 100  #: the heaviest that are kept
    extract_weight: float = 0.5  #: components above are reported
    multiplicity: bool = True  #: report a component as often as its weight rounds to

    def __post_init__(self) -> None:
        if not 0 <= self.p_s <= 1:
            raise ValueError(f"p_s is {self.p_s}; 0 to 1 is needed")
        if self.update not in ("iterated", "stacked"):
            raise ValueError(f"update is {self.update!r}; 'iterated' or 'stacked' is needed")
        if not (self.prune_weight >= 0 and self.merge_distance >= 0 and self.max_components >= 1):
            raise ValueError("prune_weight and merge_distance must be at least 0, max_components at least 1")

    @property
    def space(self) -> Space:
        """The motion model's."""
        return self.motion.space

    def init(self, rng: np.random.Generator, setup: Setup) -> PhdState:
        """Nobody, or whom the birth knows of, at the setup's start.

        Raises:
            SetupError: a model does not fit the setup or this filter.
        """
        model = bound(self.motion, self.measurement, setup, self.update, "gm-phd", modes=True)
        memory = self.birth.start(self.space, setup, model)
        if self.spawn is not None:
            self.spawn.spawned(empty(len(self.space)))
        return PhdState(
            time_s=setup.start_s, mixture=initial(self.birth, memory, len(self.space)), memory=memory, measurement=model, setup=setup
        )

    def step(self, rng: np.random.Generator, state: PhdState, scan: Scan) -> tuple[PhdState, Estimate]:
        """Predict, give birth, spawn, update, prune, merge, cap, extract."""
        dt_s = elapsed(state.time_s, scan)
        heard = searched(scan, state.measurement.sensors)
        memory = state.memory
        moved = predict(state.mixture, self.motion, 1.0, dt_s)
        mixture = moved._replace(w=moved.w * survival(self.p_s, dt_s, state.setup.period_s))
        if heard and self.spawn is not None:
            mixture = union(mixture, self.spawn.spawned(moved))
        if heard and not self.birth.uses_scan:
            memory, born = self.birth.propose(rng, memory, scan, mixture)
            mixture = union(mixture, born)
        for q in heard:
            mixture = merge(self._update(mixture, state, scan, q), self.merge_distance, self.space)
            mixture = cap(mixture, self.max_components)
        whole = mixture if self.motion.n_modes == 1 else merge(any_mode(mixture), self.merge_distance, self.space)
        found = extract(whole, self.extract_weight, self.multiplicity)
        estimate = Estimate(scan.time_s, found.m, found.P, existence=found.w, count=mixture.w.sum(), info={"components": len(mixture.w)})
        if heard and self.birth.uses_scan:  # the scan that proposes them must not confirm them too
            memory, born = self.birth.propose(rng, memory, scan, mixture)
            mixture = union(mixture, born)
        after = PhdState(time_s=scan.time_s, mixture=mixture, memory=memory, measurement=state.measurement, setup=state.setup)
        return after, estimate

    def _update(self, prior: Mixture, state: PhdState, scan: Scan, q: int) -> Mixture:
        pose = pose_of(state.setup, scan, q)
        moments = Moments(*self.transform.measure(prior.m, prior.P, state.measurement, q, pose))
        return correct(prior, moments, scan, state.measurement, q, self.prune_weight)
