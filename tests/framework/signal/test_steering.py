from dataclasses import replace

import numpy as np
import pytest
from signal_sounds import BOX_M, RATE_HZ, WALL_PAIRS, WALLS_M, every_pair, free_field, header, scans
from steering_direct import phase_steered

from sonobench import DelayTable, SetupError
from sonobench.geometry import pair_delays
from sonobench.signal import grid, plan_tables, rig, stack_sensor, steered_power, steering, widened
from sonobench_plugins.activity.always import Always
from sonobench_plugins.delay.phat import Phat
from sonobench_plugins.front_end.gcc_peaks import GccPeaks


def test_steered_power_is_the_sum_of_look_ups_and_highest_at_the_source():
    source = [1.2, 1.9, 1.5]
    setup, out = scans(GccPeaks(activity=Always()), header(WALLS_M, WALL_PAIRS), free_field(1, [source], WALLS_M))
    table, points = out[3].fields["gcc"], grid(BOX_M, 0.05, 1.5)
    power = steered_power(table, setup, points)
    tau = pair_delays(points, WALLS_M, WALL_PAIRS, 343.0)
    by_hand = sum(np.interp(tau[:, p], table.start_s + table.step_s * np.arange(table.values.shape[1]), table.values[p]) for p in range(4))
    assert np.allclose(power, by_hand, atol=1e-5)
    assert np.linalg.norm(points[power.argmax()] - source) < 0.06


def test_planar_points_lie_at_the_nominal_height():
    setup, _ = GccPeaks().open(header(WALLS_M, WALL_PAIRS))
    table = DelayTable(np.random.default_rng(0).random((4, 201), np.float32), -1.5e-3, 1.5e-5)
    flat = np.random.default_rng(1).random((3, 2, 2)) * 2
    raised = np.concatenate([flat, np.full((3, 2, 1), 1.5)], axis=-1)
    assert np.array_equal(steered_power(table, setup, flat), steered_power(table, setup, raised))


def test_a_grid_fills_the_box_with_equal_cells():
    points = grid(BOX_M, 0.3, None)
    assert (points > BOX_M[0]).all()
    assert (points < BOX_M[1]).all()
    assert np.allclose(points.mean(axis=0), BOX_M.mean(axis=0))
    assert len(points) == 14 * 10 * 9


def test_widening_keeps_the_own_pairs_first_and_adds_each_other_once():
    own = np.array([[3, 1], [0, 2]])
    recording = header(WALLS_M[:4], own)
    wide = widened(rig(recording, "scene", "test"), recording)
    assert wide.pairs[:2].tolist() == own.tolist()
    assert len({frozenset(p) for p in wide.pairs.tolist()}) == len(wide.pairs) == 6


def test_the_stack_has_one_delay_a_pair():
    sensor = stack_sensor(rig(header(WALLS_M, WALL_PAIRS), "scene", "test"))
    assert len(sensor.space) == 4
    assert np.array_equal(sensor.pairs, WALL_PAIRS)


@pytest.mark.parametrize(("pairs", "words"), [("scene", "pairs = 'all'"), ("some", "'scene' or 'all'")])
def test_a_rig_without_pairs_says_what_to_do(pairs, words):
    with pytest.raises(SetupError, match=words):
        rig(header(WALLS_M, np.zeros((0, 2), int)), pairs, "gcc-peaks")


def test_sums_of_tables_are_phase_steering_within_the_interpolation_error():
    """28 pairs, tables of 8 columns a lag: at most .7 % of a coherent peak a pair."""
    pairs, rng = every_pair(8), np.random.default_rng(2)
    x = free_field(4, [[1.3, 1.1, 1.5]], WALLS_M, seconds=0.3)[200:1224]
    plan = plan_tables(pairs, RATE_HZ, "hamming", 1024, 0.013, None, 8)
    spectra = plan.spectra(x[None])
    table = DelayTable(plan.tables(Phat(), spectra)[0], plan.start_s, plan.step_s)
    points = np.c_[rng.uniform(0.2, 3.8, 300), rng.uniform(0.2, 2.8, 300), np.full(300, 1.5)]
    setup, _ = GccPeaks(pairs="all").open(header(WALLS_M, pairs))
    sums = steering(setup, range(28)).sums(table, points)
    direct = phase_steered(plan, spectra[0], WALLS_M, pairs, points, 343.0, RATE_HZ)
    assert np.abs(sums - direct).max() < 0.007 * 28
    np.testing.assert_allclose(sums, steered_power(table, setup, points), rtol=1e-4, atol=1e-4)


def test_a_steering_follows_an_array_that_moves_and_lists_each_microphone_once():
    pairs = every_pair(8)
    setup, out = scans(GccPeaks(pairs="all"), header(WALLS_M, pairs), free_field(4, [[1.3, 1.1, 1.5]], WALLS_M, seconds=0.5))
    assert len(steering(setup, range(28)).elements) == 8
    pose = np.eye(4)[None].copy()
    pose[0, :3, 3] = [0.5, -0.2, 0.0]
    moved = steering(setup, range(28), replace(out[0], pose=pose))
    np.testing.assert_allclose(np.sort(moved.elements, axis=0), np.sort(WALLS_M + pose[0, :3, 3], axis=0))
