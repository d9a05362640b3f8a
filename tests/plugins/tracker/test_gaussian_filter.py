"""The single-target Gaussian filter and the tracker that reports detections as they are."""

from __future__ import annotations

import dataclasses

import direction_scans as scene
import numpy as np
import pytest

from sonobench.directions import separations
from sonobench.geometry import angles, unit_vector
from sonobench.types import Array, Detections, Estimate, Scan, Setup, Space
from sonobench_plugins.birth.from_directions import FromDirections
from sonobench_plugins.birth.given import Given
from sonobench_plugins.measurement.position import Position
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.tracker.best_detection import BestDetection
from sonobench_plugins.tracker.gaussian_filter import GaussianFilter
from sonobench_plugins.transform.linearised import Linearised
from sonobench_plugins.transform.unscented import Unscented

_START = Given("starts", once=1, position_std_m=100.0, velocity_std_m_s=10.0)


def _paper(acceleration: float = 10.0, **changes: object) -> GaussianFilter:
    motion = ConstantVelocity(3, held_acceleration_m_s2=acceleration)
    return GaussianFilter(motion=motion, birth=_START, **changes)  # type: ignore[arg-type]


def _started(setup: Setup, seed: int) -> Setup:
    """With a start that is off by 100 m and 10 m/s."""
    std = np.array([0.0, *3 * [100.0], *3 * [10.0]])
    return dataclasses.replace(setup, given={"starts": setup.given["starts"] + std * np.random.default_rng(seed).standard_normal(7)})


def _run(tracker: GaussianFilter | BestDetection, setup: Setup, scans: list[Scan]) -> list[Estimate]:
    rng = np.random.default_rng(0)
    state, found = tracker.init(rng, setup), []
    for scan in scans:
        state, estimate = tracker.step(rng, state, scan)
        found.append(estimate)
    return found


def _directions(estimates: list[Estimate]) -> Array:
    states = np.array([e.states[0] for e in estimates])
    return states if states.shape[1] == 2 else np.asarray(angles(states[:, ::2]))


def _rmse(tracker: GaussianFilter | BestDetection, powers: tuple[float, float, float], runs: int) -> Array:
    """Azimuth and elevation as the tables count them: rms over runs, mean over steps 21 to 120."""
    points, errors = scene.truth().position[:, 0], []
    for run in range(runs):
        scans = scene.scans(np.random.default_rng([1, run]), points, scene.static_std(*powers))
        error = _directions(_run(tracker, _started(scene.setup(), run), scans)) - angles(points)
        errors.append(np.remainder(error + np.pi, 2 * np.pi) - np.pi)
    return np.asarray(np.sqrt(np.mean(np.square(errors), axis=0))[20:].mean(axis=0))


def test_with_a_linear_measurement_it_is_the_kalman_filter() -> None:
    rng = np.random.default_rng(3)
    setup = dataclasses.replace(_measured(), given={"starts": np.zeros((1, 7))})
    z = rng.standard_normal((6, 3))
    tracker = GaussianFilter(ConstantVelocity(3), Position(position_std_m=0.5, p_d=1.0, clutter_per_scan=0.0), birth=_START)
    found = _run(tracker, setup, [Scan(k + 1.0, np.ones(1, bool), (Detections(row[None], np.zeros(1, int)),)) for k, row in enumerate(z)])
    F, Q = ConstantVelocity(3).matrices(1.0)
    H, m, P = np.eye(6)[::2], np.zeros(6), np.diag([1e4, 100.0] * 3)
    for row, estimate in zip(z, found, strict=True):
        m, P = F @ m, F @ P @ F.T + Q
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + 0.25 * np.eye(3))
        m, P = m + K @ (row - H @ m), P - K @ H @ P
        assert np.allclose(estimate.states[0], m, atol=1e-6)
        assert estimate.covs is not None
        assert np.allclose(estimate.covs[0], P, rtol=1e-6, atol=1e-6)


def _measured() -> Setup:
    from sonobench.types import Sensor

    box = np.array([[-9.0, -9.0, -9.0], [9.0, 9.0, 9.0]])
    return Setup(
        (Sensor("position", "room", "position", np.zeros((0, 3)), Space.of("x_m", "y_m", "z_m")),), ("room",), np.eye(4)[None], box_m=box
    )


def test_scans_without_rows_only_predict_and_unsearched_ones_too() -> None:
    start = scene.setup().given["starts"][0]
    for searched in (True, False):
        found = _run(_paper(), scene.setup(), [Scan(2.0, np.full(1, searched))])[0]
        assert np.allclose(found.states[0, ::2], start[1:4] + 2 * start[4:])
        assert found.covs is not None
        assert found.covs[0, 0, 0] == pytest.approx(100**2 + 4 * 10**2 + 10**2 * 2**2)


@pytest.mark.parametrize("transform", [Linearised(), Unscented()], ids=["ekf", "ukf"])
def test_the_transforms_agree_where_the_measurement_is_nearly_straight(transform: Linearised | Unscented) -> None:
    points = scene.truth(30).position[:, 0]
    scans = scene.scans(np.random.default_rng(2), points, 1e-3)
    known = Given("starts", once=1, position_std_m=10.0, velocity_std_m_s=1.0)
    one, other = (
        _directions(_run(dataclasses.replace(t, birth=known), scene.setup(), scans))
        for t in (_paper(0.1), _paper(0.1, transform=transform))
    )
    assert separations(one, other).max() < 5e-6


def test_a_target_that_passes_overhead_and_behind_is_not_lost() -> None:
    """Through 1.5 degrees off the zenith, then across azimuth 180 degrees, at .3 degrees of noise."""
    time = np.arange(1.0, 81.0)[:, None]
    overhead = np.array([-400.0, 5.0, 300.0]) + time * [10.0, 0.1, 0.0]
    behind = np.array([-300.0, -40.0, 20.0]) + time * [0.0, 1.0, 0.0]
    for points, velocity in ((overhead, [10.0, 0.1, 0.0]), (behind, [0.0, 1.0, 0.0])):
        scans = scene.scans(np.random.default_rng(4), points, 0.005)
        start = np.concatenate([[0.0], points[0] - velocity, velocity])[None]
        setup = dataclasses.replace(scene.setup(), given={"starts": start})
        birth = Given("starts", once=1, position_std_m=5.0, velocity_std_m_s=1.0)
        tracker = GaussianFilter(ConstantVelocity(3, held_acceleration_m_s2=0.1), birth=birth)
        error = separations(_directions(_run(tracker, setup, scans)), angles(points))
        assert error.max() < 0.012
        assert np.sqrt(np.mean(error**2)) < 0.8 * 0.005 * np.sqrt(2)


def test_without_a_start_it_begins_along_the_first_direction() -> None:
    points = scene.truth(40).position[:, 0]
    scans = [Scan(0.5, np.ones(1, bool)), *scene.scans(np.random.default_rng(5), points, 5e-3)]
    birth = FromDirections(range_m=800.0, range_std_m=300.0, velocity_std_m_s=30.0)
    found = _run(GaussianFilter(ConstantVelocity(3, held_acceleration_m_s2=1.0), birth=birth), scene.setup(), scans)
    assert [len(e.states) for e in found[:3]] == [0, 1, 1]
    assert np.linalg.norm(found[1].states[0, ::2]) == pytest.approx(800.0)
    error = separations(_directions(found[1:]), angles(points))
    assert np.sqrt(np.mean(error[20:] ** 2)) < 0.8 * 5e-3 * np.sqrt(2)


def test_of_several_rows_the_nearest_or_the_best_is_taken_and_none_beyond_the_gate() -> None:
    points = scene.truth(1).position[:, 0]
    true, other = angles(points)[0], np.array([-2.0, 0.1])
    R = np.tile(1e-4 * np.eye(2), (2, 1, 1))
    both = Scan(1.0, np.ones(1, bool), (Detections(np.stack([other, true]), np.zeros(2, int), R, score=np.array([2.0, 1.0])),))
    only = Scan(1.0, np.ones(1, bool), (Detections(other[None], np.zeros(1, int), R[:1]),))
    predicted, nearest, best, gated = (
        _directions(_run(t, scene.setup(), [s]))[0]
        for t, s in (
            (_paper(), Scan(1.0, np.zeros(1, bool))),
            (_paper(), both),
            (_paper(choice="score"), both),
            (_paper(gate=6.0), only),
        )
    )
    assert separations(nearest, true) < 0.02
    assert separations(best, true) > 0.1
    assert np.array_equal(gated, predicted)


def test_filters_side_by_side_find_the_process_noise_that_the_truth_has() -> None:
    points = scene.truth(60).position[:, 0]
    scans = scene.scans(np.random.default_rng(6), points, 4e-3)
    quiet, loud = (_run(_paper(process_scales=s), scene.setup(), scans) for s in ((1.0, 1e-4), (1.0,)))
    assert quiet[-1].info["weight_1"] > 0.9
    late = slice(20, None)
    assert np.mean(separations(_directions(quiet), angles(points))[late] ** 2) < 0.5 * np.mean(
        separations(_directions(loud), angles(points))[late] ** 2
    )
    twice = _run(_paper(process_scales=(1.0, 1.0)), scene.setup(), scans)
    assert np.allclose(twice[-1].states, loud[-1].states)


def test_the_best_detections_come_in_the_rooms_axes() -> None:
    pose = np.eye(4)
    pose[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]  # turned by 90 degrees, counter-clockwise
    z, R = np.array([[0.1, 0.2], [0.5, -0.3]]), np.tile(np.diag([2e-4, 1e-4]), (2, 1, 1))
    scan = Scan(1.0, np.ones(1, bool), (Detections(z, np.zeros(2, int), R, score=np.array([1.0, 3.0])),))
    one = _run(BestDetection(), scene.setup(pose), [scan, Scan(2.0, np.ones(1, bool))])
    assert np.allclose(one[0].states, z[1:] + np.array([np.pi / 2, 0.0]))
    assert one[0].covs is not None
    assert np.allclose(one[0].covs[0], R[0])
    assert len(one[1].states) == 0
    assert np.allclose(unit_vector(_run(BestDetection(most=5), scene.setup(), [scan])[0].states), unit_vector(z[::-1]))


def test_tracking_gains_what_tables_2_and_3_print() -> None:
    """Hu, Li & Jin 2014, first row, 12 runs: within 12 % (its standard error is some 4 %)."""
    powers = next(iter(scene.TABLES))
    elevation, azimuth, tracked_elevation, tracked_azimuth = scene.TABLES[powers]
    assert np.allclose(_rmse(BestDetection(), powers, 12), [azimuth, elevation], rtol=0.12)
    assert np.allclose(_rmse(_paper(), powers, 12), [tracked_azimuth, tracked_elevation], rtol=0.12)


@pytest.mark.study
@pytest.mark.parametrize(("powers", "ratio"), [*zip(scene.TABLES, (0.63, 0.59, 0.69, 0.55), strict=True)])
def test_tables_2_and_3(powers: tuple[float, float, float], ratio: float) -> None:
    """Hu, Li & Jin 2014: every row within 8 %, and the gain within .04."""
    elevation, azimuth, tracked_elevation, tracked_azimuth = scene.TABLES[powers]
    still, tracked = _rmse(BestDetection(), powers, 100), _rmse(_paper(), powers, 100)
    assert np.allclose(still, [azimuth, elevation], rtol=0.08)
    assert np.allclose(tracked, [tracked_azimuth, tracked_elevation], rtol=0.08)
    assert tracked.sum() / still.sum() == pytest.approx(ratio, abs=0.04)
    assert np.hypot(tracked[0] * np.cos(0.5), tracked[1]) < scene.static_std(*powers) * np.sqrt(2)  # the static bound of the whole angle


def test_filters_either_side_of_a_half_turn_average_on_the_circle():
    from sonobench_plugins.motion.bearing_velocity import BearingVelocity
    from sonobench_plugins.tracker.gaussian_filter import GaussianFilter

    tracker = GaussianFilter(motion=BearingVelocity(), process_scales=(1.0, 0.1))
    d = len(tracker.space)
    m, at = np.zeros((2, d)), tracker.space.index("azimuth_rad")[0]
    m[:, at] = np.pi - 0.01, 0.01 - np.pi
    estimate = tracker._estimate(1.0, np.array([0.5, 0.5]), m, np.tile(1e-4 * np.eye(d), (2, 1, 1)))
    assert np.cos(estimate.states[0, at]) < -0.9999
    assert estimate.covs[0, at, at] < 1e-3
