"""The other filters on rows of directions with their own R: overhead, where azimuth says nothing."""

from __future__ import annotations

import dataclasses
from typing import Any

import direction_scans as scene
import numpy as np
import pytest

from sonobench.directions import separations
from sonobench.geometry import angles
from sonobench_plugins.birth.given import Given
from sonobench_plugins.measurement.direction import Direction
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.tracker.gm_phd import GaussianMixturePhd
from sonobench_plugins.tracker.lmb import LabelledMultiBernoulli
from sonobench_plugins.tracker.smc_phd import ParticlePhd

_COMMON: dict[str, Any] = {
    "motion": ConstantVelocity(3, held_acceleration_m_s2=0.3),
    "measurement": Direction(p_d=0.98, clutter_per_scan=0.1),
    "birth": Given("starts", once=1, weight=1.0, position_std_m=2.0, velocity_std_m_s=0.5),
}
_TRACKERS = {
    "gm-phd": GaussianMixturePhd(**_COMMON),
    "lmb": LabelledMultiBernoulli(**_COMMON),
    "smc-phd": ParticlePhd(**_COMMON, particles=600, cluster_m=30.0),
    "smc-phd jointly": ParticlePhd(**_COMMON, particles=600, cluster_m=30.0, update="joint"),
}


@pytest.mark.parametrize("name", _TRACKERS)
def test_a_target_that_passes_overhead_is_kept(name: str) -> None:
    velocity = np.array([10.0, 0.1, 0.0])
    points = np.array([-100.0, 1.0, 300.0]) + np.arange(1.0, 21.0)[:, None] * velocity
    start = np.concatenate([[0.0], points[0] - velocity, velocity])[None]
    setup = dataclasses.replace(scene.setup(), given={"starts": start})
    rng, tracker = np.random.default_rng(1), _TRACKERS[name]
    state = tracker.init(rng, setup)
    for point, scan in zip(points, scene.scans(np.random.default_rng(4), points, 0.005), strict=True):
        state, estimate = tracker.step(rng, state, scan)
        assert len(estimate.states) == 1
        assert separations(np.asarray(angles(estimate.states[0, ::2])), np.asarray(angles(point))) < 0.015
