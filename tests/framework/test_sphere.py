"""Differences, means and covariances of directions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sonobench.filtering.points import weighted_moments
from sonobench.geometry import unit_vector
from sonobench.sphere import apart, carried, in_angles, in_arc, moved, rotated, tangents
from sonobench.types import Array

_AZIMUTH = st.floats(-np.pi, np.pi)
_ELEVATION = st.floats(-np.pi / 2, np.pi / 2)
_DIRECTION = st.tuples(_AZIMUTH, _ELEVATION).map(np.array)


def _shortest_turn(a: Array, b: Array) -> Array:
    """The rotation that takes a to b about their common normal (Rodrigues)."""
    v, c = np.cross(a, b), a @ b
    K = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.asarray(np.eye(3) + K + K @ K / (1 + c))


@settings(max_examples=100, deadline=None)
@given(_DIRECTION, _DIRECTION)
def test_a_step_leads_to_where_it_came_from_and_is_as_long_as_the_angle(z: Array, at: Array) -> None:
    step = apart(z, at)
    assert np.allclose(unit_vector(moved(at, step)), unit_vector(z), atol=1e-9)
    assert np.hypot(*step) == pytest.approx(
        np.arctan2(np.linalg.norm(np.cross(*unit_vector(np.stack([z, at])))), unit_vector(z) @ unit_vector(at)), abs=1e-9
    )


def test_near_the_horizon_a_step_is_the_difference_of_the_angles_and_azimuth_wraps() -> None:
    at, z = np.array([np.pi - 1e-4, 1e-4]), np.array([-np.pi + 1e-4, 3e-4])
    assert np.allclose(apart(z, at), [2e-4, 2e-4], rtol=1e-6)


def test_across_a_pole_a_step_is_short_and_between_antipodes_it_is_half_a_turn() -> None:
    step = apart(np.array([np.pi, np.pi / 2 - 0.01]), np.array([0.0, np.pi / 2 - 0.01]))
    assert np.allclose(step, [0.0, 0.02], atol=1e-12)
    assert np.allclose(np.hypot(*apart(np.array([0.0, 0.0]), np.array([-np.pi, 0.0]))), np.pi)


def test_covariances_turn_with_the_shortest_rotation() -> None:
    rng = np.random.default_rng(3)
    z, at = (np.stack([rng.uniform(-3, 3, 20), np.arcsin(rng.uniform(-0.999, 0.999, 20))], axis=1) for _ in range(2))
    R = np.array([[2.0, 0.5], [0.5, 1.0]])
    for one, other in zip(z, at, strict=True):
        T = tangents(other) @ _shortest_turn(unit_vector(one), unit_vector(other)) @ tangents(one).T
        assert np.allclose(carried(R, one, other), T @ in_arc(R, one) @ T.T, rtol=1e-9)


def test_what_angles_scatter_is_what_the_carried_covariance_says() -> None:
    """Monte Carlo, 4 degrees off the zenith: the angles' covariance there, carried, is that of the steps."""
    rng = np.random.default_rng(5)
    z0, at = np.array([2.0, np.radians(86.0)]), np.array([1.0, np.radians(87.0)])
    arc = 1e-3**2 * np.array([[1.0, 0.4], [0.4, 2.0]])
    z = z0 + rng.multivariate_normal(np.zeros(2), in_angles(arc, z0), 40000)
    assert np.allclose(np.cov(apart(z, at).T), carried(in_angles(arc, z0), z0, at), rtol=0.03, atol=0.03e-6)


@settings(max_examples=30, deadline=None)
@given(_DIRECTION, st.integers(0, 1000))
def test_a_rotation_forth_and_back_changes_nothing(z: Array, seed: int) -> None:
    turn = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
    turn = turn * np.linalg.det(turn)
    z = np.clip(z, -1.5, 1.5)
    there, R = rotated(z, np.diag([2.0, 1.0]), turn)
    back, again = rotated(there, R, turn.T)
    assert np.allclose(unit_vector(back), unit_vector(z))
    assert again is not None
    assert np.allclose(in_arc(again, back), in_arc(np.diag([2.0, 1.0]), z), atol=1e-6)


def test_the_mean_of_points_around_the_zenith_is_the_zenith() -> None:
    """Angles average to elevation 80 degrees there."""
    ring = np.stack([np.arange(4) * np.pi / 2 - 3.0, np.full(4, np.radians(80.0))], axis=1)
    w = np.full(4, 0.25)
    mean, cov, _ = weighted_moments(np.zeros((4, 1)), ring, np.zeros(1), w, w, apart, moved)
    assert mean[1] == pytest.approx(np.pi / 2, abs=1e-6)
    assert np.allclose(cov, np.eye(2) * np.radians(10.0) ** 2 / 2, rtol=1e-6)
