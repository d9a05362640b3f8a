"""Which trials are shown, and where their recordings come from."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from board_runs import run
from scoring_scenes import XY, estimates, truth

from sonobench.errors import InputError
from sonobench.log import write_estimates, write_recording
from sonobench.protocols import Rendering
from sonobench.report import choose, write_report
from sonobench.types import Header

VALUES = {("a", 0): 0.5, ("a", 1): 0.1, ("b", 0): 0.9, ("b", 1): 0.3}


def test_best_median_and_worst_are_those_of_the_metric():
    trials, scores = run({"p": VALUES})
    assert choose(trials, scores, "ospa") == {"p": {"best": "p/a/1", "median": "p/b/1", "worst": "p/b/0"}}
    higher = choose(*run({"p": VALUES}, better="higher"), "ospa")
    assert higher == {"p": {"best": "p/b/0", "median": "p/a/0", "worst": "p/a/1"}}


def test_trials_without_an_output_are_not_chosen_and_undefined_ones_are_the_worst():
    values = VALUES | {("b", 0): (math.nan, 0.0, 0.0)}
    found = choose(*run({"p": values, "dead": {("a", 0): 1.0}}, failed=[("p", "a", 1), ("dead", "a", 0)]), "ospa")
    assert found == {"p": {"best": "p/b/1", "median": "p/a/0", "worst": "p/b/0"}}


def test_one_trial_is_all_three():
    assert set(choose(*run({"p": {("a", 0): 1.0}}), "ospa")["p"].values()) == {"p/a/0"}


def test_a_metric_that_is_not_there_is_refused():
    with pytest.raises(InputError, match=r"'gospa'.*\['ospa'\]"):
        choose(*run({"p": VALUES}), "gospa")


@pytest.fixture
def finished(tmp_path, monkeypatch):
    """A run of two trials on one cached recording."""
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    (tmp_path / "cache" / "recordings").mkdir(parents=True)
    (tmp_path / "run" / "estimates").mkdir(parents=True)
    header = Header(name="a", duration_s=3.0, box_m=[[0, 0, 0], [3, 3, 3]])
    rendering = Rendering(header, (), (), truth(np.ones((3, 1, 2))), {}, {})
    write_recording(tmp_path / "cache" / "recordings" / "rec.mcap", rendering)
    write_estimates(tmp_path / "run" / "estimates" / "t.mcap", estimates([[[1, 1]]] * 3), XY, {})
    trials, scores = run({"p": {("a", 0): 0.5}, "q": {("a", 0): 0.6}}, failed=[("q", "a", 0)])
    trials = trials.assign(recording_key="rec", truth_sha="", exc_message="boom", estimates_path=["estimates/t.mcap", ""])
    return SimpleNamespace(path=tmp_path / "run", paths=(tmp_path / "run",), metrics=("ospa",), trials=trials, scores=scores)


def test_the_report_draws_each_pipelines_trials_once_with_all_their_names(finished):
    written = write_report(finished)
    assert [p.parent for p in written] == [finished.path / "report"] * 3
    assert written[0].name == "p_best+median+worst_a_rep_0_p_a_0-room.png"


def test_a_trial_can_be_asked_for_by_the_head_of_its_key(finished, tmp_path):
    assert len(write_report(finished, trials=["p/a"], out=tmp_path / "else" / "where")) == 3
    with pytest.raises(InputError, match="--trial x: 0 trials"):
        write_report(finished, trials=["x"])
    with pytest.raises(InputError, match=r"q on a.*no estimates: error boom"):
        write_report(finished, trials=["q"])


def test_pipelines_that_end_at_their_scans_are_passed_over_and_said_to_be_so_when_asked_for(finished):
    trials = finished.trials.assign(status="ok", estimates_path=["estimates/t.mcap", "estimates/q.npz"])
    (finished.path / "estimates" / "q.npz").write_bytes(b"scans")
    finished.trials = trials
    assert len(write_report(finished)) == 3
    with pytest.raises(InputError, match=r"q on a.*ends at its scans"):
        write_report(finished, trials=["q"])
    finished.trials = trials.assign(estimates_path="")
    with pytest.raises(InputError, match="no trial has estimates"):
        write_report(finished)
