"""The scenes of the two papers with a vector sensor."""

import numpy as np
import pytest

from sonobench.geometry import angles, unit_vector
from sonobench.registry import Registry
from sonobench.scene import Scene
from sonobench.scene.truth import given_of, truth_of

REGISTRY = Registry.load()


def seen(name):
    """Truth, and azimuth and elevation (k, n, 2) in degrees."""
    truth = truth_of(Scene.load(name, REGISTRY))
    return truth, np.rad2deg(angles(truth.position))


def separations(truth, degrees):
    """(k, n, n) degrees between sources that exist, infinite elsewhere."""
    u = unit_vector(np.deg2rad(degrees))
    apart = np.rad2deg(np.arccos(np.clip(np.einsum("kia,kja->kij", u, u), -1, 1)))
    both = truth.exists[:, :, None] & truth.exists[:, None, :] & ~np.eye(u.shape[1], dtype=bool)
    return np.where(both, apart, np.inf)


def test_hu2014_is_the_printed_motion_in_120_frames():
    truth, degrees = seen("hu2014")
    x0 = 1000.0 * unit_vector(np.deg2rad([30.0, 30.0]))
    velocity = np.array([20.0, -10.0, -20.0])
    np.testing.assert_allclose(truth.time_s, np.arange(120) + 0.5)
    np.testing.assert_allclose(truth.position[:, 0], x0 + truth.time_s[:, None] * velocity, atol=1e-5)
    np.testing.assert_allclose(truth.velocity[:, 0], np.tile(velocity, (120, 1)), atol=1e-4)
    np.testing.assert_allclose(degrees[0, 0], [30.0, 30.0], atol=1.0)


def test_hu2014_hands_out_its_start_with_errors_of_100_m_and_10_m_s():
    scene = Scene.load("hu2014", REGISTRY)
    starts = np.array([given_of(scene, seed)["starts"][0] for seed in range(200)])
    np.testing.assert_allclose(starts.mean(axis=0)[1:4], [750.0, 433.0, 500.0], atol=4 * 100 / np.sqrt(200))
    np.testing.assert_allclose(starts.std(axis=0), [0, 100, 100, 100, 10, 10, 10], rtol=0.2)


def test_hu2014_static_stays_at_30_degrees():
    truth, degrees = seen("hu2014-static")
    np.testing.assert_allclose(degrees, np.full((100, 1, 2), 30.0), atol=1e-9)
    assert len(truth.time_s) == 100


def test_five_sources_are_there_in_the_frames_of_the_issue_and_stay_apart():
    truth, degrees = seen("zhang-glmb-five")
    frames = [(1, 50), (1, 50), (8, 50), (14, 42), (20, 50)]
    number = np.arange(1, 51)
    np.testing.assert_array_equal(truth.exists, np.stack([(number >= on) & (number <= off) for on, off in frames], axis=1))
    first = [degrees[on - 1, n] % 360 for n, (on, _) in enumerate(frames)]
    np.testing.assert_allclose(np.array(first)[:, 0], [20, 100, 185, 250, 315], atol=0.6)
    assert separations(truth, degrees).min() > 60
    assert np.abs(degrees[..., 1][truth.exists]).max() < 60


@pytest.mark.parametrize(("name", "begin", "least"), [("zhang-glmb-two-1", 20, 15.0), ("zhang-glmb-two-2", 1, 60.0)])
def test_two_sources_begin_where_the_paper_says(name, begin, least):
    truth, degrees = seen(name)
    np.testing.assert_array_equal(truth.exists[:, 1], np.arange(1, 51) >= begin)
    second = {"zhang-glmb-two-1": 180.0, "zhang-glmb-two-2": 100.0}[name]
    np.testing.assert_allclose(degrees[0, 0] % 360, [180, 30], atol=0.6)
    np.testing.assert_allclose(degrees[begin - 1, 1] % 360, [second, 30], atol=0.6)
    assert separations(truth, degrees).min() > least


@pytest.mark.parametrize(("name", "frames"), [("", (1, 50)), ("-appears", (19, 50)), ("-vanishes", (1, 38))])
def test_three_talkers_go_where_the_paper_measured_them(name, frames):
    truth, degrees = seen(f"zhang-glmb-three{name}")
    number = np.arange(1, 51)
    np.testing.assert_array_equal(truth.exists[:, 2], (number >= frames[0]) & (number <= frames[1]))
    np.testing.assert_allclose(degrees[:, 0, 0], 8.1, atol=0.01)
    np.testing.assert_allclose(degrees[[0, -1], 1, 0], [60.95, 113.96], atol=0.6)
    np.testing.assert_allclose(degrees[frames[0] - 1, 2, 0] % 360, 240.95, atol=0.8)
    np.testing.assert_allclose(degrees[..., 1], 0, atol=1e-9)
