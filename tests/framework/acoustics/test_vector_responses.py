"""Pressure and velocity from image sources."""

import numpy as np
import pytest

from sonobench.acoustics.image_sources import build_lattice, free_field
from sonobench.acoustics.path_render import LEAD, impulse_responses, path_at, render_path
from sonobench.acoustics.vector_responses import render_vectors, vector_responses
from sonobench.geometry import unit_vector
from sonobench.types import read_only

RATE, C = 8000.0, 343.0
BOX, WALLS = [5.0, 4.0, 3.0], [0.6, 0.5, 0.7, 0.4, 0.3, 0.8]
HERE = read_only([[1.0, 1.2, 1.4]])
SENSORS = read_only([[3.9, 2.9, 1.7], [2.5, 3.5, 1.0]])


def test_pressure_channels_are_what_microphones_receive():
    lattice = build_lattice(BOX, WALLS, max_order=4)
    made = vector_responses(lattice, HERE, SENSORS, RATE, C, 600).reshape(1, 2, 4, 600)
    np.testing.assert_allclose(made[:, :, 0], impulse_responses(lattice, HERE, SENSORS, RATE, C, 600), atol=1e-7)


def test_each_image_brings_its_own_direction():
    """By first principles, one wall: the source and its mirror image behind x = 0."""
    lattice = build_lattice(BOX, [0.6, 0, 0, 0, 0, 0], max_order=1)
    made = vector_responses(lattice, HERE, SENSORS[:1], RATE, C, 600)[0]
    image = HERE[0] * [-1, 1, 1]
    wanted = np.zeros((4, 600))
    for at, a in ((HERE[0], 1.0), (image, 0.6)):
        alone = impulse_responses(free_field(), read_only(at[None]), SENSORS[:1], RATE, C, 600)[0, 0]
        u = (at - SENSORS[0]) / np.linalg.norm(at - SENSORS[0])
        wanted += a * np.append(1.0, u)[:, None] * alone
    np.testing.assert_allclose(made, wanted, atol=2e-7)


def test_velocity_obeys_the_equation_of_motion_in_a_room():
    """dv/dt = c grad p (Euler's equation, v scaled by −rho c), the gradient by differences of what microphones receive."""
    lattice, step = build_lattice(BOX, WALLS, max_order=3), 0.002
    n = 1024
    around = SENSORS[0] + step / 2 * np.concatenate([np.eye(3), -np.eye(3)])
    spectra = np.fft.rfft(impulse_responses(lattice, HERE, read_only(around), RATE, C, n)[0].astype(float))
    gradient = (spectra[:3] - spectra[3:]) / step
    velocity = np.fft.rfft(vector_responses(lattice, HERE, SENSORS[:1], RATE, C, n)[0, 1:].astype(float))
    frequency = np.fft.rfftfreq(n, 1 / RATE)
    band = (frequency > 1500) & (frequency < 3000)
    error = C * gradient - 2j * np.pi * frequency * velocity
    share = np.linalg.norm(error[:, band]) / np.linalg.norm(C * gradient[:, band])
    assert share < 0.02  # the near-field term, 1 / (k r) of each image, r = 3.4 m and more: 0.01 at 1.5 kHz


def test_a_moving_far_source_is_a_plane_wave_at_every_sample():
    angle = np.deg2rad([[30.0, 20.0], [33.0, 18.0]])
    ends = read_only(40.0 * unit_vector(angle))
    signal = np.random.default_rng(1).standard_normal(8000)
    path = path_at(np.array([0.0, 1.0]), ends, 8000, RATE, 0.01)
    sensor = read_only([[0.0, 0.0, 0.0]])
    made = render_vectors(free_field(), signal, path, sensor, RATE, C)
    p = render_path(free_field(), signal, path, sensor, RATE, C)[:, 0]
    np.testing.assert_allclose(made[:, 0], p, atol=1e-8)
    left = np.maximum(np.arange(8000) / RATE - 40.0 / C, 0)[:, None]  # when the sound that arrives was emitted
    at = ends[0] + left * (ends[1] - ends[0])
    u = at / np.linalg.norm(at, axis=1, keepdims=True)
    np.testing.assert_allclose(made[:, 1:], u * p[:, None], atol=2e-5 * np.abs(p).max())


def test_an_element_on_the_source_is_refused_and_no_position_gives_no_response():
    with pytest.raises(ValueError, match="lies on the source"):
        vector_responses(free_field(), HERE, HERE, RATE, C, 100)
    assert vector_responses(free_field(), read_only(np.zeros((0, 3))), SENSORS, RATE, C, 100).shape == (0, 8, 100)
    assert LEAD < 100
