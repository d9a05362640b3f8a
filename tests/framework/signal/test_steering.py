import numpy as np
import pytest
from signal_sounds import BOX_M, WALL_PAIRS, WALLS_M, free_field, header, scans

from sonobench import DelayTable, SetupError
from sonobench.geometry import pair_delays
from sonobench.signal import grid, rig, stack_sensor, steered_power, widened
from sonobench_plugins.activity.always import Always
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
