"""Trials repeated from nothing, and scores computed again from stored estimates."""

from __future__ import annotations

import json
from dataclasses import replace

import pandas as pd
import pytest
from harness_zoo import Zoo

from sonobench.cli import main
from sonobench.errors import InputError
from sonobench.harness import open_run
from sonobench.harness.progress import Silent
from sonobench.harness.verify import sample, verify_scores, verify_trials


@pytest.fixture
def zoo(tmp_path, monkeypatch):
    with Zoo.installed(tmp_path, monkeypatch) as made:
        yield made


def test_a_sample_is_a_share_of_the_trials_at_least_one_and_always_the_same():
    keys = [f"{n:032x}" for n in range(150)]
    assert len(sample(keys, 0.02)) == 3
    assert len(sample(keys, 0.001)) == 1
    assert sample(keys, 0.02) == sample(reversed(keys), 0.02)
    assert sorted(sample(keys, 1.0)) == keys
    assert set(sample(keys, 0.02)) < set(sample(keys, 0.5))
    assert sample([], 0.5) == []
    with pytest.raises(InputError, match="share of 2 cannot be verified"):
        sample(keys, 2)


def test_a_tracker_seeded_by_the_clock_is_found_and_the_others_are_the_same(zoo, capsys):
    zoo.study("plain", "clock")
    with pytest.raises(SystemExit) as end:
        main(["run", "zoos.toml", "--in-process", "--verify", "100%", "--json"])
    out, err = capsys.readouterr()
    assert end.value.code == 3
    verified = json.loads(out)["verified"]
    (finding,) = verified["findings"]
    assert (verified["checked"], finding["pipeline"]) == (2, "clock")
    assert "its estimates are others when it is repeated, from" in finding["fault"]
    assert "verified 2 of 2 trials: 1 finding" in err


@pytest.mark.study
def test_a_result_that_depends_on_the_trial_before_it_in_its_process_is_found(zoo):
    zoo.edit(
        "late_tracker.py", "from zoo.late import later; x_m = later(x_m)", "import zoo; zoo.count = x_m = getattr(zoo, 'count', 0.0) + 1"
    )
    study = replace(zoo.study("late"), repetitions=2)
    run = study.run(out="run", jobs=1, display=Silent())
    (finding,) = verify_trials(study, run.path, 1.0, jobs=1).findings
    assert finding["repetition"] == 1


@pytest.fixture
def run(zoo):
    return zoo.run("plain", "broken")


def test_scores_that_were_deleted_come_back_from_the_stored_estimates(run, capsys):
    board, scores = run.board(), run.scores
    (run.path / "scores.parquet").unlink()
    with pytest.raises(SystemExit) as end:
        main(["board", "run", "--verify", "--format", "json"])
    out, err = capsys.readouterr()
    assert end.value.code == 0
    assert "verified 2 of 2 trials: all the same" in err
    pd.testing.assert_frame_equal(open_run(run.path).scores, scores, check_exact=True)
    pd.testing.assert_frame_equal(open_run(run.path).board(), board)
    assert json.loads(out)


def test_one_altered_byte_of_an_estimate_is_found_and_so_is_a_missing_file(zoo, capsys):
    trials = zoo.run("plain", "late", "lazy").trials.set_index("pipeline")["estimates_path"]
    altered, missing = zoo.folder / "run" / trials["plain"], zoo.folder / "run" / trials["late"]
    content = bytearray(altered.read_bytes())
    content[len(content) // 2] ^= 1
    altered.write_bytes(content)
    missing.unlink()
    with pytest.raises(SystemExit) as end:
        main(["board", "run", "--verify"])
    err = capsys.readouterr().err
    assert end.value.code == 3
    assert f"estimates/{altered.name} was altered" in err
    assert f"estimates/{missing.name} is missing" in err
    assert "verified 3 of 3 trials: 2 findings" in err


def test_a_score_is_exact_where_the_environment_agrees_and_else_within_1e_9(zoo):
    run = zoo.run("plain", "late", "lazy")
    trials, scores = run.trials, run.scores
    here = trials["env_id"][0]
    off = {"plain": (1e-12, here), "late": (1e-12, "elsewhere"), "lazy": (1e-8, "elsewhere")}
    pipeline = scores["trial_key"].map(dict(zip(trials["trial_key"], trials["pipeline"], strict=True)))
    scores.assign(value=scores["value"] * (1 + pipeline.map(lambda p: off[p][0]).astype(float))).to_parquet(run.path / "scores.parquet")
    trials.assign(env_id=trials["pipeline"].map(lambda p: off[p][1])).to_parquet(run.path / "trials.parquet")
    found = verify_scores(run.path, jobs=1).findings
    assert [f["pipeline"] for f in found] == ["plain", "lazy"]
    assert all(f["fault"].startswith("east: value 1.0000") for f in found)
