import dataclasses

import numpy as np
import phd_scenes as scenes
import pytest
from phd_linear import frozen

from sonobench.errors import SetupError
from sonobench.filtering.mixture import empty
from sonobench.protocols import Birth, Mixture
from sonobench.types import Detections, Scan, Sensor, Space
from sonobench_plugins.birth.fixed import Fixed
from sonobench_plugins.birth.from_detections import FromDetections
from sonobench_plugins.birth.given import Given
from sonobench_plugins.birth.room import Room
from sonobench_plugins.measurement.tdoa import Tdoa
from sonobench_plugins.motion.langevin import Langevin

SPACE = Langevin().space
FIXED = Fixed(scenes.BIRTHS, np.full((1, 4), 1e-4), np.array([0.1, 0.1, 0.2]), once=2)


def started(birth, where, space=SPACE, **tdoa):
    return birth.start(space, where, Tdoa(**tdoa).bind(space, where))


def proposed(birth, where, frame, live=None, space=SPACE, **tdoa):
    memory = started(birth, where, space, **tdoa)
    return birth.propose(np.random.default_rng(0), memory, frame, empty(len(space)) if live is None else live)[1]


def stacked(*rows, **more):
    rows = np.array(rows).reshape(-1, 4)
    return Scan(0.0, [True], (Detections(rows, np.zeros(len(rows), int), **more),))


def singles(places, drop=(), extra=()):
    z = scenes.delays(places)
    rows = [(q, z[i, q]) for i in range(len(z)) for q in range(4) if (i, q) not in drop] + list(extra)
    return Scan(0.0, [True] * 4, (Detections(np.array([[v] for _, v in rows]), [q for q, _ in rows]),))


def live_at(x, w=0.9):
    n = len(x)
    return frozen(Mixture(np.full(n, w), np.array(x, float), np.tile(np.eye(4) * 1e-3, (n, 1, 1)), np.zeros(n, np.int64)))


@pytest.mark.parametrize("birth", [FIXED, Given(), Room(), FromDetections()], ids=lambda b: type(b).__name__)
def test_every_birth_fits_the_role_and_says_whether_it_reads_the_scan(birth):
    assert isinstance(birth, Birth)
    assert birth.uses_scan is isinstance(birth, FromDetections)


def test_fixed_has_its_leading_rows_at_the_start_and_the_others_in_every_scan():
    where = scenes.setup()
    memory = started(FIXED, where)
    first = FIXED.initial(memory)
    for _ in range(2):
        memory, later = FIXED.propose(np.random.default_rng(0), memory, stacked(), empty(4))
        np.testing.assert_array_equal(later.m, scenes.BIRTHS[2:])
        np.testing.assert_array_equal(later.w, [0.2])
        np.testing.assert_array_equal(later.P, np.eye(4)[None] * 1e-4)
    np.testing.assert_array_equal(first.m, scenes.BIRTHS[:2])
    np.testing.assert_array_equal(first.w, [0.1, 0.1])


def test_given_rows_may_exist_at_the_start_only():
    where = scenes.setup(given={"births": scenes.BIRTHS})
    birth = Given(once=2)
    memory = started(birth, where)
    np.testing.assert_array_equal(birth.initial(memory).m, scenes.BIRTHS[:2])
    np.testing.assert_array_equal(proposed(birth, where, stacked()).m, scenes.BIRTHS[2:])
    with pytest.raises(SetupError, match=r"once is 4; given 'births' has 3 rows"):
        started(Given(once=4), where)


def test_fixed_refuses_rows_that_do_not_fit():
    with pytest.raises(ValueError, match="2 weights for 3 means"):
        Fixed(np.zeros((3, 4)), np.ones((1, 4)), np.ones(2))
    with pytest.raises(ValueError, match="once is 4"):
        Fixed(np.zeros((3, 4)), np.ones((1, 4)), np.ones(1), once=4)
    with pytest.raises(SetupError, match=r"means of 4 numbers.*z_m"):
        started(FIXED, scenes.setup(), Langevin(dims=3).space)


def test_given_takes_states_or_positions():
    where = scenes.setup(given={"births": scenes.BIRTHS, "starts": [[1.0, 2.0, 1.5]]})
    np.testing.assert_array_equal(proposed(Given(), where, stacked()).m, scenes.BIRTHS)
    still = proposed(Given(name="starts", position_std_m=0.2, velocity_std_m_s=0.5, weight=0.3), where, stacked())
    np.testing.assert_array_equal(still.m, [[1, 0, 2, 0]])
    np.testing.assert_allclose(still.P[0], np.diag([0.04, 0.25, 0.04, 0.25]))
    np.testing.assert_array_equal(still.w, [0.3])


def test_given_refuses_what_the_pipeline_did_not_ask_for_and_odd_shapes():
    with pytest.raises(SetupError, match="given 'births'; the pipeline asked for nothing: write given"):
        started(Given(), scenes.setup())
    with pytest.raises(SetupError, match=r"shape \(1, 5\)"):
        started(Given(), scenes.setup(given={"births": np.zeros((1, 5))}))


@pytest.mark.parametrize("per_axis", [1, 3])
def test_room_has_mass_mean_and_variance_of_the_uniform_density(per_axis):
    mix = proposed(Room(weight=0.2, per_axis=per_axis), scenes.setup(), stacked())
    assert len(mix.w) == per_axis**2
    assert mix.w.sum() == pytest.approx(0.2)
    mean = mix.w @ mix.m / 0.2
    second = np.einsum("j,jab->ab", mix.w / 0.2, mix.P + (mix.m - mean)[:, :, None] * (mix.m - mean)[:, None, :])
    np.testing.assert_allclose(mean, [1.5, 0, 1.5, 0], atol=1e-12)
    np.testing.assert_allclose(np.diag(second), [0.75, 0.25, 0.75, 0.25])


def test_room_in_three_dimensions_and_without_a_box():
    assert proposed(Room(per_axis=2), scenes.setup(), stacked(), space=Langevin(dims=3).space).m.shape == (8, 6)
    with pytest.raises(SetupError, match="needs the room's box"):
        started(Room(), scenes.setup(box_m=None))
    with pytest.raises(SetupError, match="needs x_m and y_m"):
        Room().start(Space.of("azimuth_rad"), scenes.setup(), None)


@pytest.mark.parametrize("place", [[0.4, 0.7], [2.6, 1.5], [1.5, 2.9], [0.1, 0.1]])
def test_one_exact_stacked_row_is_inverted_to_its_place(place):
    born = proposed(FromDetections(weight=0.07), scenes.setup(), stacked(scenes.delays(np.array([[place[0], 0, place[1], 0]]))))
    np.testing.assert_allclose(born.m, [[place[0], 0, place[1], 0]], atol=2e-3)  # the room's prior pulls a little
    np.testing.assert_array_equal(born.w, [0.07])


def test_the_birth_covariance_is_that_of_the_estimate():
    where, x = scenes.setup(), np.array([[1.2, 0, 0.8, 0]])
    rng, birth = np.random.default_rng(1), FromDetections(velocity_std_m_s=0.4)
    memory = started(birth, where)
    rows = scenes.delays(x) + scenes.SIGMA_S * rng.standard_normal((400, 4))
    born = [birth.propose(rng, memory, stacked(row), empty(4))[1] for row in rows]
    assert sum(len(b.w) for b in born) > 380  # gate .99
    errors = np.concatenate([b.m - x for b in born])[:, [0, 2]]
    P = np.mean([b.P[0] for b in born if len(b.w)], axis=0)
    np.testing.assert_allclose(np.cov(errors.T), P[np.ix_([0, 2], [0, 2])], atol=0.2 * np.trace(P[np.ix_([0, 2], [0, 2])]))
    np.testing.assert_allclose(np.diag(P)[[1, 3]], 0.16)


def test_uniform_false_rows_rarely_meet_at_a_place():
    rng, birth = np.random.default_rng(2), FromDetections()
    memory = started(birth, scenes.setup())
    limit = 0.6 / 343
    count = sum(len(birth.propose(rng, memory, stacked(*rng.uniform(-limit, limit, (7, 4))), empty(4))[1].w) for _ in range(60))
    assert count < 0.15 * 7 * 60


def test_single_pairs_are_combined_though_one_missed():
    places = np.array([[0.7, 0, 0.9, 0], [2.2, 0, 2.1, 0]])
    born = proposed(FromDetections(), scenes.setup(False), singles(places, drop={(0, 1)}, extra=[(1, 1.2e-3), (3, -1.5e-3)]))
    near = np.linalg.norm(born.m[:, None, [0, 2]] - places[:, [0, 2]], axis=-1).min(axis=0)
    assert (near < 0.02).all()


def test_a_row_with_a_missing_component_still_has_enough_to_agree():
    z = scenes.delays(np.array([[0.7, 0, 0.9, 0]]))
    z[0, 2] = 1.7e-3
    born = proposed(FromDetections(), scenes.setup(), stacked(z, valid=[[True, True, False, True]]))
    np.testing.assert_allclose(born.m[:, [0, 2]], [[0.7, 0.9]], atol=5e-3)
    assert len(proposed(FromDetections(), scenes.setup(), stacked(z)).w) == 0
    assert len(proposed(FromDetections(), scenes.setup(), stacked(z, valid=[[True, True, False, False]])).w) == 0


def test_a_live_target_is_not_born_again_but_a_second_is():
    places = np.array([[0.7, 0, 0.9, 0], [2.2, 0, 2.1, 0]])
    born = proposed(FromDetections(), scenes.setup(), stacked(*scenes.delays(places)), live_at(places[:1]))
    np.testing.assert_allclose(born.m[:, [0, 2]], [[2.2, 2.1]], atol=5e-3)
    assert len(proposed(FromDetections(), scenes.setup(), stacked(*scenes.delays(places)), live_at(places[:1], w=0.1)).w) == 2
    close = live_at(places + np.array([0.2, 0, 0, 0]))  # its rows are not explained, but it is there
    assert len(proposed(FromDetections(), scenes.setup(), stacked(*scenes.delays(places)), close).w) == 0


def test_the_order_of_rows_does_not_matter():
    rng = np.random.default_rng(3)
    z = np.r_[scenes.delays(np.array([[0.7, 0, 0.9, 0], [2.2, 0, 2.1, 0]])), rng.uniform(-1.5e-3, 1.5e-3, (5, 4))]
    a, b = (proposed(FromDetections(), scenes.setup(), stacked(*z[order])) for order in (slice(None), slice(None, None, -1)))
    assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def test_nothing_is_born_of_what_was_not_searched_or_of_no_rows():
    where = scenes.setup()
    z = scenes.delays(np.array([[0.7, 0, 0.9, 0]]))
    assert len(proposed(FromDetections(), where, Scan(0.0, [False], (Detections(z, [0]),))).w) == 0
    assert len(proposed(FromDetections(), where, stacked()).w) == 0


def test_three_dimensions_with_enough_microphones():
    space = Langevin(dims=3).space
    elements = np.array([[0, 0, 0.5], [0, 3, 2.5], [3, 0, 2.5], [3, 3, 0.5], [1.5, 0, 1.5], [0, 1.5, 1.0]])
    pairs = np.array([[0, 1], [0, 2], [0, 3], [4, 5], [1, 4]])
    sensor = Sensor("stack", "walls", "tdoa", elements, Space(tuple("abcde")), pairs)
    where = dataclasses.replace(scenes.setup(sigma_s=3e-5), sensors=(sensor,))
    model = Tdoa().bind(space, where)
    x = np.array([1.1, 0, 2.0, 0, 1.3, 0])
    frame = Scan(0.0, [True], (Detections(model.h(x, 0), [0]),))
    np.testing.assert_allclose(proposed(FromDetections(), where, frame, space=space).m, x[None], atol=5e-3)


def test_births_from_detections_need_a_box_and_enough_components():
    with pytest.raises(SetupError, match="needs its box"):
        started(FromDetections(), scenes.setup(box_m=None))
    with pytest.raises(SetupError, match=r"needs 5 components.*have 4"):
        started(FromDetections(agree=5), scenes.setup())
