"""Errors of the number of targets."""

from __future__ import annotations

import numpy as np
import pytest
from scoring_scenes import XY, estimates, truth

from sonobench.scoring import score
from sonobench.types import Space
from sonobench_plugins.metric.cardinality import Cardinality


def rows(scene, counts, **parameters):
    output = estimates([np.zeros((n, 2)) for n in counts])
    return {r.metric: r.value for r in score(Cardinality(**parameters), scene, output, XY)}


def test_absolute_signed_and_relative_errors_are_means_over_frames():
    found = rows(truth(np.zeros((4, 2, 2))), [2, 1, 4, 2])
    assert found == {"cardinality": 3 / 4, "cardinality.bias": 1 / 4, "cardinality.are": pytest.approx((0.5 + 1) / 4)}


def test_without_a_target_the_relative_error_divides_by_1():
    assert rows(truth(np.zeros((2, 1, 2)), exists=[[0], [0]]), [0, 3])["cardinality.are"] == 1.5


def test_silent_targets_count_unless_only_active_ones_are_asked_for():
    scene = truth(np.zeros((1, 3, 2)), active=[[1, 0, 0]])
    assert rows(scene, [1])["cardinality"] == 2
    assert rows(scene, [1], targets="active")["cardinality"] == 0


def test_it_needs_no_coordinates_in_common():
    scene = truth(np.zeros((1, 1, 2)))
    assert score(Cardinality(), scene, estimates([[[3.0]]]), Space.of("range_m"))[0].value == 0


def test_a_failed_trial_misses_everybody():
    found = {r.metric: r.value for r in score(Cardinality(), truth(np.zeros((3, 2, 2))), [], None)}
    assert found == {"cardinality": 2, "cardinality.bias": -2, "cardinality.are": 1}
