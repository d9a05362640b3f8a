"""The random walk: where it begins, that it stays inside, how fast and how smoothly it goes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sonobench_plugins.trajectory.wander import Wander


def walk(seed=0, heading_deg=90.0, speed_m_s=0.98, **other):
    return Wander(seed, [0.6, 1.5, 1.4], heading_deg, speed_m_s, low_m=[0.3, 0.3], high_m=[2.7, 2.7], **other)


def test_it_starts_at_the_start_along_the_heading():
    where = walk(heading_deg=60.0).position(np.array([0.0, 1e-6]))
    np.testing.assert_allclose(where[0], [0.6, 1.5, 1.4], atol=1e-12)
    np.testing.assert_allclose((where[1] - where[0]) / 1e-6, [0.49, 0.98 * np.sin(np.pi / 3), 0], atol=1e-5)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.25, 2.0), st.sampled_from([(0.3, 20.0), (0.6, 45.0), (0.4, 80.0)]))
def test_it_never_leaves_its_box_and_keeps_its_speed(seed, speed_m_s, leg):
    time_s = np.arange(0, 20 / speed_m_s, 0.01 / speed_m_s)
    one = walk(seed, speed_m_s=speed_m_s, leg_m=leg[0], turn_deg=leg[1], until_s=200.0)
    where = one.position(time_s)
    assert where[:, :2].min() >= 0.3 - 1e-9
    assert where[:, :2].max() <= 2.7 + 1e-9
    velocity = (one.position(time_s + 1e-5) - one.position(np.maximum(time_s - 1e-5, 0)))[1:] / 2e-5
    np.testing.assert_allclose(np.linalg.norm(velocity, axis=1), one.speed_m_s, rtol=1e-4)


def test_its_velocity_has_no_jumps():
    time_s = np.linspace(0, 30, 30_001)
    velocity = np.diff(walk(3).position(time_s), axis=0) / np.diff(time_s)[:, None]
    assert np.linalg.norm(np.diff(velocity, axis=0), axis=1).max() < 0.01  # a jump would be as large in steps of any length


def test_a_position_depends_on_its_time_alone_and_on_the_seed():
    time_s = np.array([0.0, 3.2, 0.7, 59.0])
    time_s.flags.writeable = False
    where = walk(5).position(time_s)
    np.testing.assert_array_equal(where, np.concatenate([walk(5).position(time_s[i : i + 1]) for i in range(4)]))
    assert np.linalg.norm(walk(6).position(time_s)[1] - where[1]) > 0.01


def test_seeds_spread_the_walks_over_the_box():
    ends = np.array([walk(seed, leg_m=0.4, turn_deg=60.0).position(np.array([15.0]))[0, :2] for seed in range(60)])
    assert (ends.std(axis=0) > 0.4).all()


def test_it_holds_still_after_its_end():
    where = walk(until_s=2.0).position(np.array([2.0, 5.0, 1e6]))
    np.testing.assert_array_equal(where, np.repeat(where[:1], 3, axis=0))


@pytest.mark.parametrize(
    ("other", "says"),
    [
        ({"heading_deg": 180.0}, "cannot stay within"),
        ({"leg_m": 3.0}, "shorten leg_m"),
        ({"turn_deg": 90.0}, "turn_deg is 90.0"),
        ({"speed_m_s": 0.0}, "speed_m_s is 0.0"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_impossible_walks_are_refused(other, says):
    with pytest.raises(ValueError, match=says):
        walk(**other)
