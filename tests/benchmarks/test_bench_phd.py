"""The GM-PHD step beside Stone Soup's on the same scans: four pairs, three talkers, seven false vectors a scan (Chen et al. 2012).

Both are the cubature PHD filter with the same births, p_S, p_D, clutter density, pruning weight, merging distance and cap.
Stone Soup leaves a missed birth out of the mixture and predicts births like survivors; neither matters with p_D = .98.
"""

from __future__ import annotations

from datetime import datetime, timedelta

import numpy as np
import phd_scenes as scenes
import pytest

from sonobench_plugins.birth.fixed import Fixed
from sonobench_plugins.birth.from_detections import FromDetections
from sonobench_plugins.tracker.gm_phd import GaussianMixturePhd
from sonobench_plugins.tracker.smc_phd import ParticlePhd
from sonobench_plugins.transform.linearised import Linearised
from sonobench_plugins.transform.unscented import Unscented

#: every talker may be born at his place in every scan, in both filters
BIRTHS = Fixed(scenes.BIRTHS, np.full((1, 4), 1e-4), np.array([0.1]))
EPOCH = datetime(2026, 1, 1)


def ours(tracker, frames):
    estimates = scenes.run(tracker, scenes.setup(), frames)
    return [e.states for e in estimates], float(np.mean([e.info.get("components", 0) for e in estimates]))


class StoneSoup:
    """The same filter from Stone Soup's parts."""

    def __init__(self):
        from stonesoup.hypothesiser.distance import DistanceHypothesiser
        from stonesoup.hypothesiser.gaussianmixture import GaussianMixtureHypothesiser
        from stonesoup.measures import Mahalanobis
        from stonesoup.mixturereducer.gaussianmixture import GaussianMixtureReducer
        from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
        from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
        from stonesoup.predictor.kalman import KalmanPredictor
        from stonesoup.types.array import CovarianceMatrix
        from stonesoup.updater.kalman import CubatureKalmanUpdater
        from stonesoup.updater.pointprocess import PHDUpdater

        class Delays(NonLinearGaussianMeasurement):
            ndim_meas = 4

            def function(self, state, noise=False, **kwargs):
                x = np.asarray(state.state_vector, float)
                return type(state.state_vector)(scenes.delays(x.T).T)

            def rvs(self, *args, **kwargs):
                raise NotImplementedError

            def pdf(self, *args, **kwargs):
                raise NotImplementedError

        F, Q = GaussianMixturePhd().motion.matrices(scenes.PERIOD_S)
        motion = LinearGaussianTimeInvariantTransitionModel(transition_matrix=F, covariance_matrix=CovarianceMatrix(Q))
        self.model = Delays(ndim_state=4, mapping=(0, 2), noise_covar=CovarianceMatrix(np.eye(4) * scenes.SIGMA_S**2))
        updater = CubatureKalmanUpdater(self.model)
        density = 7.0 / (2 * 0.6 / 343.0) ** 4
        self.updater = PHDUpdater(updater, clutter_spatial_density=density, prob_detection=0.98, prob_survival=0.99)
        base = DistanceHypothesiser(KalmanPredictor(motion), updater, Mahalanobis(), missed_distance=1e6)
        self.hypothesiser = GaussianMixtureHypothesiser(base, order_by_detection=True)
        self.reducer = GaussianMixtureReducer(prune_threshold=1e-5, merge_threshold=4.0, max_number_components=100)

    def run(self, frames):
        from stonesoup.types.array import CovarianceMatrix, StateVector
        from stonesoup.types.detection import Detection
        from stonesoup.types.state import TaggedWeightedGaussianState

        components, found, sizes = set(), [], []
        for k, frame in enumerate(frames):
            now = EPOCH + timedelta(seconds=frame.time_s)
            for row in scenes.BIRTHS:
                components.add(
                    TaggedWeightedGaussianState(
                        StateVector(row),
                        CovarianceMatrix(np.eye(4) * 1e-4),
                        weight=0.1,
                        tag="birth",
                        timestamp=EPOCH + timedelta(seconds=k * scenes.PERIOD_S),
                    )
                )
            detections = {Detection(StateVector(z), timestamp=now, measurement_model=self.model) for z in frame.rows(0)[0]}
            hypotheses = self.hypothesiser.hypothesise(components, detections, now)
            components = set(self.reducer.reduce(list(self.updater.update(hypotheses))))
            sizes.append(len(components))
            found.append(np.array([np.asarray(c.state_vector, float)[:, 0] for c in components if c.weight > 0.5]).reshape(-1, 4))
        return found, float(np.mean(sizes))


def position_ospa(found) -> float:
    return float(np.mean([scenes.ospa(scenes.truth(k)[:, [0, 2]], x[:, [0, 2]]) for k, x in enumerate(found, 1)]))


@pytest.fixture(scope="module")
def frames():
    return scenes.scans(np.random.default_rng(0))


@pytest.mark.parametrize(
    "tracker",
    [
        GaussianMixturePhd(birth=BIRTHS),
        GaussianMixturePhd(transform=Linearised(), birth=BIRTHS),
        GaussianMixturePhd(transform=Unscented(), birth=BIRTHS),
        GaussianMixturePhd(birth=FromDetections()),
        ParticlePhd(birth=BIRTHS),
    ],
    ids=["ck-phd", "ek-phd", "uk-phd", "ck-phd-from-detections", "smc-phd"],
)
def test_a_hundred_steps(benchmark, frames, tracker):
    found, components = benchmark(ours, tracker, frames)
    benchmark.extra_info.update(ms_per_step=benchmark.stats.stats.median * 10, components=components, ospa_m=position_ospa(found))


def test_stone_soup_on_the_same_scans(benchmark, frames):
    found, components = benchmark.pedantic(StoneSoup().run, args=(frames,), rounds=1)
    import time

    start = time.perf_counter()
    mine, own_components = ours(GaussianMixturePhd(birth=BIRTHS), frames)
    own = time.perf_counter() - start
    theirs = benchmark.stats.stats.median
    benchmark.extra_info.update(ms_per_step=theirs * 10, components=components, ospa_m=position_ospa(found), ratio=theirs / own)
    assert theirs > 10 * own
    assert 0.5 < own_components / components < 2
    assert position_ospa(mine) <= position_ospa(found) + 0.02
