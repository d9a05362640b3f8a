"""Births at measured positions."""

import numpy as np
import pytest
from phd_linear import scan, setup

from sonobench.errors import SetupError
from sonobench.protocols import Mixture
from sonobench.types import Space
from sonobench_plugins.birth.from_positions import FromPositions
from sonobench_plugins.measurement.position import Position
from sonobench_plugins.motion.constant_velocity import ConstantVelocity

SPACE = ConstantVelocity().space
MODEL = Position(position_std_m=0.5, p_d=0.9, clutter_per_scan=1.0)
NOBODY = Mixture(np.zeros(0), np.zeros((0, 4)), np.zeros((0, 4, 4)), np.zeros(0, np.int64))


def proposed(frame, live=NOBODY, sensors=1, **values):
    birth = FromPositions(**values)
    memory = birth.start(SPACE, setup(sensors), MODEL.bind(SPACE, setup(sensors)))
    return birth.propose(np.random.default_rng(0), memory, frame, live)[1]


def test_every_row_bears_a_component_as_uncertain_as_it_is_and_all_share_the_weight():
    born = proposed(scan(0.0, [[1, 2], [5, 6]]), weight=0.1, velocity_std_m_s=2.0)
    np.testing.assert_allclose(born.w, [0.05, 0.05])
    np.testing.assert_allclose(born.m, [[1, 0, 2, 0], [5, 0, 6, 0]])
    np.testing.assert_allclose(born.P, np.broadcast_to(np.diag([0.25, 4, 0.25, 4]), (2, 4, 4)))
    R = np.array([[[0.5, 0.2], [0.2, 0.3]]])
    np.testing.assert_allclose(proposed(scan(0.0, [[1, 2]], R=R)).P[0][np.ix_([0, 2], [0, 2])], R[0])


def test_what_a_live_target_explains_bears_nothing():
    live = Mixture(
        np.array([0.9, 0.2]), np.array([[1, 0, 2, 0], [5, 0, 6, 0.0]]), np.tile(0.01 * np.eye(4), (2, 1, 1)), np.zeros(2, np.int64)
    )
    born = proposed(scan(0.0, [[1.4, 2.2], [5, 6], [1, 9]]), live)
    np.testing.assert_allclose(born.m[:, [0, 2]], [[5, 6], [1, 9]])


def test_rows_that_miss_a_component_or_were_not_searched_bear_nothing():
    assert len(proposed(scan(0.0, [[1, 2]], valid=[[True, False]])).w) == 0
    assert len(proposed(scan(0.0, [[1, 2]], searched=[False])).w) == 0
    assert len(proposed(scan(0.0, [])).w) == 0


def test_sensors_that_do_not_place_a_target_are_refused():
    space = Space.of("x_m", "vx_m_s", "y_m", "vy_m_s", "z_m", "vz_m_s")
    with pytest.raises(SetupError, match="s0 is 'position' and measures"):
        FromPositions().start(space, setup(), MODEL.bind(space, setup()))
