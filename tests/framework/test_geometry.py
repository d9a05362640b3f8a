"""Directions as angles and as unit vectors."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from sonobench.geometry import angles, unit_vector

AZIMUTH, ELEVATION = st.floats(-3.14159, 3.14159), st.floats(-1.5707, 1.5707)


@given(AZIMUTH, ELEVATION, st.floats(1e-3, 1e6))
def test_angles_of_a_vector_of_any_length_are_those_it_was_made_of(azimuth, elevation, length):
    u = unit_vector([azimuth, elevation])
    np.testing.assert_allclose(np.linalg.norm(u), 1.0, rtol=1e-14)
    np.testing.assert_allclose(angles(length * u), [azimuth, elevation], atol=1e-9)


@given(AZIMUTH, ELEVATION)
def test_a_direction_is_x_turned_up_and_then_left(azimuth, elevation):
    up = np.array([[np.cos(elevation), 0, -np.sin(elevation)], [0, 1, 0], [np.sin(elevation), 0, np.cos(elevation)]])
    left = np.array([[np.cos(azimuth), -np.sin(azimuth), 0], [np.sin(azimuth), np.cos(azimuth), 0], [0, 0, 1]])
    np.testing.assert_allclose(unit_vector([azimuth, elevation]), left @ up @ [1, 0, 0], atol=1e-14)


def test_axes_lie_where_the_words_say():
    z = np.array([[0, 0], [np.pi / 2, 0], [np.pi, 0], [0, np.pi / 2], [0, -np.pi / 2]])
    axes = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1]])
    np.testing.assert_allclose(unit_vector(z), axes, atol=1e-15)
    np.testing.assert_array_equal(angles(axes), z)


def test_straight_back_is_plus_pi_whatever_the_sign_of_zero():
    np.testing.assert_array_equal(angles([[-1.0, -0.0, 0.0], [-1.0, 0.0, -0.0]]), [[np.pi, 0.0]] * 2)


def test_straight_up_has_azimuth_0_and_many_directions_keep_their_shape():
    np.testing.assert_array_equal(angles(np.array([-0.0, -0.0, 2.0])), [0.0, np.pi / 2])
    assert angles(np.ones((2, 5, 3))).shape == (2, 5, 2)
    assert unit_vector(np.zeros((4, 0, 2))).shape == (4, 0, 3)
