"""Births into a state that has a turn rate beside positions and velocities."""

import numpy as np
import phd_scenes as scenes

from sonobench.filtering.kinematics import TURN_STD_RAD_S
from sonobench_plugins.birth.from_detections import FromDetections
from sonobench_plugins.birth.given import Given
from sonobench_plugins.measurement.tdoa import Tdoa
from sonobench_plugins.motion.coordinated_turn import CoordinatedTurn

SPACE = CoordinatedTurn().space


def test_given_states_may_leave_the_turn_rate_out():
    where = scenes.setup(given={"births": scenes.BIRTHS})
    born = Given(position_std_m=0.2, velocity_std_m_s=0.5).start(SPACE, where, Tdoa().bind(SPACE, where))
    _, born = Given(position_std_m=0.2, velocity_std_m_s=0.5).propose(np.random.default_rng(0), born, None, None)
    np.testing.assert_array_equal(born.m[:, :4], scenes.BIRTHS)
    np.testing.assert_array_equal(born.m[:, 4], 0)
    np.testing.assert_allclose(born.P[0], np.diag([0.04, 0.25, 0.04, 0.25, TURN_STD_RAD_S**2]))


def test_from_detections_spreads_the_turn_rate():
    where = scenes.setup()
    grid = FromDetections().start(SPACE, where, Tdoa().bind(SPACE, where))
    np.testing.assert_allclose(grid.spread, [0, 0.25, 0, 0.25, TURN_STD_RAD_S**2])
