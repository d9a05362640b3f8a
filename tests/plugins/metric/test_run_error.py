"""A run's root mean square error, and lost runs."""

from __future__ import annotations

import numpy as np
import pytest

from sonobench.errors import InputError
from sonobench.types import Estimate, Space, Truth
from sonobench_plugins.metric.run_error import RunError

SPACE = Space.of("x_m", "y_m")


def truth(n: int = 1) -> Truth:
    k = 5
    exists = np.ones((k, n), bool)
    active = exists & (np.arange(k) != 2)[:, None]
    return Truth(0.1 * np.arange(1, k + 1), np.arange(n), np.zeros((k, n, 3)), exists, active, period_s=0.1)


def off(errors: list[float | None]) -> list[Estimate]:
    rows = [np.zeros((0, 2)) if e is None else np.array([[e, 0.0]]) for e in errors]
    return [Estimate(0.1 * (k + 1), x) for k, x in enumerate(rows)]


def test_it_is_the_root_mean_square_over_instants() -> None:
    found = RunError().evaluate(truth(), off([0.1, 0.2, 0.2, 0.4, 0.0]), SPACE)
    assert found[""].values == pytest.approx([np.sqrt(0.25 / 5)])
    assert found[""].pool == "mean"
    assert found["lost"].values.tolist() == [0.0]


def test_silent_instants_may_be_left_out() -> None:
    found = RunError(targets="active").evaluate(truth(), off([0.1, 0.1, 9.0, 0.1, 0.1]), SPACE)
    assert found[""].values == pytest.approx([0.1])


def test_a_run_far_off_and_one_without_estimates_are_lost() -> None:
    for errors in ([0.7] * 5, [None] * 5):
        assert RunError().evaluate(truth(), off(errors), SPACE)["lost"].values.tolist() == [1.0]


def test_instants_without_an_estimate_lower_the_coverage() -> None:
    found = RunError().evaluate(truth(), off([0.1, None, None, 0.1, None]), SPACE)[""]
    assert found.coverage == pytest.approx(0.4)
    assert found.values == pytest.approx([0.1])


def test_every_target_counts_with_its_nearest_estimate() -> None:
    assert RunError().evaluate(truth(2), off([0.1] * 5), SPACE)[""].values == pytest.approx([0.1])


def test_a_distance_that_makes_no_sense_is_refused() -> None:
    with pytest.raises(InputError, match="positive"):
        RunError(lost_m=0.0)
