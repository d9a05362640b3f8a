"""Errors of matched targets and what they leave out."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scoring_scenes import XY, estimates, truth

from sonobench.errors import InputError
from sonobench.scoring import score
from sonobench_plugins.metric.position_error import PositionError


def rows(scene, states, **parameters):
    return {r.metric.partition(".")[2]: r for r in score(PositionError(**parameters), scene, estimates(states), XY)}


def test_rms_and_median_are_over_matched_target_instants_of_all_frames():
    scene = truth([[[0, 0], [5, 0]], [[0, 0], [5, 0]]])
    found = rows(scene, [[[0.1, 0], [5.2, 0]], [[0.6, 0], [9, 9]]])
    assert found[""].value == pytest.approx(math.sqrt((0.01 + 0.04 + 0.36) / 3))
    assert found["median"].value == pytest.approx(0.2)
    assert found["coverage"].value == pytest.approx(3 / 4)
    assert found["false"].value == pytest.approx(1 / 2)
    assert found[""].coverage == found["median"].coverage == pytest.approx(3 / 4)
    assert (found["coverage"].better, found["false"].unit) == ("higher", "1/frame")


def test_an_estimate_of_a_silent_target_is_neither_false_nor_counted():
    scene = truth([[[0, 0], [5, 0]]], active=[[1, 0]])
    silent = rows(scene, [[[0.1, 0], [5.5, 0]]])
    assert (silent[""].value, silent["coverage"].value, silent["false"].value) == (pytest.approx(0.1), 1.0, 0.0)
    everybody = rows(scene, [[[0.1, 0]]], targets="exists")
    assert (everybody["coverage"].value, everybody["false"].value) == (0.5, 0.0)


def test_targets_that_do_not_exist_match_nobody():
    assert rows(truth([[[0, 0]]], exists=[[0]]), [[[0, 0]]])["false"].value == 1.0


def test_the_gate_is_open_at_its_edge():
    scene = truth([[[0, 0]]])
    assert rows(scene, [[[1.0, 0]]])["coverage"].value == 0.0
    assert rows(scene, [[[0.999, 0]]])["coverage"].value == 1.0


def test_a_failed_trial_is_undefined_with_coverage_0():
    found = {r.metric: r for r in score(PositionError(), truth(np.zeros((3, 1, 2))), [], None)}
    assert math.isnan(found["position-error"].value)
    assert math.isnan(found["position-error.median"].value)
    assert found["position-error"].coverage == 0.0
    assert (found["position-error.coverage"].value, found["position-error.false"].value) == (0.0, 0.0)


@given(st.integers(0, 4), st.integers(0, 4), st.randoms(use_true_random=False))
def test_matched_missed_and_false_account_for_everybody(n, m, random):
    x = np.array([[random.uniform(-2, 2) for _ in range(2)] for _ in range(n)]).reshape(n, 2)
    y = np.array([[random.uniform(-2, 2) for _ in range(2)] for _ in range(m)]).reshape(m, 2)
    found = {r.metric.partition(".")[2]: r for r in score(PositionError(), truth(x[None]), estimates([y]), XY)}
    matched = found["coverage"].value * n if n else 0.0
    assert matched + found["false"].value == pytest.approx(m)
    assert found[""].weight == pytest.approx(matched)


@pytest.mark.parametrize("bad", [{"c_m": 0.0}, {"targets": "loud"}])
def test_parameters_that_cannot_be_are_refused(bad):
    with pytest.raises(InputError, match=str(next(iter(bad.values())))):
        PositionError(**bad)
