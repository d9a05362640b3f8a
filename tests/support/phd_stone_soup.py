"""The cubature GM-PHD filter of Stone Soup on our scans, with our models' numbers: the peer of ours.

It is the same recursion: births enter the update where ours do (at the scan, not predicted) and are kept when missed, which Stone
Soup leaves out for components that it calls "birth"; so they get another tag, and a weight over p_S, with which it multiplies.
Left as it is: merging pairwise with a growing component, total weights capped at 1, lost weight shared among the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.hypothesiser.gaussianmixture import GaussianMixtureHypothesiser
from stonesoup.measures import Mahalanobis
from stonesoup.mixturereducer.gaussianmixture import GaussianMixtureReducer
from stonesoup.models.base import TimeVariantModel
from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
from stonesoup.models.transition.linear import LinearGaussianTransitionModel
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.types.array import CovarianceMatrix, StateVector
from stonesoup.types.detection import Detection
from stonesoup.types.state import State, TaggedWeightedGaussianState
from stonesoup.updater.kalman import CubatureKalmanUpdater
from stonesoup.updater.pointprocess import PHDUpdater

from sonobench.filtering.mixture import empty
from sonobench.filtering.steps import initial
from sonobench.protocols import Birth, Mixture
from sonobench.types import Array, Estimate, Scan

EPOCH = datetime(2026, 1, 1)


class Kicks(LinearGaussianTransitionModel, TimeVariantModel):
    """Langevin motion of a plane: our F and Q."""

    ndim_state = 4
    matrices = None

    def matrix(self, time_interval, **kwargs):
        return type(self).matrices(time_interval.total_seconds())[0]

    def covar(self, time_interval, **kwargs):
        return CovarianceMatrix(type(self).matrices(time_interval.total_seconds())[1])


class Delays(NonLinearGaussianMeasurement):
    """Delays of pairs; microphones[2 i] and [2 i + 1] are pair i, in the plane of the talkers."""

    ndim_meas = 4
    microphones: Array
    c_m_s: float

    def function(self, state, noise=False, **kwargs):
        x = np.asarray(state.state_vector, float)
        r = np.hypot(self.microphones[:, :1] - x[0], self.microphones[:, 1:] - x[2])
        return type(state.state_vector)((r[::2] - r[1::2]) / self.c_m_s)

    def rvs(self, *args, **kwargs):
        raise NotImplementedError

    def pdf(self, *args, **kwargs):
        raise NotImplementedError


@dataclass(frozen=True)
class Numbers:
    """What both filters share: models, and the reduction of the mixture."""

    p_s: float
    p_d: float
    delay_std_s: float
    clutter_density: float
    prune_weight: float
    merge_distance: float
    max_components: int
    extract_weight: float


class StoneSoup:
    """`run` gives one Estimate a scan, with the number of components in its info."""

    def __init__(self, numbers: Numbers, birth: Birth, memory: Any, matrices, microphones: Array, c_m_s: float) -> None:
        self.numbers, self.birth, self.memory = numbers, birth, memory
        kicks = type("BoundKicks", (Kicks,), {"matrices": staticmethod(matrices)})
        delays = type("BoundDelays", (Delays,), {"microphones": microphones, "c_m_s": c_m_s})
        noise = CovarianceMatrix(np.eye(4) * numbers.delay_std_s**2)
        self.model = delays(ndim_state=4, mapping=(0, 2), noise_covar=noise)
        updater = CubatureKalmanUpdater(self.model)
        self.updater = PHDUpdater(
            updater, clutter_spatial_density=numbers.clutter_density, prob_detection=numbers.p_d, prob_survival=numbers.p_s
        )
        base = DistanceHypothesiser(KalmanPredictor(kicks()), updater, Mahalanobis(), missed_distance=1e9)  # no gate, as ours
        self.hypothesiser = GaussianMixtureHypothesiser(base, order_by_detection=True)
        self.reducer = GaussianMixtureReducer(
            prune_threshold=numbers.prune_weight,
            merge_threshold=numbers.merge_distance**2,
            max_number_components=numbers.max_components,
        )

    def delays(self, x: Array) -> Array:
        """What the measurement model says of one state (4,)."""
        return np.asarray(self.model.function(State(StateVector(x))), float)[:, 0]

    def run(self, scans: Sequence[Scan], start_s: float) -> list[Estimate]:
        """Births, prediction, update, reduction, extraction, scan by scan."""
        known = self._born(initial(self.birth, self.memory, 4), EPOCH + timedelta(seconds=start_s), 1.0)
        components: set[TaggedWeightedGaussianState] = set(known)
        out, memory = [], self.memory
        for scan in scans:
            now = EPOCH + timedelta(seconds=scan.time_s)
            memory, born = self.birth.propose(np.random.default_rng(0), memory, scan, empty(4))
            components |= set(self._born(born, now, self.numbers.p_s))
            rows = [z for group in scan.detections for z in group.z]
            detections = {Detection(StateVector(z), timestamp=now, measurement_model=self.model) for z in rows}
            hypotheses = self.hypothesiser.hypothesise(components, detections, now)
            components = set(self.reducer.reduce(list(self.updater.update(hypotheses))))
            found = [np.asarray(c.state_vector, float)[:, 0] for c in components if c.weight > self.numbers.extract_weight]
            out.append(Estimate(scan.time_s, np.reshape(found, (-1, 4)), info={"components": len(components)}))
        return out

    def _born(self, born: Mixture, now: datetime, survives: float):
        for k, (w, m, P) in enumerate(zip(born.w, born.m, born.P, strict=True)):
            yield TaggedWeightedGaussianState(
                StateVector(m), CovarianceMatrix(P), weight=float(w) / survives, tag=f"{now}/{k}", timestamp=now
            )
