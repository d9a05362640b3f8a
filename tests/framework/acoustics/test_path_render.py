"""What microphones receive of sources that stand or move."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import fftconvolve

from sonobench.acoustics.image_sources import build_lattice, free_field
from sonobench.acoustics.path_render import (
    LEAD,
    POINTS,
    Path,
    impulse_responses,
    lagrange_window,
    path_at,
    render_path,
    response_length,
)

BOX = np.array([3.0, 3.0, 2.5])
WALLS = np.array([0.85, 0.8, 0.25, 0.4, 0.6, 0.1])
RATE, C = 16000.0, 343.0
MICS = np.array([[2.1, 0.4, 1.6], [0.9, 2.5, 0.8]])
for array in (BOX, WALLS, MICS):
    array.flags.writeable = False

inside = st.tuples(*(st.floats(0.05, float(length) - 0.05) for length in BOX)).map(np.array)


def responses(lattice, positions, mics, length=4000):
    return impulse_responses(lattice, np.atleast_2d(positions), np.atleast_2d(mics), RATE, C, length)


def test_free_field_is_a_delay_of_r_over_c_and_an_amplitude_of_one_over_4_pi_r():
    samples = 97
    r = samples * C / RATE
    h = responses(free_field(), [0.0, 0.0, r], [0.0, 0.0, 0.0], 300)[0, 0]
    expected = np.zeros(300)
    expected[LEAD + samples] = 1 / (4 * math.pi * r)
    np.testing.assert_allclose(h, expected, atol=1e-6 * expected.max())


def test_walls_that_reflect_nothing_are_free_field():
    a = responses(build_lattice(BOX, np.zeros(6)), [1.0, 2.0, 0.5], MICS)
    b = responses(free_field(), [1.0, 2.0, 0.5], MICS)
    np.testing.assert_allclose(a, b, atol=1e-6 * np.abs(b).max())  # images of amplitude 0, if any, change nothing


@settings(max_examples=25, deadline=None)
@given(inside, inside)
def test_source_and_microphone_may_be_exchanged(a, b):
    if np.linalg.norm(a - b) < 0.02:
        return
    lattice = build_lattice(BOX, WALLS, 8, -math.inf)
    there, back = responses(lattice, a, b), responses(lattice, b, a)
    np.testing.assert_allclose(there, back, atol=2e-5 * np.abs(there).max())


@settings(max_examples=15, deadline=None)
@given(st.permutations(range(4)), st.integers(0, 2**32 - 1))
def test_microphones_do_not_depend_on_each_other(order, seed):
    mics = np.random.default_rng(seed).uniform(0.1, BOX - 0.1, (4, 3))
    lattice = build_lattice(BOX, WALLS, 5)
    h = responses(lattice, [1.5, 1.4, 1.2], mics, 800)
    np.testing.assert_array_equal(h[:, order], responses(lattice, [1.5, 1.4, 1.2], mics[order], 800))


def test_a_shorter_response_is_the_start_of_a_longer_one():
    lattice = build_lattice(BOX, WALLS, 8)
    whole = responses(lattice, [1.5, 1.4, 1.2], MICS, 3000)
    for length in (1, 50, 700):
        np.testing.assert_array_equal(responses(lattice, [1.5, 1.4, 1.2], MICS, length), whole[..., :length])


def test_the_response_length_holds_every_image():
    lattice = build_lattice(BOX, WALLS, 6, -math.inf)
    position = np.array([[0.02, 2.98, 0.01]])
    length = response_length(lattice, position, MICS, RATE, C)
    longer = responses(lattice, position, MICS, length + 500)
    assert not longer[..., length:].any()


def test_a_microphone_on_the_source_is_refused():
    with pytest.raises(ValueError, match="lies on the source"):
        responses(free_field(), MICS[0], MICS)


@pytest.mark.parametrize("lattice", [free_field(), build_lattice(BOX, WALLS, 10)], ids=["free", "room"])
@pytest.mark.parametrize("nodes", [1, 9])
def test_a_still_source_is_convolved_with_its_response(lattice, nodes):
    signal = np.random.default_rng(1).normal(size=4000)
    signal.flags.writeable = False
    at = np.array([1.2, 1.7, 1.1])
    y = render_path(lattice, signal, Path(np.tile(at, (nodes, 1)), 500), MICS, RATE, C)
    h = responses(lattice, at, MICS)[0].astype(float)
    expected = fftconvolve(signal[None], h, axes=-1)[:, LEAD : LEAD + len(signal)].T
    assert y.shape == (4000, 2)
    assert np.abs(y - expected).max() <= 3e-6 * np.abs(expected).max()


def moving_sine(frequency_hz, speed_m_s, step_m=0.01, samples=16384):
    """Rendered and exact signal of a source that flies past a microphone in free field."""
    t = np.arange(samples) / RATE
    start, velocity, mic = np.array([1.0, 1.0, 1.0]), np.array([speed_m_s, 0, 0]), np.array([[2.0, 1.8, 1.2]])
    ends = np.array([0.0, samples / RATE + 0.1])
    path = path_at(ends, start + velocity * ends[:, None], samples, RATE, step_m)
    y = render_path(free_field(), np.sin(2 * np.pi * frequency_hz * t), path, mic, RATE, C)[:, 0]
    sent = t
    for _ in range(40):
        sent = t - np.linalg.norm(start + velocity * sent[:, None] - mic, axis=1) / C
    away = start + velocity * sent[:, None] - mic
    d = np.linalg.norm(away, axis=1)
    # the retarded potential of a moving source, with the factor that crowds its waves together
    exact = np.sin(2 * np.pi * frequency_hz * sent) / (4 * np.pi * d) / (1 + away @ velocity / d / C)
    inner = slice(1500, -1500)
    return y[inner], exact[inner]


@pytest.mark.parametrize(("frequency_hz", "floor_db"), [(500.0, -95.0), (2000.0, -90.0), (4000.0, -65.0)])
@pytest.mark.parametrize("speed_m_s", [0.7, 1.5, 5.0])
def test_a_moving_source_is_doppler_shifted_without_clicks(frequency_hz, speed_m_s, floor_db):
    y, exact = moving_sine(frequency_hz, speed_m_s)
    assert 10 * np.log10(((y - exact) ** 2).sum() / (exact**2).sum()) <= floor_db


def test_a_moving_source_splatters_no_more_than_minus_80_db():
    y, _ = moving_sine(1000.0, 1.5)
    spectrum = np.abs(np.fft.rfft(y * np.blackman(len(y)))) ** 2
    f = np.fft.rfftfreq(len(y), 1 / RATE)
    far = np.abs(f - 1000.0) > 30.0
    assert 10 * np.log10(spectrum[far].max() / spectrum.max()) <= -80.0


@pytest.mark.parametrize("hop", [1, 7, 160])
def test_the_windows_of_all_nodes_add_up_to_one(hop):
    window = lagrange_window(hop)
    np.testing.assert_allclose(window.reshape(POINTS, hop).sum(axis=0), 1.0, atol=1e-12)


def test_responses_between_nodes_follow_a_polynomial_exactly():
    u = np.arange(-POINTS // 2, POINTS // 2, 0.125)
    for power in range(POINTS):
        total = sum(node**power * np.interp(u - node, u, lagrange_window(8), left=0, right=0) for node in range(-2 * POINTS, 2 * POINTS))
        inner = np.abs(u) < 0.9
        np.testing.assert_allclose(total[inner], u[inner] ** power, atol=1e-9)


def test_rendering_is_linear_and_leaves_its_inputs_alone():
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, 2000))
    times, positions = np.array([0.0, 0.125]), np.array([[1.0, 1.0, 1.0], [1.3, 1.4, 1.2]])
    for array in (a, b, times, positions):
        array.flags.writeable = False
    lattice = build_lattice(BOX, WALLS, 6)
    path = path_at(times, positions, 2000, RATE, 0.02)
    ya, yb, both = (render_path(lattice, s, path, MICS, RATE, C) for s in (a, b, a + 2 * b))
    assert np.abs(ya + 2 * yb - both).max() <= 1e-5 * np.abs(both).max()


def test_a_silent_source_is_not_rendered():
    path = path_at(np.array([0.0, 1.0]), np.array([[1.0, 1, 1], [2, 2, 2]]), 3000, RATE, 0.01)
    assert not render_path(free_field(), np.zeros(3000), path, MICS, RATE, C).any()


def test_a_signal_that_lasts_before_the_source_moves_on_is_causal():
    signal = np.zeros(4000)
    signal[1000:1100] = 1.0
    path = path_at(np.array([0.0, 0.25]), np.array([[1.0, 1, 1], [1.2, 1, 1]]), 4000, RATE, 0.01)
    y = render_path(free_field(), signal, path, np.array([[2.0, 1, 1]]), RATE, C)[:, 0]
    arrival = 1000 + round(0.94 / C * RATE)
    assert np.abs(y[: arrival - LEAD - 4]).max() <= 1e-6 * np.abs(y).max()
    assert y[arrival + 10 : arrival + 90].min() > 0.05


def test_the_path_passes_through_the_given_positions_and_stays_at_its_ends():
    times, positions = np.array([0.1, 0.3, 0.4]), np.array([[0.0, 0, 0], [0.4, 0, 0], [0.4, 0.1, 0]])
    path = path_at(times, positions, 8000, RATE, 0.02)
    assert path.hop == 160  # 2 cm at 2 m/s
    at = np.arange(len(path.positions_m)) * path.hop / RATE
    np.testing.assert_allclose(path.positions_m[at <= 0.1], 0.0, atol=1e-12)
    np.testing.assert_allclose(path.positions_m[at >= 0.4], [[0.4, 0.1, 0]] * (at >= 0.4).sum(), atol=1e-12)
    np.testing.assert_allclose(path.positions_m[20], [0.2, 0, 0], atol=1e-12)


def test_paths_that_make_no_sense_are_refused():
    for times, positions in (([], np.zeros((0, 3))), ([0.0, 0.0], np.zeros((2, 3))), ([0.0], np.full((1, 3), np.nan))):
        with pytest.raises(ValueError, match="are needed"):
            path_at(np.array(times), positions, 10, RATE, 0.01)
