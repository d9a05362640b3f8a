"""Error of directions, OSPA of directions, and errors over bounds."""

from __future__ import annotations

import dataclasses
import itertools

import direction_scans as scene
import numpy as np
import pytest

from sonobench.errors import InputError, SetupError
from sonobench.filtering.bounds import least_msae
from sonobench.geometry import angles, unit_vector
from sonobench.scoring import score
from sonobench.sphere import moved
from sonobench.types import Array, Estimate, Space, Truth
from sonobench_plugins.metric.direction_bound import DirectionBound
from sonobench_plugins.metric.direction_error import DirectionError
from sonobench_plugins.metric.direction_posterior_bound import DirectionPosteriorBound
from sonobench_plugins.metric.ospa_direction import OspaDirection
from sonobench_plugins.motion.constant_velocity import ConstantVelocity

_ANGLES = Space.of("azimuth_rad", "elevation_rad")
_PLACE = Space.of("x_m", "y_m", "z_m")
_POWERS = {"source_variance": np.sqrt(10.0), "pressure_noise_variance": 1.5, "velocity_noise_variance": 0.5, "snapshots": 8000.0}
_STATIC = float(np.sqrt(least_msae(np.sqrt(10.0), 1.5, 0.5, 8000)))


def _truth(z: Array, **parameters: float) -> Truth:
    """Targets (k, n) in directions (k, n, 2), seconds apart, 2 m from (1, 2, 3)."""
    k, n = z.shape[:2]
    origin = {"origin_x_m": 1.0, "origin_y_m": 2.0, "origin_z_m": 3.0}
    there = np.ones((k, n), bool)
    position = np.array([1.0, 2.0, 3.0]) + 2.0 * unit_vector(z)
    return Truth(np.arange(1.0, k + 1), np.arange(n), position, there, there, period_s=1.0, parameters={**origin, **parameters})


def _estimates(z: Array) -> list[Estimate]:
    return [Estimate(k + 1.0, rows) for k, rows in enumerate(z)]


def test_the_error_is_the_angle_also_across_the_back_and_at_the_pole() -> None:
    z = np.array([[[np.pi - 0.01, 0.0]], [[0.0, np.pi / 2 - 0.01]], [[1.0, 0.5]]])
    found = np.array([[[-np.pi + 0.01, 0.0]], [[np.pi, np.pi / 2 - 0.02]], [[1.0, 0.4]]])
    columns = DirectionError().evaluate(_truth(z), _estimates(found), _ANGLES)
    assert np.allclose(columns[""].values, [0.02, 0.03, 0.1])
    assert np.allclose(columns["azimuth"].values, [0.02, np.pi, 0.0])
    assert np.allclose(columns["elevation"].values, [0.0, 0.01, 0.1])
    assert np.allclose(columns["deg"].values, np.degrees([0.02, 0.03, 0.1]))
    assert np.allclose(columns["msae"].values, np.square([0.02, 0.03, 0.1]))


def test_places_and_directions_of_the_same_estimates_score_alike() -> None:
    rng = np.random.default_rng(1)
    z = rng.uniform(-1, 1, (5, 2, 2))
    off = z + 0.05 * rng.standard_normal(z.shape)
    places = np.array([1.0, 2.0, 3.0]) + 7.0 * unit_vector(off)
    one = DirectionError().evaluate(_truth(z), _estimates(off), _ANGLES)
    other = DirectionError().evaluate(_truth(z), _estimates(places), _PLACE)
    assert all(np.allclose(one[name].values, other[name].values) for name in one)
    beyond = np.stack([off[..., 0] + np.pi, np.pi - off[..., 1]], axis=-1)  # over the pole: the same directions
    assert np.allclose(DirectionError().evaluate(_truth(z), _estimates(beyond), _ANGLES)["azimuth"].values, one["azimuth"].values)


def test_targets_are_matched_by_the_least_sum_of_squared_angles() -> None:
    """Second derivation: all permutations."""
    rng = np.random.default_rng(2)
    z, found = rng.uniform(-1.4, 1.4, (6, 3, 2)), rng.uniform(-1.4, 1.4, (6, 3, 2))
    values = DirectionError().evaluate(_truth(z), _estimates(found), _ANGLES)[""].values
    cosine = np.einsum("knd,kmd->knm", unit_vector(z), unit_vector(found))
    squared = np.arccos(np.clip(cosine, -1, 1)) ** 2
    least = [min(np.mean([s[i, p[i]] for i in range(3)]) for p in itertools.permutations(range(3))) for s in squared]
    assert np.allclose(values, np.sqrt(least))


def test_a_window_counts_steps_from_one_and_a_gate_leaves_pairs_out() -> None:
    z = np.zeros((4, 1, 2))
    found = np.array([[[0.1, 0.0]], [[0.2, 0.0]], [[0.3, 0.0]], [[0.4, 0.0]]])
    rows = score(DirectionError(first_step=2, last_step=3), _truth(z), _estimates(found), _ANGLES, "d")
    assert np.allclose([r.value for r in rows if r.metric == "d" and r.weight > 0], [0.2, 0.3])
    gated = DirectionError(c_rad=0.25).evaluate(_truth(z), _estimates(found), _ANGLES)[""]
    assert gated.weights.tolist() == [1, 1, 0, 0]
    assert gated.coverage == 0.5
    with pytest.raises(InputError, match="first_step"):
        DirectionError(first_step=3, last_step=2)


def test_estimates_without_height_are_refused() -> None:
    with pytest.raises(SetupError, match="z_m"):
        DirectionError().evaluate(_truth(np.zeros((1, 1, 2))), [Estimate(1.0, np.zeros((1, 2)))], Space.of("x_m", "y_m"))


def test_ospa_of_directions_is_in_degrees_on_the_sphere() -> None:
    z = np.array([[[0.0, np.pi / 2 - 0.01], [1.0, 0.0]]])
    found = np.array([[[np.pi, np.pi / 2 - 0.01]]])
    columns = OspaDirection(p=1.0, c_deg=5.0).evaluate(_truth(z), _estimates(found), _ANGLES)
    assert columns[""].values[0] == pytest.approx((np.degrees(0.02) + 5.0) / 2)
    assert columns["cardinality"].values[0] == pytest.approx(2.5)


def test_estimates_that_scatter_as_the_bound_says_have_a_ratio_of_one() -> None:
    rng = np.random.default_rng(3)
    z = np.stack([np.linspace(-3, 3, 4000), np.linspace(-1.5, 1.5, 4000)], axis=1)[:, None]
    truth = _truth(z, **_POWERS)
    columns = DirectionBound().evaluate(truth, _estimates(moved(z, _STATIC / np.sqrt(2) * rng.standard_normal(z.shape))), _ANGLES)
    assert np.allclose(columns["bound"].values, _STATIC)
    assert np.allclose(columns["azimuth"].values * np.cos(z[:, 0, 1]), _STATIC / np.sqrt(2))
    assert np.sqrt(np.mean(columns[""].values ** 2)) == pytest.approx(1.0, abs=0.03)


def test_the_bound_knows_how_the_array_is_turned() -> None:
    """Uneven noise along the array's axes: turned by 90 degrees, what was east is now north of it."""
    uneven = {"velocity_noise_variance_x": 0.1, "velocity_noise_variance_y": 0.5, "velocity_noise_variance_z": 2.0}
    z = np.array([[[0.3, 0.2]]])
    still = DirectionBound().information(_truth(z, **{**_POWERS, **uneven}))
    turned = DirectionBound().information(_truth(z + np.array([np.pi / 2, 0.0]), **{**_POWERS, **uneven, "origin_yaw_rad": np.pi / 2}))
    assert np.allclose(still, turned)
    rolled = _truth(
        angles(unit_vector(z) @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]).T), **{**_POWERS, **uneven, "origin_roll_rad": np.pi / 2}
    )
    assert np.allclose(np.linalg.eigvalsh(DirectionBound().information(rolled)), np.linalg.eigvalsh(still))


def test_a_bound_without_the_scenes_powers_is_refused() -> None:
    with pytest.raises(SetupError, match="source_variance"):
        DirectionBound().evaluate(_truth(np.zeros((1, 1, 2))), [], _ANGLES)


def test_the_posterior_bound_starts_at_the_static_one_and_falls_below_it() -> None:
    truth = scene.truth(parameters=_POWERS)
    straight = DirectionPosteriorBound(motion=ConstantVelocity(3, velocity_walk_m_s=0.0), position_std_m=1e4, velocity_std_m_s=1e3)
    walking = dataclasses.replace(straight, motion=ConstantVelocity(3, held_acceleration_m_s2=10.0))
    bounds = [np.sqrt(np.trace(m.least(truth)[:, 0], axis1=-2, axis2=-1)) for m in (straight, walking)]
    assert bounds[0][0] == pytest.approx(_STATIC, rel=1e-3)
    assert (np.diff(bounds[0][1:]) < 0).all()
    assert bounds[0][-1] < 0.25 * _STATIC
    assert (bounds[1] >= bounds[0] * (1 - 1e-12)).all()
    assert bounds[1][-1] < 0.85 * _STATIC


def test_targets_that_come_later_are_bounded_from_when_they_come() -> None:
    truth = scene.truth(20, _POWERS)
    there = np.arange(20)[:, None] >= 5
    late = dataclasses.replace(truth, exists=there, active=there)
    least = DirectionPosteriorBound(motion=ConstantVelocity(3), position_std_m=1e4, velocity_std_m_s=1e3).least(late)
    assert (least[:5] == 0).all()
    assert np.sqrt(np.trace(least[5, 0])) == pytest.approx(_STATIC, rel=1e-3)
