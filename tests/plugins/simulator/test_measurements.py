"""Detections without audio: probabilities, errors, clutter, layout."""

import numpy as np
import pytest
from scene_tables import MEASURED, registry, scene

from sonobench.components import overlay
from sonobench.errors import TableError
from sonobench.geometry import max_delay, pair_delays
from sonobench.scene.scene import Scene
from sonobench.types import identical


def simulate(seed=1, top=None, **parameters):
    return scene(overlay(overlay(MEASURED, {"simulator": parameters}), top or {})).simulate(seed)


def exact(**parameters):
    return {"p_d": 1.0, "delay_std_s": 0.0, "clutter_per_scan": 0.0, **parameters}


@pytest.mark.parametrize("layout", ["stacked", "per-pair"])
def test_without_errors_misses_and_clutter_the_scan_is_the_truth(layout):
    made = simulate(**exact(layout=layout))
    elements, pairs = np.array(MEASURED["arrays"]["walls"]["elements_m"]), np.array([[0, 1], [2, 3]])
    for k, scan in enumerate(made.scans):
        true = pair_delays(made.truth.position[k][made.truth.exists[k]], elements, pairs, 343.0)
        seen = [scan.rows(q)[0] for q in range(len(made.header.sensors))]
        assert scan.searched.all()
        assert scan.time_s == made.truth.time_s[k]
        if layout == "stacked":
            assert sorted(map(tuple, seen[0])) == sorted(map(tuple, true))
        else:
            for q in range(2):
                assert sorted(seen[q][:, 0]) == sorted(true[:, q])


def test_sensors_are_named_as_the_front_ends_name_theirs():
    assert [(s.name, len(s.space)) for s in simulate().header.sensors] == [("stack", 2)]
    assert [(s.name, len(s.space)) for s in simulate(layout="per-pair").header.sensors] == [("pair-0", 1), ("pair-1", 1)]


def test_rates_of_detection_and_clutter_and_the_errors_are_as_stated():
    long = {"duration_s": 200.0, "sources": {"anna": {"intervals": [[0.0, 200.0]]}}}
    counts = [len(s.rows(0)[0]) for s in simulate(top=long, p_d=0.7, clutter_per_scan=0.0).scans]
    assert np.mean(counts) == pytest.approx(1.4, abs=4 * np.sqrt(2 * 0.21 / 2000))
    clutter = [len(s.rows(0)[0]) for s in simulate(top=long, p_d=0.0, clutter_per_scan=7.0).scans]
    assert np.mean(clutter) == pytest.approx(7.0, abs=4 * np.sqrt(7 / 2000))
    assert np.var(clutter) == pytest.approx(7.0, rel=0.15)
    one = {"duration_s": 200.0, "sources": {"anna": {"intervals": [[0.0, 0.05]]}}}
    made = simulate(top=one, p_d=1.0, delay_std_s=1e-4, clutter_per_scan=0.0)
    z = np.concatenate([s.detections[0].z for s in made.scans])
    true = pair_delays(made.truth.position[0, 1], np.array(MEASURED["arrays"]["walls"]["elements_m"]), np.array([[0, 1], [2, 3]]), 343.0)
    np.testing.assert_allclose(np.mean(z, axis=0), true, atol=4 * 1e-4 / np.sqrt(2000))
    np.testing.assert_allclose(np.cov(z.T), 1e-8 * np.eye(2), atol=1.3e-9)


def test_clutter_is_uniform_over_the_delays_that_a_pair_can_have():
    made = simulate(top={"duration_s": 100.0}, p_d=0.0, clutter_per_scan=9.0)
    z = np.concatenate([s.detections[0].z for s in made.scans])
    reach = max_delay(np.array(MEASURED["arrays"]["walls"]["elements_m"]), np.array([[0, 1], [2, 3]]), 343.0)
    np.testing.assert_array_less(np.abs(z).max(axis=0), reach)
    np.testing.assert_allclose((z**2).mean(axis=0), reach**2 / 3, rtol=0.05)
    np.testing.assert_allclose(z.mean(axis=0), 0.0, atol=4 * reach[0] / np.sqrt(3 * len(z)))


def test_the_order_of_rows_carries_no_meaning():
    long = {"duration_s": 50.0, "sources": {"anna": {"intervals": [[0.0, 50.0]]}}}
    firsts = [s.rows(0)[0][0, 0] < s.rows(0)[0][1, 0] for s in simulate(top=long, **exact()).scans]
    assert 0.3 < np.mean(firsts) < 0.7


def test_a_recording_is_a_function_of_its_seed():
    first, again, other = simulate(3), simulate(3), simulate(4)
    assert all(identical(a, b) for a, b in zip(first.scans, again.scans, strict=True))
    assert not all(identical(a, b) for a, b in zip(first.scans, other.scans, strict=True))


def test_nominal_values_follow_the_simulator_unless_the_scene_states_its_own():
    assert simulate(p_d=0.5).header.nominal == {"p_d": 0.5, "delay_std_s": 1e-4, "clutter_per_scan": 2.0}
    assert simulate(top={"nominal": {"p_d": 0.8}}, p_d=0.5).header.nominal["p_d"] == 0.8


def test_impossible_parameters_and_arrays_without_pairs_are_refused():
    with pytest.raises(TableError) as caught:
        simulate(p_d=1.5, delay_std_s=-1.0)
    assert [f.split(";")[0] for f in caught.value.faults] == ["scene: simulator: p_d: is 1.5", "scene: simulator: delay_std_s: is -1.0"]
    with pytest.raises(TableError, match=r"arrays\.walls\.pairs: is empty"):
        simulate(top={"arrays": {"walls": {"pairs": []}}})


def test_the_scene_of_chen_2012_is_the_papers():
    made = Scene.load("chen2012", registry()).simulate(1)
    truth = made.truth
    assert len(made.scans) == 100
    np.testing.assert_array_equal(truth.exists.sum(axis=0), [100, 81, 100])
    np.testing.assert_array_equal(np.flatnonzero(truth.exists[:, 1])[[0, -1]] + 1, [10, 90])
    np.testing.assert_allclose(truth.position[[9, 89], 1], [[0.5, 1.0, 1.5], [2.5, 1.0, 1.5]], atol=1e-6)
    np.testing.assert_allclose(truth.position[99, [0, 2]], [[2.5, 1.5, 1.5], [0.3, 0.8, 1.5]], atol=0.01)
    np.testing.assert_allclose(truth.velocity[0, [0, 2]], [[0, 0.98, 0], [0.98, 0, 0]], atol=0.04)
    assert (made.header.sensors[0].name, len(made.header.sensors[0].space), made.header.period_s) == ("stack", 4, 0.032)
    np.testing.assert_allclose(max_delay(made.header.sensors[0].elements, made.header.sensors[0].pairs, 343.0), 0.6 / 343.0)
    assert made.header.nominal["clutter_per_scan"] == 7.0


def positions(top=None, **parameters):
    free = {k: v for k, v in MEASURED.items() if k != "room"}
    simulator = {"use": "measurements", "layout": "position", "p_d": 0.9, "clutter_per_scan": 2.0, "position_std_m": 0.1, **parameters}
    return scene(overlay({**free, "simulator": None}, {**(top or {}), "simulator": simulator})).simulate(1)


def test_positions_without_errors_misses_and_clutter_are_the_truth():
    made = positions(p_d=1.0, position_std_m=0.0, clutter_per_scan=0.0)
    assert [(s.name, s.kind, s.space.names) for s in made.header.sensors] == [("position", "position", ("x_m", "y_m"))]
    for k, scan in enumerate(made.scans):
        assert sorted(map(tuple, scan.rows(0)[0])) == sorted(map(tuple, made.truth.position[k, made.truth.exists[k], :2]))


def test_positions_have_the_stated_errors_misses_and_clutter_over_the_floor():
    long = {"duration_s": 200.0, "sources": {"anna": {"intervals": [[0.0, 0.05]]}}}
    made = positions(long, p_d=0.7, clutter_per_scan=0.0, position_std_m=0.2)
    z = np.concatenate([s.rows(0)[0].reshape(-1, 2) for s in made.scans])
    assert len(z) / 2000 == pytest.approx(0.7, abs=4 * np.sqrt(0.21 / 2000))
    np.testing.assert_allclose(z.mean(axis=0), made.truth.position[0, 1, :2], atol=4 * 0.2 / np.sqrt(len(z)))
    np.testing.assert_allclose(np.cov(z.T), 0.04 * np.eye(2), atol=0.006)
    false = np.concatenate([s.rows(0)[0].reshape(-1, 2) for s in positions(long, p_d=0.0, clutter_per_scan=5.0).scans])
    assert len(false) / 2000 == pytest.approx(5.0, abs=4 * np.sqrt(5 / 2000))
    assert (false >= 0).all()
    np.testing.assert_allclose(false.mean(axis=0), [2.0, 1.5], atol=0.06)
    np.testing.assert_allclose(false.max(axis=0), [4.0, 3.0], atol=0.01)


def test_what_a_layout_does_not_read_is_refused():
    for wrong in (
        {"delay_std_s": 1e-4},
        {"position_std_m": None},
        {"region_m": [[0, 0], [1, 0]]},
        {"region_m": [[0, 0], [1, 1]]},
    ):
        with pytest.raises(TableError, match=next(iter(wrong))):
            positions(**wrong)
    with pytest.raises(TableError, match="position_std_m: layout 'stacked' does not read it"):
        simulate(position_std_m=1.0)


def test_the_plane_of_liang_2016_is_the_theses():
    made = Scene.load("liang2016-smc", registry()).simulate(1)
    truth = made.truth
    existing = [np.flatnonzero(column) + 1 for column in truth.exists.T]
    assert [(k[0], k[-1]) for k in existing] == [(2, 40), (2, 30), (11, 50)]
    for n, k in enumerate(existing):
        start = np.array([[400, 5, 400, 5], [440, -5, 440, 5], [350, 5, 350, -5.0]])[n]
        own = truth.position[k - 1, n, :2]
        np.testing.assert_allclose(own, start[[0, 2]] + start[[1, 3]] * (k - k[0])[:, None], atol=1e-9)
        assert (own > 100).all()
        assert (own < 700).all()
    np.testing.assert_array_equal(made.header.box_m, [[0, 0, 0], [800, 800, 0]])
    assert made.header.nominal == {"p_d": 0.95, "clutter_per_scan": 10.0, "position_std_m": 5.0}
