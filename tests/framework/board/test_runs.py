"""Several runs as one board."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from board_runs import grid, run

from sonobench.board import leaderboard, render, same_entries, together
from sonobench.errors import InputError

RNG = np.random.default_rng(9)
VALUES = {p: grid(lambda s, r: float(RNG.normal()), 8, 2) for p in "abc"}
TRIALS, SCORES = run(VALUES)
TRIALS["estimate_key"] = "e/" + TRIALS["trial_key"]


def board(*parts):
    return render(leaderboard(*together(*zip(*parts, strict=True), [f"run{k}" for k in range(len(parts))]), "ospa", vs="a"), "csv")


def shard(k, of):
    keep = TRIALS.index % of == k
    keys = set(TRIALS.loc[keep, "trial_key"])
    return TRIALS.assign(status=np.where(keep, "ok", "skipped")), SCORES[SCORES["trial_key"].isin(keys)]


WHOLE = board((TRIALS, SCORES))


def test_shards_that_leave_each_others_trials_unrun_make_the_board_of_the_whole_run():
    assert board(*(shard(k, 4) for k in (2, 0, 3, 1))) == WHOLE


def test_shards_that_hold_their_own_trials_alone_do_so_too():
    parts = [(TRIALS[TRIALS["trial_key"].isin(s["trial_key"])], s) for _, s in (shard(k, 4) for k in range(4))]
    assert board(*parts) == WHOLE


def test_a_run_given_twice_counts_once():
    assert board((TRIALS, SCORES), (TRIALS, SCORES)) == WHOLE


def test_a_trial_that_failed_in_one_run_and_is_ok_in_the_other_is_ok_with_that_runs_scores():
    bad = TRIALS["trial_key"].isin(["b/room1/0", "c/room2/1"])
    failed = TRIALS.assign(status=np.where(bad, "oom", "ok"), estimate_key=np.where(bad, "", TRIALS["estimate_key"]))
    empty = SCORES.assign(value=np.where(SCORES["trial_key"].isin(TRIALS.loc[bad, "trial_key"]), 99.0, SCORES["value"]))
    assert board((failed, empty), (TRIALS, SCORES)) == WHOLE
    assert board((TRIALS, SCORES), (failed, empty)) == WHOLE
    assert board((failed, empty), (failed, empty)) == board((failed, empty))


def test_scores_of_a_metric_that_only_one_of_two_equal_runs_has_are_kept():
    trials, scores = together([TRIALS, TRIALS], [SCORES, SCORES.assign(metric="gospa")], ["x", "y"])
    assert len(trials) == len(TRIALS)
    assert scores.groupby("metric").size().tolist() == [len(SCORES)] * 2


def test_other_results_of_the_same_trial_are_refused_with_both_runs():
    other = TRIALS.assign(estimate_key="new")
    with pytest.raises(InputError, match=r"48 trials.*different results in run0 and run1"):
        board((TRIALS, SCORES), (other, SCORES))


def test_tables_with_a_trial_twice_are_refused_by_the_board_itself():
    with pytest.raises(InputError, match="48 trials stand there twice"):
        leaderboard(pd.concat([TRIALS, TRIALS]), SCORES, "ospa")


def test_one_name_for_two_pipelines_is_refused():
    one = {"mine": {"table": {"use": "pipeline", "x": 1}, "roles": {}}}
    assert same_entries([one, one, {}], ["x", "y", "z"]) == one
    with pytest.raises(InputError, match="'mine' has other parameters in y than in x"):
        same_entries([one, {"mine": {"table": {"use": "pipeline", "x": 2}, "roles": {}}}], ["x", "y"])


def test_runs_of_other_seeds_add_repetitions_and_stay_paired():
    one = TRIALS.assign(input_sha="s" + TRIALS["scene"] + TRIALS["repetition"].astype(str))
    two = one.assign(trial_key="2" + one["trial_key"], input_sha="t" + one["input_sha"], estimate_key="2" + one["estimate_key"])
    trials, scores = together([one, two], [SCORES, SCORES.assign(trial_key="2" + SCORES["trial_key"])], ["x", "y"])
    found = leaderboard(trials, scores, "ospa")
    assert (found.attrs["units"], found.attrs["repetitions"]) == (8, 4)
    np.testing.assert_allclose(found["mean"], leaderboard(TRIALS, SCORES, "ospa")["mean"])
