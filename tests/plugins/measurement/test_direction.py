"""Directions as a measurement: wrapping, poles, turned arrays, states that are directions."""

from __future__ import annotations

import numpy as np
import pytest

from sonobench.errors import InputError, SetupError
from sonobench.geometry import angles, unit_vector
from sonobench.sphere import moved
from sonobench.types import Array, Sensor, Setup, Space
from sonobench_plugins.measurement.direction import BoundDirection, Direction
from sonobench_plugins.transform.cubature import Cubature
from sonobench_plugins.transform.linearised import Linearised
from sonobench_plugins.transform.unscented import Unscented

_PLACE = Space.of("x_m", "vx_m_s", "y_m", "vy_m_s", "z_m", "vz_m_s")
_BEARING = Space.of("azimuth_rad", "azimuth_rad_s", "elevation_rad", "elevation_rad_s")


_AT = np.array([0.1, 0.2, 0.3])


def _setup(pose: Array | None = None, at: Array = _AT, **nominal: float) -> Setup:
    sensor = Sensor("avs-0", "avs", "direction", at[None], Space.of("azimuth_rad", "elevation_rad"))
    return Setup((sensor,), ("avs",), (np.eye(4) if pose is None else pose)[None], nominal=nominal)


def _turned() -> Array:
    pose = np.eye(4)
    pose[:3, :3] = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    pose[:3, :3] *= np.linalg.det(pose[:3, :3])
    pose[:3, 3] = [1.0, 2.0, 3.0]
    return pose


def _bound(space: Space = _PLACE, pose: Array | None = None, at: Array = _AT) -> BoundDirection:
    return Direction(direction_std_rad=0.1).bind(space, _setup(pose, at))


def _state(position: Array) -> Array:
    x = np.zeros((*position.shape[:-1], 6))
    x[..., ::2] = position
    return x


def test_a_turned_array_reads_directions_along_its_own_axes() -> None:
    pose = _turned()
    origin = pose[:3, :3] @ [0.1, 0.2, 0.3] + pose[:3, 3]
    z = np.array([0.7, -0.4])
    x = _state(origin + 5.0 * pose[:3, :3] @ unit_vector(z))
    assert np.allclose(_bound(pose=pose).h(x, 0)[0], z)
    assert np.allclose(_bound().h(x, 0, pose)[0], z)  # an array that moves says so in the scan


@pytest.mark.parametrize("space", [_PLACE, _BEARING], ids=["place", "bearing"])
def test_the_jacobian_is_the_slope_of_the_residual_also_near_and_beyond_a_pole(space: Space) -> None:
    model = _bound(space, _turned())
    x = 0.5 * np.random.default_rng(2).standard_normal((8, len(space)))
    if space is _BEARING:
        x[:3, 2] = [np.pi / 2 - 1e-3, np.pi / 2 + 1e-3, 2.0]
    H = model.jacobian(x, 0)[:, 0]
    for j in range(len(space)):
        step = 1e-6 * np.eye(len(space))[j]
        slope = (model.residual(model.h(x + step, 0), model.h(x, 0), 0) - model.residual(model.h(x - step, 0), model.h(x, 0), 0))[:, 0]
        assert np.allclose(H[..., j], slope / 2e-6, rtol=1e-5, atol=1e-7)


def test_a_bearing_beyond_the_zenith_is_seen_on_the_other_side() -> None:
    z = _bound(_BEARING).h(np.array([0.5, 0.0, np.pi / 2 + 0.1, 0.0]), 0)[0]
    assert np.allclose(z, [0.5 - np.pi, np.pi / 2 - 0.1])


@pytest.mark.parametrize("transform", [Linearised(), Unscented(kappa=0.5), Cubature()], ids=["ekf", "ukf", "ckf"])
def test_moments_do_not_know_where_the_pole_is(transform: object) -> None:
    """The gain and the mean of a Gaussian that surrounds an array's zenith are those of one who has it on its horizon."""
    up = np.eye(4)
    up[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]  # the array's z axis lies along the room's x
    m, P = _state(np.array([10.0, 0.3, 0.4])), np.diag([0.5, 1.0, 1.0, 1.0, 0.7, 1.0])
    seen = moved(np.array([0.0, 0.0]), np.array([0.05, 0.06]))
    corrections = []
    for pose, row in ((np.eye(4), seen), (up, angles(up[:3, :3].T @ unit_vector(seen)))):
        model = _bound(pose=pose, at=np.zeros(3))
        z_hat, S, cross = transform.measure(m, P, model, 0)  # type: ignore[attr-defined]
        corrections.append(cross @ np.linalg.solve(S + model.R(0), model.residual(row, z_hat, 0)))
    assert np.allclose(*corrections, atol=1e-9)
    assert np.abs(corrections[0]).max() > 0.1


def test_what_rows_state_of_azimuth_grows_with_the_elevation_but_means_the_same_arc() -> None:
    z = np.array([[0.3, 0.0], [0.3, 1.4]])
    R = np.array([np.diag([0.01, 0.01]), np.diag([0.01 / np.cos(1.4) ** 2, 0.01])])
    assert np.allclose(_bound().noise(R, z, z, 0), 0.01 * np.eye(2))


def test_clutter_is_per_steradian_and_nothing_is_missed_unless_said() -> None:
    model = Direction(clutter_per_scan=3.0).bind(_PLACE, _setup())
    assert np.allclose(np.exp(model.log_clutter(np.zeros((2, 2)), 0)) * 4 * np.pi, 3.0)
    assert model.p_d(np.zeros(6), 0) == 1.0
    with pytest.raises(InputError, match="both are needed"):
        model.log_clutter(np.zeros((1, 2)), 0, np.array([True, False]))


def test_a_deviation_is_asked_for_where_rows_state_none() -> None:
    assert np.allclose(Direction().bind(_PLACE, _setup(direction_std_rad=0.2)).R(0), 0.04 * np.eye(2))
    with pytest.raises(InputError, match="set direction_std_rad"):
        Direction().bind(_PLACE, _setup()).R(0)


def test_states_without_place_or_direction_are_refused() -> None:
    with pytest.raises(SetupError, match="x_m and y_m"):
        Direction().bind(Space.of("speed_m_s"), _setup())
