"""Langevin and random walks: the box, the speed, the law, the seed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sonobench.scene.walks import mirrored
from sonobench_plugins.trajectory.langevin_walk import LangevinWalk
from sonobench_plugins.trajectory.random_walk import RandomWalk

START = [0.6, 1.5, 1.4]
BOX = {"low_m": [0.3, 0.3], "high_m": [2.7, 2.2]}
HALL = {"low_m": [-1e4, -1e4], "high_m": [1e4, 1e4]}  # no wall in reach
KINDS = [LangevinWalk, RandomWalk]


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.05, 5.0))
def test_it_starts_at_the_start_and_never_leaves_its_box(kind, seed, size):
    walk = kind(seed, START, **BOX, **({"v_rms_m_s": size} if kind is LangevinWalk else {"spread_m": size}))
    where = walk.position(np.linspace(0, 70, 1500))
    np.testing.assert_allclose(where[0], START, atol=1e-12)
    assert (where[:, :2] >= np.array(BOX["low_m"]) - 1e-12).all()
    assert (where[:, :2] <= np.array(BOX["high_m"]) + 1e-12).all()
    assert (where[:, 2] == 1.4).all()
    assert (where[-200:] == where[-1]).all()  # still after a minute


@pytest.mark.parametrize("kind", KINDS)
def test_a_position_depends_on_its_time_alone_and_on_the_seed(kind):
    time_s = np.array([0.0, 3.2, 0.7, 59.0, 1e6])
    time_s.flags.writeable = False
    where = kind(5, START, **BOX).position(time_s)
    np.testing.assert_array_equal(where, np.concatenate([kind(5, START, **BOX).position(time_s[i : i + 1]) for i in range(5)]))
    assert np.linalg.norm(kind(6, START, **BOX).position(time_s)[1] - where[1]) > 0.01
    longer = kind(5, START, **BOX, until_s=120.0)
    np.testing.assert_array_equal(longer.position(time_s[:4]), where[:4])


def test_the_langevin_velocity_has_its_root_mean_square_and_forgets_at_its_rate():
    walk = LangevinWalk(1, START, **HALL, rate_hz=10.0, v_rms_m_s=0.7, until_s=2000.0)
    time_s = np.arange(0, 2000, 0.01)
    velocity = np.diff(walk.position(time_s)[:, :2], axis=0) / 0.01
    assert np.sqrt(np.mean(velocity**2, axis=0)) == pytest.approx([0.7 * np.sqrt((1 + np.exp(-0.1)) / 2)] * 2, rel=0.03)
    correlation = [np.mean(velocity[k:] * velocity[: len(velocity) - k]) for k in (5, 15)]
    assert correlation[1] / correlation[0] == pytest.approx(np.exp(-10 * 0.1), rel=0.15)


def test_the_langevin_walk_spreads_as_the_law_of_its_process_says():
    """Var x(t) = 2 v² (beta t − 1 + exp(−beta t)) / beta² of a stationary Ornstein-Uhlenbeck velocity."""
    ends = np.array([LangevinWalk(s, START, **HALL, rate_hz=4.0).position(np.array([0.2, 1.5]))[:, :2] for s in range(800)])
    bt = 4.0 * np.array([0.2, 1.5])
    exact = 2 * (bt - 1 + np.exp(-bt)) / 16
    np.testing.assert_allclose(np.var(ends - np.array(START[:2]), axis=0).mean(axis=1), exact, rtol=4 * np.sqrt(2 / 1600))


def test_the_langevin_walk_has_no_jumps_in_velocity_away_from_walls():
    time_s = np.arange(0, 5, 1e-4)
    velocity = np.diff(LangevinWalk(3, START, **HALL).position(time_s), axis=0) / 1e-4
    assert np.linalg.norm(np.diff(velocity, axis=0), axis=1).max() < 0.05  # a hundredth of a 10 ms change at most, per .1 ms


def test_the_random_walk_spreads_with_the_root_of_time_whatever_its_step():
    for step_s in (0.1, 0.5):
        ends = np.array([RandomWalk(s, START, **HALL, spread_m=0.3, step_s=step_s).position(np.array([4.0]))[0, :2] for s in range(1000)])
        np.testing.assert_allclose((ends - START[:2]).std(), 0.6, rtol=4 / np.sqrt(4000))


def test_the_random_walk_keeps_its_speed_within_a_stride():
    where = RandomWalk(2, START, **HALL, step_s=0.5).position(np.arange(0, 10.01, 0.125))
    strides = np.diff(where, axis=0).reshape(20, 4, 3)
    np.testing.assert_allclose(strides, np.broadcast_to(strides[:, :1], strides.shape), atol=1e-9)


@settings(max_examples=50, deadline=None)
@given(st.floats(-50, 50), st.floats(0.1, 9.0))
def test_mirrors_are_those_of_a_billiard_table(x, width):
    low, high = np.array([1.0, 0.0]), np.array([1.0 + width, 1.0])
    at = x
    while not 1.0 <= at <= 1.0 + width:
        at = 2.0 - at if at < 1.0 else 2 * (1.0 + width) - at
    assert mirrored(np.array([x, 0.5]), low, high)[0] == pytest.approx(at, abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"start_m": [0.1, 1.0, 1.0]}, "must lie within the box"),
        ({"high_m": [0.2, 0.2]}, "must lie within the box"),
        ({"seed": -1}, "0 or more"),
        ({"step_s": 0.0}, "step_s is 0.0"),
    ],
)
def test_impossible_parameters_are_refused(kind, change, words):
    with pytest.raises(ValueError, match=words):
        kind(**{"seed": 1, "start_m": START, **BOX, **change})
