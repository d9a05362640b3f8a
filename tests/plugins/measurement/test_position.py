"""Positions measured directly."""

import dataclasses

import numpy as np
import pytest
from phd_linear import setup

from sonobench.errors import SetupError
from sonobench.types import Sensor, Space
from sonobench_plugins.measurement.position import Position

SPACE = Space.of("x_m", "vx_m_s", "y_m", "vy_m_s", "z_m", "vz_m_s")
NOMINAL = {"p_d": 0.9, "clutter_per_scan": 2.0, "position_std_m": 0.5}


def spatial():
    unit = Sensor("radar", "a", "position", np.zeros((1, 3)), Space.of("x_m", "y_m", "z_m"))
    return dataclasses.replace(setup(nominal=NOMINAL), sensors=(unit,))


def test_a_planar_and_a_spatial_sensor_read_the_coordinates_that_they_name():
    x = np.arange(12.0).reshape(2, 6)
    planar, solid = Position().bind(SPACE, setup(nominal=NOMINAL)), Position().bind(SPACE, spatial())
    np.testing.assert_array_equal(planar.h(x, 0)[:, 0], x[:, [0, 2]])
    np.testing.assert_array_equal(solid.h(x, 0)[:, 0], x[:, [0, 2, 4]])
    np.testing.assert_array_equal(planar.R(0), 0.25 * np.eye(2))


def test_clutter_of_rows_with_missing_components_is_the_marginal_and_holds_a_little_beyond_the_region():
    bound = Position().bind(SPACE, setup(nominal=NOMINAL))
    assert bound.log_clutter(np.array([5.0, 5.0]), 0) == pytest.approx(np.log(2 / 100))
    assert bound.log_clutter(np.array([5.0, 99.0]), 0, np.array([True, False])) == pytest.approx(np.log(2 / 10))
    np.testing.assert_array_equal(np.isfinite(bound.log_clutter(np.array([[12.9, 5], [13.1, 5], [5, -3.1]]), 0)), [True, False, False])


def test_a_region_of_its_own_stands_for_the_box():
    bound = Position(region_m=[[0, 0], [2, 2]], clutter_per_scan=3.0).bind(SPACE, setup(nominal=NOMINAL))
    assert bound.log_clutter(np.array([1.0, 1.0]), 0) == pytest.approx(np.log(3 / 4))
    assert Position(clutter_per_scan=0.0).bind(SPACE, setup(nominal=NOMINAL)).log_clutter(np.array([1.0, 1.0]), 0) == -np.inf


@pytest.mark.parametrize(
    ("model", "where", "says"),
    [
        (Position(), setup(), "no nominal position_std_m"),
        (Position(), dataclasses.replace(setup(nominal=NOMINAL), box_m=None), "set region_m"),
        (Position(region_m=[[0, 0, 0], [1, 1, 1]]), setup(nominal=NOMINAL), "has 3 columns, sensor s0 2"),
        (Position(sensor="stack"), setup(nominal=NOMINAL), "named 'stack'"),
    ],
)
def test_what_is_missing_is_named(model, where, says):
    with pytest.raises(SetupError, match=says):
        model.bind(SPACE, where)


@pytest.mark.parametrize("values", [{"position_std_m": 0.0}, {"p_d": 1.1}, {"clutter_per_scan": -1.0}, {"region_m": [[0, 0], [1, 0]]}])
def test_impossible_parameters_are_refused(values):
    with pytest.raises(ValueError):
        Position(**values)
