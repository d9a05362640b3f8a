"""The exact update for targets with several detections against its definition, and what must hold whatever the numbers."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from filtering_partitions import listed
from hypothesis import given, settings
from hypothesis import strategies as st
from phd_scenes import scans, setup

from sonobench.filtering import multidetection
from sonobench.filtering.multidetection import evidence, factors
from sonobench.filtering.phd import reweigh
from sonobench_plugins.measurement.tdoa import Tdoa
from sonobench_plugins.motion.langevin import Langevin


def numbers(seed: int, n: int, modes: int, m: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Weights, p g, 1 − p and clutter over several decades."""
    rng = np.random.default_rng(seed)
    pg = rng.exponential(size=(n, modes, m)) * rng.choice([1e-3, 1.0, 1e3], size=(n, modes, m))
    found = rng.uniform(0.01, 0.5, n), pg, rng.uniform(0.05, 0.9, (n, modes)), rng.exponential(size=m)
    for array in found:
        array.flags.writeable = False
    return found


def solved(w, pg, miss, kappa, **options):
    with np.errstate(divide="ignore"):
        return factors(np.log(w), np.log(pg), np.log(miss), np.log(kappa), **options)


@pytest.mark.parametrize("modes", [1, 2, 3, 5])
@pytest.mark.parametrize("m", [0, 1, 2, 3, 4, 6])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_factors_equal_a_sum_over_all_listed_partitions(seed, m, modes):
    found = numbers(seed, 3, modes, m)
    np.testing.assert_allclose(solved(*found, cut=0.0).factor, listed(*found), rtol=1e-12)


@pytest.mark.parametrize("force", ["sparse", "hashed"])
def test_every_table_gives_the_same(monkeypatch, force):
    found = numbers(3, 4, 3, 5)
    if force == "sparse":
        monkeypatch.setattr(multidetection, "DENSE_ROWS", 0)
    else:  # 25 rows that hang together by pairs need hashes throughout
        found = [np.concatenate([a] * 5, axis=-1) if a.shape[-1:] == (5,) else a for a in found]
        pg = np.zeros((20, 3, 25))
        for k in range(5):
            pg[4 * k : 4 * k + 4, :, 5 * k : 5 * k + 5] = found[1][:, :, :5]
        found = [np.tile(found[0], 5), pg, np.tile(found[2], (5, 1)), found[3]]
    one = numbers(3, 4, 3, 5)
    factor = solved(*found, cut=0.0).factor
    np.testing.assert_allclose(factor, np.tile(listed(*one), len(factor) // 4), rtol=1e-12)


def test_with_one_mode_it_is_the_phd_filter():
    w, pg, miss, kappa = numbers(5, 6, 1, 7)
    expected = miss[:, 0] + (pg[:, 0] / (kappa + w @ pg[:, 0])).sum(axis=1)
    np.testing.assert_allclose(solved(w, pg, miss, kappa, cut=0.0).factor, expected, rtol=1e-12)


def test_a_joint_update_of_two_sensors_is_bayes_rule_where_one_target_exists_at_most():
    """Poisson targets whose intensity is so small that two never exist: every hypothesis of a Bernoulli target, listed."""
    rng = np.random.default_rng(11)
    rows_of = [[0, 1], [2]]  # sensor 0 has two rows, sensor 1 one
    n, w = 4, np.full(4, 1e-9)
    p, kappa = rng.uniform(0.3, 0.9, (n, 2)), rng.exponential(size=3)
    g = rng.exponential(size=(n, 3))
    pg = np.zeros((n, 2, 3))
    for q, rows in enumerate(rows_of):
        pg[:, q, rows] = p[:, q, None] * g[:, rows]
    by_sensor = [(1 - p[:, q]) + sum(p[:, q] * g[:, z] / kappa[z] for z in rows) for q, rows in enumerate(rows_of)]
    np.testing.assert_allclose(solved(w, pg, 1 - p, kappa, cut=0.0).factor, by_sensor[0] * by_sensor[1], rtol=1e-7)


def test_a_joint_update_of_two_sensors_is_the_full_sum_over_two_poisson_targets_worth_of_hypotheses():
    """Two sensors, two rows each, intensities of order one: the sum over all partitions with at most one row a sensor."""
    rng = np.random.default_rng(12)
    n, w, kappa = 3, rng.uniform(0.2, 0.6, 3), rng.exponential(size=4)
    p = rng.uniform(0.3, 0.9, (n, 2))
    pg = np.zeros((n, 2, 4))
    pg[:, 0, :2], pg[:, 1, 2:] = p[:, :1] * rng.exponential(size=(n, 2)), p[:, 1:] * rng.exponential(size=(n, 2))
    alone = [w @ (pg[:, q, z] * (1 - p[:, 1 - q])) + kappa[z] for z, q in ((0, 0), (1, 0), (2, 1), (3, 1))]
    pair = {(i, j): w @ (pg[:, 0, i] * pg[:, 1, j]) for i, j in itertools.product((0, 1), (2, 3))}
    matchings = [[], *[[e] for e in pair], [(0, 2), (1, 3)], [(0, 3), (1, 2)]]

    def weight(matching: list[tuple[int, int]], without: tuple[int, ...] = ()) -> float:
        used = {z for e in matching for z in e} | set(without)
        return float(np.prod([pair[e] for e in matching]) * np.prod([alone[z] for z in range(4) if z not in used]))

    def rest(without: tuple[int, ...]) -> float:
        return sum(weight(e, without) for e in matchings if not {z for one in e for z in one} & set(without))

    whole = rest(())
    expected = (1 - p).prod(axis=1)
    for z, q in ((0, 0), (1, 0), (2, 1), (3, 1)):
        expected = expected + pg[:, q, z] * (1 - p[:, 1 - q]) * rest((z,)) / whole
    for i, j in pair:
        expected = expected + pg[:, 0, i] * pg[:, 1, j] * rest((i, j)) / whole
    np.testing.assert_allclose(solved(w, pg, 1 - p, kappa, cut=0.0).factor, expected, rtol=1e-12)


def test_the_evidence_of_one_sensor_gives_the_phd_filters_weights_and_that_of_four_keeps_their_rows_apart():
    rng = np.random.default_rng(0)
    where = setup(stacked=False, clutter=1.5)
    model = Tdoa().bind(Langevin().space, where)
    x = rng.uniform(0, 3, (50, 4))
    log_w = np.full(50, np.log(2 / 50))
    scan = scans(rng, stacked=False, clutter=1.5)[20]
    for q in range(4):
        found = factors(log_w, *evidence(x, scan, model, where, (q,)), cut=0.0)
        np.testing.assert_allclose(log_w + np.log(found.factor), reweigh(log_w, x, model.h(x, q)[:, 0], scan, model, q)[0], rtol=1e-12)
    log_pg, log_miss, log_kappa = evidence(x, scan, model, where, (0, 1, 2, 3))
    counts = [int((scan.detections[0].sensor == q).sum()) for q in range(4)]
    assert log_pg.shape == (50, 4, sum(counts)) == (50, 4, len(log_kappa))
    assert log_miss.shape == (50, 4)
    own = np.repeat(np.arange(4), counts)
    for q in range(4):
        assert np.isneginf(log_pg[:, q, own != q]).all()
        assert not np.isneginf(log_pg[:, q, own == q]).any()


@given(seed=st.integers(0, 10_000), modes=st.integers(1, 4), m=st.integers(1, 7))
@settings(max_examples=40, deadline=None)
def test_rows_and_modes_may_come_in_any_order_and_the_mass_is_at_most_one_target_a_row(seed, modes, m):
    w, pg, miss, kappa = numbers(seed, 5, modes, m)
    found = solved(w, pg, miss, kappa, cut=0.0, explain=True)
    rng = np.random.default_rng(seed)
    rows, order = rng.permutation(m), rng.permutation(modes)
    turned = solved(w, pg[:, order][:, :, rows], miss[:, order], kappa[rows], cut=0.0, explain=True)
    np.testing.assert_allclose(turned.factor, found.factor, rtol=1e-11)
    np.testing.assert_allclose(turned.explained, found.explained[:, rows], rtol=1e-9)
    detected = w @ (found.factor - found.missed)
    assert -1e-12 <= detected <= m + 1e-9
    assert (w @ found.explained <= 1 + 1e-9).all()  # a row has one origin
    assert (found.factor - found.missed <= found.explained.sum(axis=1) * (1 + 1e-9)).all()


@given(seed=st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_a_cut_changes_no_factor_by_much_more_than_itself(seed):
    rng = np.random.default_rng(seed)
    x, z = rng.uniform(-1, 1, (40, 2)), rng.uniform(-1, 1, 7)
    h = x @ rng.normal(size=(2, 3))
    pg = 0.6 * np.exp(-0.5 * ((z - h[:, :, None]) / 0.05) ** 2) / 0.125
    args = np.full(40, 0.05), pg, np.full((40, 3), 0.4), np.full(7, 0.8)
    exact, cut = solved(*args, cut=0.0), solved(*args, cut=1e-6)
    np.testing.assert_allclose(cut.factor, exact.factor, rtol=1e-4)


def test_too_ambiguous_a_scan_raises_the_cut_and_says_so():
    found = numbers(1, 8, 4, 9)
    assert solved(*found, cut=0.0).cut == 0.0
    for most_work in (2000, 20):
        less = solved(*found, cut=0.0, most_work=most_work)
        assert less.cut > 0 or less.left_out > 0
        assert np.isfinite(less.factor).all()


def test_a_scan_in_which_everybody_may_have_caused_everything_is_updated_within_a_moment():
    rng = np.random.default_rng(3)
    pg = rng.uniform(0.5, 2.0, (1000, 4, 120))
    found = solved(np.full(1000, 3e-3), pg, np.full((1000, 4), 0.4), np.ones(120))
    assert found.left_out >= 58
    assert np.isfinite(found.factor).all()
    assert 0 < 3e-3 * (found.factor - found.missed).sum() <= 120


def test_rows_that_nobody_can_cause_change_nothing_but_count_as_clutter():
    w, pg, miss, kappa = numbers(2, 4, 2, 3)
    more = np.concatenate([pg, np.zeros((4, 2, 80))], axis=2)
    found = solved(w, more, miss, np.concatenate([kappa, np.zeros(40), np.ones(40)]), explain=True, cut=0.0)
    np.testing.assert_allclose(found.factor, listed(w, pg, miss, kappa), rtol=1e-12)
    assert found.explained.shape == (4, 83)


def test_a_particle_without_weight_has_a_factor():
    w, pg, miss, kappa = numbers(4, 4, 2, 3)
    w = np.where(np.arange(4) == 2, 0.0, w)
    np.testing.assert_allclose(solved(w, pg, miss, kappa, cut=0.0).factor, listed(w, pg, miss, kappa), rtol=1e-12)


def test_of_more_than_62_rows_the_likeliest_are_kept_and_the_others_counted():
    w, pg, miss, kappa = numbers(6, 4, 2, 3)
    unlikely = np.full((4, 2, 70), 1e-9)
    found = solved(w, np.concatenate([unlikely, pg], axis=2), miss, np.concatenate([np.ones(70), kappa]), cut=0.0, explain=True)
    assert found.left_out == 11
    np.testing.assert_allclose(found.factor, listed(w, pg, miss, kappa), rtol=1e-6)
    assert (found.explained[:, 70:] > 0).all()


def test_bad_input_says_what_came_and_what_is_needed():
    w, pg, miss, kappa = numbers(2, 4, 2, 3)
    with pytest.raises(ValueError, match=r"log_kappa \(2,\).*do not fit log_pg \(4, 2, 3\)"):
        solved(w, pg, miss, kappa[:2])
    assert len(solved(w[:0], pg[:0], miss[:0], kappa).factor) == 0
