"""Directions that move at constant rates, turn and accelerate."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sonobench.components import build, to_table
from sonobench.errors import TableError
from sonobench.geometry import angles
from sonobench.registry import Registry
from sonobench_plugins.trajectory.bearing import Bearing, Segment

MOTION = Bearing(
    range_m=50.0,
    azimuth_deg=350.0,
    elevation_deg=20.0,
    azimuth_deg_s=1.0,
    elevation_deg_s=0.4,
    segments=(Segment(17.0, turn_deg_s=-2.0), Segment(34.0, azimuth_deg_s2=0.03, elevation_deg_s2=-0.02), Segment(45.0)),
    origin_m=np.array([1.0, -2.0, 3.0]),
)


def test_the_motion_is_the_integral_of_its_equations():
    def model(time, state):
        rate = state[2:]
        if 17 <= time < 34:
            change = np.deg2rad(-2.0) * np.array([-rate[1], rate[0]])
        else:
            change = np.array([0.03, -0.02]) * (34 <= time < 45)
        return np.concatenate([rate, change])

    at, state = np.linspace(0, 50, 101), np.array([350.0, 20.0, 1.0, 0.4])
    wanted = []
    for low, high in [(0, 17), (17, 34), (34, 45), (45, 50.5)]:  # the model jumps at the edges
        here = at[(at >= low) & (at < high)]
        made = solve_ivp(model, (low, high - 1e-12), state, t_eval=[*here, high - 1e-12], rtol=1e-10, atol=1e-10)
        wanted.append(made.y[:2, :-1].T)
        state = made.y[:, -1]
    np.testing.assert_allclose(MOTION.angles_deg(at), np.concatenate(wanted), atol=1e-6)


def test_the_range_stays_and_the_angles_are_those_from_the_origin():
    at = np.linspace(0, 50, 21)
    away = MOTION.position(at) - MOTION.origin_m
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 50.0, rtol=1e-12)
    wrapped = (MOTION.angles_deg(at) + 180) % 360 - 180
    np.testing.assert_allclose(np.rad2deg(angles(away)), wrapped, atol=1e-9)


def test_a_turn_keeps_the_speed_and_turns_azimuth_towards_elevation():
    turning = Bearing(10.0, 0.0, 0.0, 1.0, 0.0, (Segment(1.0, turn_deg_s=90.0),))
    rates = np.diff(turning.angles_deg(np.array([1.9995, 2.0005])), axis=0)[0] / 1e-3
    np.testing.assert_allclose(rates, [0.0, 1.0], atol=1e-6)


def test_a_segment_from_the_start_on_leaves_no_constant_rates():
    turning = Bearing(10.0, 0.0, 0.0, 1.0, 0.0, (Segment(0.0, turn_deg_s=90.0),))
    np.testing.assert_allclose(turning.angles_deg(np.array([0.0, 2.0])), [[0, 0], [0, 4 / np.pi]], atol=1e-12)


def test_it_holds_still_after_its_end():
    stopped = Bearing(10.0, 0.0, 0.0, 1.0, until_s=3.0)
    np.testing.assert_allclose(stopped.angles_deg(np.array([2.0, 3.0, 7.0]))[:, 0], [2, 3, 3])


def test_tables_make_segments_and_say_what_is_wrong():
    registry = Registry.load([])
    table = {"use": "bearing", "range_m": 5.0, "azimuth_deg": 1.0, "elevation_deg": 2.0, "segments": [{"from_s": 3.0, "turn_deg_s": 2.0}]}
    made = build("trajectory", table, registry)
    assert made.segments == (Segment(3.0, 2.0),)
    again = build("trajectory", to_table(made, registry, "trajectory"), registry)
    np.testing.assert_array_equal(again.position(np.arange(9.0)), made.position(np.arange(9.0)))
    for change, message in (
        ({"range_m": 0.0}, "range_m is 0.0"),
        ({"segments": [{"from_s": -1.0}]}, "from_s of at least 0"),
        ({"segments": [{"from_s": 1.0, "turn_deg_s": 1.0, "azimuth_deg_s2": 1.0}]}, "turns and accelerates"),
        ({"segments": [{"from_s": 2.0}, {"from_s": 1.0}]}, "increasing times"),
    ):
        with pytest.raises(TableError, match=message):
            build("trajectory", {**table, **change}, registry)
