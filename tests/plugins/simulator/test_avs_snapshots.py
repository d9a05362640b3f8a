"""Snapshots of plane waves at vector sensors, and vector sensors of the other simulators."""

import importlib.util

import numpy as np
import pytest

from sonobench.components import overlay
from sonobench.errors import InputError, TableError
from sonobench.geometry import angles, unit_vector
from sonobench.registry import Registry
from sonobench.scene import Scene
from sonobench.types import identical

TABLE = {
    "name": "field",
    "simulator": {"use": "avs-snapshots", "held": True},
    "duration_s": 4.0,
    "rate_hz": 8000.0,
    "period_s": 0.5,
    "evaluate_at": "centre",
    "arrays": {"mast": {"kind": "avs", "elements_m": [[1.0, 2.0, 3.0]]}},
    "sources": {
        "drone": {
            "sound": {"use": "white", "rms": 1.0},
            "gain_db": 5.0,
            "trajectory": {
                "use": "bearing",
                "origin_m": [1.0, 2.0, 3.0],
                "range_m": 900.0,
                "azimuth_deg": 30.0,
                "elevation_deg": 30.0,
                "azimuth_deg_s": 4.0,
            },
        },
    },
}


@pytest.fixture(scope="module")
def registry():
    return Registry.load([])


def scene(registry, **more):
    return Scene.from_table(overlay(TABLE, more), registry)


def samples(made):
    return np.concatenate([b.samples for b in made.blocks]).astype(float)


def test_a_held_period_has_the_direction_of_its_evaluation_time(registry):
    for at in ("centre", "end"):
        made = scene(registry, evaluate_at=at).simulate(1)
        x = samples(made).reshape(8, 4000, 4)
        u = (made.truth.position[:, 0] - [1.0, 2.0, 3.0]) / 900.0
        np.testing.assert_allclose(x[..., 1:], x[..., :1] * u[:, None], atol=1e-6)
        start = {"centre": 31.0, "end": 32.0}[at]
        np.testing.assert_allclose(np.rad2deg(angles(u))[[0, -1], 0], [start, start + 14.0], atol=1e-6)


def test_without_holding_the_direction_is_that_of_every_sample(registry):
    made = scene(registry, simulator={"held": False}).simulate(1)
    x = samples(made)
    azimuth = np.deg2rad(30.0 + 4.0 * np.arange(32000) / 8000)
    u = unit_vector(np.stack([azimuth, np.full(32000, np.deg2rad(30.0))], axis=1))
    np.testing.assert_allclose(x[:, 1:], u * x[:, :1], atol=1e-6)


def test_the_covariance_is_that_of_the_model(registry):
    """E x xᵀ = a sigma_s² aᵀ + Q, by Wishart's deviations of every entry."""
    still = {"drone": {"trajectory": {"azimuth_deg_s": 0.0}}}
    made = scene(registry, duration_s=20.0, sources=still, noise={"variance": 1.5, "velocity_variance": [0.5, 0.4, 0.3]}).simulate(2)
    x = samples(made)
    a = np.append(1.0, unit_vector(np.deg2rad([30.0, 30.0])))
    wanted = np.sqrt(10) * np.outer(a, a) + np.diag([1.5, 0.5, 0.4, 0.3])
    deviation = np.sqrt((np.outer(np.diag(wanted), np.diag(wanted)) + wanted**2) / len(x))
    assert np.abs((x.T @ x / len(x) - wanted) / deviation).max() < 4
    assert made.truth.parameters["source_variance"] == pytest.approx(np.sqrt(10), rel=4 * np.sqrt(2 / len(x)))


def test_sounds_add_up_without_fades_and_only_within_their_intervals(registry):
    second = {
        "sound": {"use": "uniform", "rms": 1.0},
        "trajectory": {"use": "still", "position_m": [1.0, 2.0, 900.0]},
        "intervals": [[1.0, 2.0]],
    }
    both, one = (samples(scene(registry, sources=s).simulate(3)) for s in ({"other": second}, {}))
    x = both - one
    assert not x[:8000].any()
    assert not x[16000:].any()
    np.testing.assert_allclose(x[8000:16000, [1, 2, 3]], x[8000:16000, :1] * [0, 0, 1], atol=1e-6)
    edge = np.abs(x[8000:8080, 0])
    assert edge.max() > 1.0  # a fade of 10 ms would keep these low
    assert np.abs(x[:, 0]).max() < np.sqrt(3) + 1e-6


def test_elements_see_a_near_source_each_from_its_own_place(registry):
    arrays = {"mast": {"elements_m": [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]}}
    near = {"drone": {"trajectory": {"use": "still", "position_m": [1.0, 1.0, 0.0]}}}
    x = samples(scene(registry, arrays=arrays, sources=near).simulate(1))
    np.testing.assert_allclose(x[:, 5:8], x[:, :1] * np.array([-1, 1, 0]) / np.sqrt(2), atol=1e-6)
    np.testing.assert_allclose(x[:, 1:4], x[:, :1] * np.array([1, 1, 0]) / np.sqrt(2), atol=1e-6)


def test_the_same_seed_renders_the_same_and_another_seed_not(registry):
    made = scene(registry, noise={"variance": 1.0})
    first, again, other = made.simulate(1), made.simulate(1), made.simulate(2)
    assert all(identical(a, b) for a, b in zip(first.blocks, again.blocks, strict=True))
    assert identical(first.truth, again.truth)
    assert np.abs(np.corrcoef(samples(first)[:, 0], samples(other)[:, 0])[0, 1]) < 0.03


def test_rooms_microphones_and_sources_on_a_sensor_are_refused(registry):
    with pytest.raises(TableError, match="room: avs-snapshots renders plane waves in free field"):
        scene(registry, room={"size_m": [2000.0, 2000.0, 2000.0], "t60_s": 0.3}).simulate(1)
    with pytest.raises(TableError, match=r'arrays\.ear\.kind: is \'microphones\'; avs-snapshots needs "avs"'):
        scene(registry, arrays={"ear": {"elements_m": [[0.0, 0.0, 0.0]]}}).simulate(1)
    with pytest.raises(InputError, match="meets a vector sensor"):
        scene(registry, sources={"drone": {"trajectory": {"use": "still", "position_m": [1.0, 2.0, 3.0]}}}).simulate(1)


@pytest.mark.skipif(importlib.util.find_spec("pyroomacoustics") is None, reason="needs the extra rooms")
def test_pyroomacoustics_refuses_vector_sensors(registry):
    with pytest.raises(
        TableError, match=r"arrays\.mast\.kind: PyroomacousticsRooms renders pressure alone; .* image-method or avs-snapshots"
    ):
        scene(registry, simulator={"use": "pyroomacoustics"}).simulate(1)


def test_the_image_method_hears_pressure_as_microphones_and_far_sources_as_plane_waves(registry):
    """In a turned array, one scene with microphones and one with vector sensors in the same places."""
    still = {"drone": {"trajectory": {"range_m": 30.0, "azimuth_deg_s": 0.0}}}
    arrays = {"mast": {"yaw_deg": 40.0, "position_m": [1.0, 2.0, 3.0], "elements_m": [[0.0, 0.0, 0.0], [0.05, 0.0, 0.0]]}}
    both = {"simulator": {"use": "image-method"}, "duration_s": 1.0, "sources": still}
    x = samples(scene(registry, arrays=arrays, **both).simulate(1))
    p = samples(scene(registry, arrays=overlay(arrays, {"mast": {"kind": "microphones"}}), **both).simulate(1))
    np.testing.assert_allclose(x[:, ::4], p, atol=1e-7)
    u = unit_vector(np.deg2rad([30.0 - 40.0, 30.0]))
    np.testing.assert_allclose(x[:, 1:4], x[:, :1] * u, atol=1e-7)
