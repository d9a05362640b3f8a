import dataclasses
import pickle

import numpy as np
import phd_scenes as scenes
import pytest

from sonobench.errors import SetupError
from sonobench.geometry import sensor_delays
from sonobench.protocols import BoundMeasurement, Measurement
from sonobench.types import Sensor, Setup, Space
from sonobench_plugins.measurement.tdoa import Tdoa
from sonobench_plugins.motion.langevin import Langevin

SPACE = Langevin().space


def states(n=20, dims=2, seed=0):
    x = np.random.default_rng(seed).uniform(0.2, 2.8, (n, 2 * dims))
    x.flags.writeable = False
    return x


def test_fits_the_roles():
    assert isinstance(Tdoa(), Measurement)
    assert isinstance(Tdoa().bind(SPACE, scenes.setup()), BoundMeasurement)


def test_delays_are_equation_38_and_the_geometry_rooms():
    where = scenes.setup()
    model, x = Tdoa().bind(SPACE, where), states()
    np.testing.assert_allclose(model.h(x, 0)[:, 0], scenes.delays(x), rtol=0, atol=1e-17)
    np.testing.assert_allclose(model.h(x, 0)[:, 0], sensor_delays(x[:, [0, 2]], where, 0), rtol=0, atol=1e-17)
    assert model.h(x.reshape(4, 5, 4), 0).shape == (4, 5, 1, 4)


def test_a_farther_first_microphone_gives_a_positive_delay():
    model = Tdoa().bind(SPACE, scenes.setup())
    assert model.h(np.array([2.5, 0, 0.01, 0]), 0)[0, 0] > 0  # nearer to (2, 0) than to (1.4, 0)


@pytest.mark.parametrize("dims", [2, 3])
@pytest.mark.parametrize("stacked", [True, False])
def test_jacobian_is_the_central_difference_of_h(dims, stacked):
    where = scenes.setup(stacked, nominal={"p_d": 1, "clutter_per_scan": 1, "delay_std_s": 1e-4, "height_m": 1.3})
    model, x = Tdoa().bind(Langevin(dims=dims).space, where), states(dims=dims)
    for q in model.sensors:
        J = model.jacobian(x, q)
        for i in range(2 * dims):
            e = np.eye(2 * dims)[i] * 1e-5
            np.testing.assert_allclose(J[..., i], (model.h(x + e, q) - model.h(x - e, q)) / 2e-5, rtol=0, atol=1e-12)


def test_a_state_on_a_microphone_has_a_finite_jacobian():
    model = Tdoa(height_m=0.0).bind(SPACE, scenes.setup())
    assert np.isfinite(model.jacobian(np.array([1.4, 0, 0, 0.0]), 0)).all()


def test_moving_room_array_and_talker_together_changes_nothing():
    a = 0.7
    pose = np.array([[np.cos(a), -np.sin(a), 0, 1.0], [np.sin(a), np.cos(a), 0, -2], [0, 0, 1, 0.5], [0, 0, 0, 1]])
    where = scenes.setup(nominal={"p_d": 1, "clutter_per_scan": 1, "delay_std_s": 1e-4})
    model = Tdoa().bind(Langevin(dims=3).space, where)
    moved = Tdoa().bind(Langevin(dims=3).space, scenes.setup(poses=pose[None]))
    x = states(dims=3)
    y = x.copy()
    y[:, [0, 2, 4]] = x[:, [0, 2, 4]] @ pose[:3, :3].T + pose[:3, 3]
    np.testing.assert_allclose(moved.h(y, 0), model.h(x, 0), atol=1e-16)
    np.testing.assert_allclose(model.h(y, 0, pose), model.h(x, 0), atol=1e-16)
    turned = model.jacobian(y, 0, pose)[..., [0, 2, 4]]
    np.testing.assert_allclose(turned @ pose[:3, :3], model.jacobian(x, 0)[..., [0, 2, 4]], atol=1e-16)


def test_clutter_is_a_density_whose_integral_is_the_count():
    model = Tdoa().bind(SPACE, scenes.setup(clutter=7.0))
    volume = (2 * 0.6 / 343) ** 4
    assert np.exp(model.log_clutter(np.zeros(4), 0)) * volume == pytest.approx(7.0)
    single = Tdoa().bind(SPACE, scenes.setup(False, clutter=3.0))
    assert np.exp(single.log_clutter(np.zeros(1), 2)) * 2 * 0.6 / 343 == pytest.approx(3.0)


def test_clutter_of_some_components_is_the_marginal_of_clutter_of_all():
    model = Tdoa().bind(SPACE, scenes.setup(clutter=7.0))
    valid = np.array([True, False, True, False])
    beyond = np.array([0, 1.0, 0, 1.0])  # what is missing may hold anything
    assert np.exp(model.log_clutter(beyond, 0, valid)) * (2 * 0.6 / 343) ** 2 == pytest.approx(7.0)


def test_clutter_ends_six_deviations_beyond_the_aperture_and_nowhere_without_clutter():
    model = Tdoa(delay_std_s=1e-5).bind(SPACE, scenes.setup())
    limit = 0.6 / 343
    z = np.zeros((3, 4))
    z[1, 2], z[2, 2] = limit + 5.9e-5, -limit - 6.1e-5
    np.testing.assert_array_equal(np.isfinite(model.log_clutter(z, 0)), [True, True, False])
    none = Tdoa(clutter_per_scan=0.0).bind(SPACE, scenes.setup())
    assert none.log_clutter(z[0], 0) == -np.inf


def test_parameters_left_out_are_the_recordings_and_set_ones_win():
    where = scenes.setup(p_d=0.7, sigma_s=3e-5)
    model = Tdoa().bind(SPACE, where)
    np.testing.assert_allclose(model.R(0), np.eye(4) * 9e-10)
    np.testing.assert_array_equal(model.p_d(states(3), 0), np.full((3, 1), 0.7))
    own = Tdoa(p_d=0.4, delay_std_s=1e-4).bind(SPACE, where)
    assert own.p_d(np.zeros(4), 0) == 0.4
    assert own.R(0)[0, 0] == pytest.approx(1e-8)


def test_height_of_planar_states_is_own_then_nominal_then_zero():
    low = scenes.setup(nominal={"p_d": 1, "clutter_per_scan": 1, "delay_std_s": 1e-4})
    high = scenes.setup(nominal={"p_d": 1, "clutter_per_scan": 1, "delay_std_s": 1e-4, "height_m": 1.5})
    x = states(1)
    solid = np.insert(x, 4, [[1.5], [0.0]], axis=1)
    three = Tdoa().bind(Langevin(dims=3).space, low).h(solid, 0)
    np.testing.assert_allclose(Tdoa().bind(SPACE, high).h(x, 0), three, atol=1e-18)
    np.testing.assert_allclose(Tdoa(height_m=1.5).bind(SPACE, low).h(x, 0), three, atol=1e-18)
    solid[:, 4] = 0
    np.testing.assert_allclose(Tdoa().bind(SPACE, low).h(x, 0), Tdoa().bind(Langevin(dims=3).space, low).h(solid, 0), atol=1e-18)


def both():
    return dataclasses.replace(scenes.setup(), sensors=scenes.setup().sensors + scenes.setup(False).sensors)


def test_a_grouping_is_chosen_by_the_beginning_of_its_names():
    assert Tdoa(sensor="stack").bind(SPACE, both()).sensors == (0,)
    assert Tdoa(sensor="pair/").bind(SPACE, both()).sensors == (1, 2, 3, 4)


def test_one_pair_in_two_sensors_is_refused():
    with pytest.raises(SetupError, match="stack and pair/0 hold the same microphone pair; set `sensor`"):
        Tdoa().bind(SPACE, both())


@pytest.mark.parametrize(
    ("measurement", "where", "space", "says"),
    [
        (Tdoa(sensor="ring"), scenes.setup(), SPACE, "named 'ring'"),
        (Tdoa(), scenes.setup(nominal={"p_d": 1.0, "clutter_per_scan": 1.0}), SPACE, "no nominal delay_std_s"),
        (Tdoa(), scenes.setup(nominal={"delay_std_s": 1e-4, "clutter_per_scan": 1.0}), SPACE, "no nominal p_d"),
        (Tdoa(), scenes.setup(), Space.of("x_m", "vx_m_s"), "has no y_m"),
        (
            Tdoa(),
            Setup((Sensor("a", "a", "direction", np.zeros((1, 3)), Space.of("azimuth_rad")),), ("a",), np.eye(4)[None]),
            SPACE,
            "kind 'tdoa'.*direction",
        ),
    ],
)
def test_what_the_setup_lacks_is_named(measurement, where, space, says):
    with pytest.raises(SetupError, match=says):
        measurement.bind(space, where)


@pytest.mark.parametrize("values", [{"delay_std_s": 0.0}, {"p_d": 1.5}, {"clutter_per_scan": -1.0}])
def test_impossible_parameters_are_refused(values):
    with pytest.raises(ValueError, match="needed"):
        Tdoa(**values)


def test_a_bound_model_pickles():
    model = pickle.loads(pickle.dumps(Tdoa().bind(SPACE, scenes.setup())))
    np.testing.assert_array_equal(model.h(states(), 0), Tdoa().bind(SPACE, scenes.setup()).h(states(), 0))
