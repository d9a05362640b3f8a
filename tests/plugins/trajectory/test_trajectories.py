"""Walks: where they start, how fast they go, where they end."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sonobench_plugins.trajectory.arc import Arc
from sonobench_plugins.trajectory.line import Line
from sonobench_plugins.trajectory.still import Still
from sonobench_plugins.trajectory.waypoints import Waypoints

WALKS = [
    Still([1.0, 2.0, 1.5]),
    Line([1.0, 1.0, 1.0], [3.0, 1.0, 1.0], 0.5),
    Arc([1.5, 1.5, 1.5], 1.0, 180.0, 0.98, clockwise=True),
    Waypoints([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0]], 0.5, pauses_s=[1.0, 2.0, 0.0]),
    Waypoints([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]], times_s=[0.5, 1.5]),
]


@pytest.mark.parametrize("walk", WALKS, ids=lambda w: type(w).__name__)
def test_a_walk_is_vectorised_and_holds_still_after_its_end(walk):
    time = np.array([0.0, 0.7, 1e6, 2e6])
    time.flags.writeable = False
    where = walk.position(time)
    assert where.shape == (4, 3)
    np.testing.assert_array_equal(where[2], where[3])
    np.testing.assert_array_equal(where, np.concatenate([walk.position(time[i : i + 1]) for i in range(4)]))


@given(st.sampled_from(WALKS[1:4]), st.floats(0, 20))
def test_nobody_walks_faster_than_the_stated_speed(walk, start_s):
    time = start_s + np.arange(0, 1, 0.01)
    step = np.linalg.norm(np.diff(walk.position(time), axis=0), axis=1)
    assert step.max() <= walk.speed_m_s * 0.01 * (1 + 1e-9)


def test_a_line_arrives_when_its_length_over_its_speed_has_passed():
    np.testing.assert_allclose(WALKS[1].position(np.array([0.0, 2.0, 4.0, 5.0]))[:, 0], [1, 2, 3, 3])


def test_a_clockwise_arc_from_the_west_goes_north_first_and_ends_in_the_east():
    where = WALKS[2].position(np.array([0.0, np.pi / 2 / 0.98, np.pi / 0.98, 9.0]))
    np.testing.assert_allclose(where, [[0.5, 1.5, 1.5], [1.5, 2.5, 1.5], [2.5, 1.5, 1.5], [2.5, 1.5, 1.5]], atol=1e-12)
    np.testing.assert_allclose(Arc([0.0, 0, 0], 2.0, 0.0, 1.0, sweep_deg=90.0).position(np.array([99.0])), [[0, 2, 0]], atol=1e-12)


def test_waypoints_stop_for_their_pauses():
    where = WALKS[3].position(np.array([0.9, 2.0, 3.0, 4.5, 5.5, 6.0, 7.0]))
    np.testing.assert_allclose(where[:, :2], [[0, 0], [0.5, 0], [1, 0], [1, 0], [1, 0.25], [1, 0.5], [1, 1]], atol=1e-12)


def test_waypoints_by_times_are_there_on_time():
    np.testing.assert_allclose(WALKS[4].position(np.array([0.0, 0.5, 1.0, 1.5, 9.0]))[:, 0], [0, 0, 0.5, 1, 1])


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Still([1.0, 2.0]), "position_m has shape"),
        (lambda: Line([0.0, 0, 0], [1.0, 0, 0], 0.0), "speed_m_s is 0.0; a positive speed"),
        (lambda: Line([0.0, 0, 0], [0.0, 0, 0], 1.0), "use 'still'"),
        (lambda: Arc([0.0, 0, 0], -1.0, 0.0, 1.0), "radius_m is -1.0"),
        (lambda: Waypoints([[0.0, 0, 0]], 1.0), "two or more are needed"),
        (lambda: Waypoints([[0.0, 0, 0], [1.0, 0, 0]]), "either speed_m_s or times_s"),
        (lambda: Waypoints([[0.0, 0, 0], [1.0, 0, 0]], 1.0, times_s=[0.0, 1.0]), "either speed_m_s or times_s"),
        (lambda: Waypoints([[0.0, 0, 0], [1.0, 0, 0]], times_s=[1.0, 1.0]), "2 increasing times"),
        (lambda: Waypoints([[0.0, 0, 0], [1.0, 0, 0]], 1.0, pauses_s=[1.0]), "2 stops"),
        (lambda: Waypoints([[0.0, 0, 0], [1.0, 0, 0]], -1.0), "a positive speed"),
    ],
)
def test_impossible_walks_are_refused(make, says):
    with pytest.raises(ValueError, match=says):
        make()
