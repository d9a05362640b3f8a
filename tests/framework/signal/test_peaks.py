import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from sonobench.signal import local_maxima, pick, refine


@given(st.floats(-0.5, 0.5), st.floats(0.1, 5.0), st.floats(-3, 3))
def test_a_parabola_is_refined_exactly(offset, bend, top):
    y = top - bend * (np.array([-1.0, 0.0, 1.0]) - offset) ** 2
    at, height = refine(*y)
    assert abs(at - offset) < 1e-9 * (1 + 1 / bend) * 10
    assert abs(height - top) < 1e-9 * 10


def test_peaks_come_row_by_row_highest_first_within_limits():
    curves = np.array([[0, 1, 0, 3, 0, 2, 0], [0, 0, 5, 0, 0, 1, 0]], float)
    curves.flags.writeable = False
    allowed = np.ones(curves.shape, bool)
    allowed[1, 2] = False
    row, at, height = pick(curves, allowed, np.array([1.5, 0.5]), 2)
    assert row.tolist() == [0, 0, 1]
    assert at.tolist() == [3, 5, 5]
    assert height.tolist() == [3, 2, 1]


def test_ends_are_no_maxima_and_a_plateau_counts_once():
    assert local_maxima(np.array([9.0, 1, 2, 2, 1, 9])).tolist() == [False, False, True, False, False, False]


def test_nothing_above_the_floor_is_nothing():
    row, at, height = pick(np.zeros((3, 9)), np.ones((3, 9), bool), 0.1, 4)
    assert len(row) == len(at) == len(height) == 0
