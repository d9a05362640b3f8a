"""The SMC-PHD filter of Stone Soup on our scans of positions, with our models' numbers: the peer of ours.

The same bootstrap recursion: births appended in the prediction ("expansion"), the weights of Vo, Singh & Doucet 2005, systematic resampling to as many
particles as ours draws, targets the rows whose share of the weights is above a half. What its `update` does (weights, resampling) is called piece by
piece, so that the likelihoods, which extraction needs too, are worked out once. It draws from NumPy's global state, which `run` seeds and puts back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from scipy.special import logsumexp
from stonesoup.hypothesiser.simple import SimpleHypothesiser
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.particle import SMCPHDPredictor
from stonesoup.resampler.particle import SystematicResampler
from stonesoup.sampler.particle import ParticleSampler
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.state import ParticleState
from stonesoup.types.track import Track
from stonesoup.types.update import Update
from stonesoup.updater.particle import SMCPHDUpdater

from sonobench.protocols import Mixture
from sonobench.types import Array, Estimate, Scan

EPOCH = datetime(2026, 1, 1)


@dataclass(frozen=True)
class Numbers:
    """What both filters share."""

    walk: float
    position_std_m: float
    p_s: float
    p_d: float
    clutter_density: float
    particles: int
    most_particles: int
    born_particles: int


def run(numbers: Numbers, births: Mixture, scans: Sequence[Scan], seed: int) -> list[Estimate]:
    """Prediction, births, update, extraction, resampling, scan by scan."""
    state = np.random.get_state()  # noqa: NPY002
    np.random.seed(seed)  # noqa: NPY002  (its resampler knows no other)
    try:
        return _run(numbers, births, scans, np.random.default_rng(seed))
    finally:
        np.random.set_state(state)  # noqa: NPY002


def _run(numbers: Numbers, births: Mixture, scans: Sequence[Scan], rng: np.random.Generator) -> list[Estimate]:
    born = numbers.born_particles * len(births.w)
    roots = np.linalg.cholesky(births.P)

    def sampled(num_samples: int) -> Array:
        noise = rng.standard_normal((len(births.w), num_samples // len(births.w), 4)) @ np.swapaxes(roots, 1, 2)
        return (births.m[:, None] + noise).reshape(-1, 4).T

    walk = ConstantVelocity(numbers.walk**2)
    predictor = SMCPHDPredictor(
        transition_model=CombinedLinearGaussianTransitionModel([walk, walk]),
        death_probability=-np.log(numbers.p_s),
        birth_probability=0.1,
        birth_rate=float(births.w.sum()),
        birth_sampler=ParticleSampler(sampled, {}, 4),
    )
    model = LinearGaussian(4, (0, 2), np.eye(2) * numbers.position_std_m**2)
    resampler = SystematicResampler()
    updater = SMCPHDUpdater(
        measurement_model=model, prob_detect=numbers.p_d, clutter_intensity=numbers.clutter_density, resampler=resampler
    )
    hypothesiser = SimpleHypothesiser(predictor, updater)
    few = np.full(numbers.particles, -np.log(numbers.particles) - 100.0)  # nobody: it cannot start without particles
    cloud = ParticleState(StateVectors(np.tile(births.m[0][:, None], numbers.particles)), log_weight=few, timestamp=EPOCH)
    out = []
    for scan in scans:
        now = EPOCH + timedelta(seconds=scan.time_s)
        predictor.birth_probability = born / len(cloud)
        rows = [z for group in scan.detections for z in group.z]
        # a list, not the set of its examples, whose order differs from run to run
        hypotheses = hypothesiser.hypothesise(Track([cloud]), [Detection(StateVector(z), now, measurement_model=model) for z in rows], now)
        log_shares = updater.get_log_weights_per_hypothesis(hypotheses)
        log_w = logsumexp(log_shares, axis=1)
        x, shares = np.asarray(hypotheses[0].prediction.state_vector, float), np.exp(log_shares[:, 1:])
        found = [x @ share / share.sum() for share in shares.T if share.sum() > 0.5]
        total = logsumexp(log_w)
        out.append(Estimate(scan.time_s, np.reshape(found, (-1, 4)), count=float(np.exp(total))))
        updated = Update.from_state(hypotheses[0].prediction, hypothesis=hypotheses, timestamp=now)
        updated.log_weight = log_w - total
        wanted = min(max(round(numbers.particles * float(np.exp(total))), numbers.particles), numbers.most_particles)
        cloud = resampler.resample(updated, wanted)
        cloud.log_weight = cloud.log_weight + total
    return out
