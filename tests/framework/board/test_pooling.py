"""Unit values, what they are pooled from, and resampling them."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from board_runs import grid, run

from sonobench.board import leaderboard, statistics
from sonobench.board.bootstrap import bootstrap
from sonobench.board.pooling import Parts, Units, influences, units
from sonobench.board.rows import coded, joined

RNG = np.random.default_rng(6)


def pooled(values, pool="mean", **more):
    trials, scores = run(values, pool=pool, **more)
    return units(joined(coded(trials), pd.Index(trials["trial_key"]), scores), pool)


def parts(n, pipelines, slices, root):
    w = RNG.uniform(1, 3, (n, pipelines, slices))
    w.flags.writeable = False
    return Parts(w, w * RNG.uniform(0, 2, w.shape), root)


@pytest.mark.parametrize("root", [False, True])
def test_each_resample_is_pooled_again_as_if_its_units_had_been_measured(root):
    mine = parts(7, 2, 3, root)
    counts = RNG.multinomial(7, np.full(7, 1 / 7), 5).astype(float)
    found = influences(mine, counts)[0]
    for b, row in enumerate(counts.astype(int)):
        drawn = np.repeat(np.arange(7), row)
        ratio = mine.wy[drawn].sum(0) / mine.w[drawn].sum(0)
        np.testing.assert_allclose(found[b], (np.sqrt(ratio) if root else ratio).mean(-1))


@pytest.mark.parametrize("root", [False, True])
def test_the_influence_of_a_unit_is_the_derivative_by_its_count(root):
    mine, counts, step = parts(5, 2, 4, root), np.array([[2.0, 0, 1, 1, 1]]), 1e-6
    value, influence = influences(mine, counts)
    for i in range(5):
        moved = influences(mine, counts + step * np.eye(5)[i])[0]
        np.testing.assert_allclose((moved - value)[0] / step, influence[0, i], rtol=1e-4, atol=1e-6)


def test_repetitions_of_one_scenario_with_equal_weights_are_resampled_as_their_mean():
    found = pooled({"a": grid(lambda s, r: float(r), 1, 8)})
    assert (found.over, found.parts) == ("repetitions", None)
    np.testing.assert_array_equal(found.values[:, 0], np.arange(8))


def test_the_interval_of_an_rms_over_repetitions_comes_from_resampled_rms_not_from_a_linearisation():
    values = grid(lambda s, r: float(np.exp(r / 3)), 1, 9)
    exact = pooled({"a": values}, "rms")
    linear = Units(exact.values, exact.pipelines, exact.over, exact.groups)
    np.testing.assert_allclose(bootstrap(exact).value, bootstrap(linear).value)
    np.testing.assert_allclose(bootstrap(exact).error, bootstrap(linear).error)
    ends = [statistics.intervals(bootstrap(mine))[0].high for mine in (exact, linear)]
    assert abs(ends[0] / ends[1] - 1) > 0.05


def test_intervals_of_an_rms_over_repetitions_cover_it():
    truth, hits = np.sqrt(1.25), []
    for _ in range(200):
        mine = Parts(np.ones((10, 1, 1)), RNG.normal(1, 0.5, (10, 1, 1)) ** 2, True)
        value, influence = influences(mine, np.ones((1, 10)))
        low, high, _ = statistics.intervals(
            bootstrap(Units(value + 10 * influence[0], np.zeros(1, int), "repetitions", np.arange(10), mine))
        )[0]
        hits.append(low <= truth <= high)
    assert 0.89 <= np.mean(hits) <= 0.99


def test_a_scenario_is_a_scene_with_its_swept_values_and_pools_its_own_repetitions():
    tables = [run({"a": grid(lambda s, r, k=k: 10.0 * k + s + r / 2, 3, 2)}, **{"p_scene.noise.snr_db": 10.0 * k}) for k in (0, 1)]
    trials, scores = (
        pd.concat([t.assign(trial_key=t["trial_key"] + str(k)) for k, t in enumerate(side)]) for side in zip(*tables, strict=True)
    )
    found = units(joined(coded(trials), pd.Index(trials["trial_key"]), scores), "mean")
    assert sorted(found.values[:, 0].tolist()) == [0.25, 1.25, 2.25, 10.25, 11.25, 12.25]
    assert np.bincount(found.groups).tolist() == [2, 2, 2]


def test_a_pipelines_own_swept_parameter_makes_no_scenario():
    trials, _ = run({"mine": grid(lambda s, r: 1.0, 3, 2)}, **{"p_pipelines.mine.floor": 1.0})
    assert len(coded(trials).scene) == 3


def test_repetitions_of_runs_with_other_seeds_are_other_blocks_and_a_rendering_that_failed_stays_in_its_own():
    one, two = (run({p: grid(lambda s, r: 1.0, 2, 2) for p in "ab"})[0].assign(input_sha=[f"{k}{i % 4}" for i in range(8)]) for k in "xy")
    both = pd.concat([one, two.assign(trial_key="2" + two["trial_key"])], ignore_index=True)
    assert len(np.unique(coded(one).block)) == 4
    assert len(np.unique(coded(both).block)) == 8
    both.loc[both["trial_key"] == "b/room0/0", "input_sha"] = ""
    assert len(np.unique(coded(both).block)) == 8
    one["input_sha"] = ""
    assert len(np.unique(coded(one).block)) == 4


def test_scenarios_of_one_scene_that_differ_alike_are_reported_with_how_much_larger_the_error_is():
    rng = np.random.default_rng(3)
    scene = rng.normal(size=12)

    def board(spread):
        own = {(k, s): scene[s] + spread * rng.normal() for k in (0, 1) for s in range(12)}
        tables = [
            run({"a": grid(lambda s, r: 0.0, 12, 1), "b": grid(lambda s, r, k=k: own[k, s], 12, 1)}, **{"p_scene.noise.snr_db": k})
            for k in (0, 1)
        ]
        return leaderboard(
            *(pd.concat([t.assign(trial_key=t["trial_key"] + str(k)) for k, t in enumerate(side)]) for side in zip(*tables, strict=True)),
            "ospa",
        )

    alike, apart = (" ".join(board(spread).attrs["notes"]) for spread in (0.01, 10.0))
    assert "standard error of a difference is 1.4 times as large" in alike
    assert "times as large" not in apart
    assert "24 of 12 scenes" in alike
    assert "24 of 12 scenes" in apart


def test_the_design_effect_is_the_error_of_group_means_over_that_of_units():
    groups, d = np.repeat(np.arange(6), 3), RNG.normal(size=(18, 2)) + np.repeat(RNG.normal(size=(6, 1)), 3, axis=0)
    means = d.reshape(6, 3, 2).mean(1)
    expected = (means.std(0, ddof=1) / np.sqrt(6)) / (d.std(0, ddof=1) / np.sqrt(18))
    np.testing.assert_allclose(statistics.design_effect(d, groups), expected)
    np.testing.assert_array_equal(statistics.design_effect(d, np.arange(18)), [1, 1])


def test_many_units_are_resampled_in_chunks_with_the_same_answer_each_time():
    x = RNG.normal(size=(300, 2))
    mine = Units(x, np.arange(2), "scenarios", np.arange(300))
    first, second = bootstrap(mine), bootstrap(mine)
    np.testing.assert_array_equal(first.values, second.values)
    low, high, _ = statistics.intervals(first)[0]
    assert high - low == pytest.approx(2 * 1.96 / np.sqrt(300), rel=0.1)


def test_equal_output_is_equal_though_sums_round():
    a = RNG.normal(0.4, 0.1, 9)
    table = leaderboard(*run({"a": grid(lambda s, r: a[s], 9, 1), "b": grid(lambda s, r: a[s] + 2e-16, 9, 1)}), "ospa", vs="a")
    assert table["tie"].tolist() == ["a", "a"]
    assert table["rank"].tolist() == [1, 1]
    assert table["diff_p"].tolist()[1] == 1.0
