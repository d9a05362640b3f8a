"""Runs: the same results however they come about, kept work, tables, and what is refused."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pandas as pd
import pytest
from harness_study import PLUGIN, STUDY, write_study

from sonobench.errors import InputError
from sonobench.harness import open_run
from sonobench.harness.progress import Lines, Silent, Tally
from sonobench.harness.rows import SCORE_COLUMNS, TRIAL_COLUMNS
from sonobench.scene.study import Study

TWO = STUDY.replace("guesser = {}", 'guesser = {}\nother = { use = "guesser", tracker = { spread_m = 0.3 } }')


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def load(folder, study=TWO, plugin=PLUGIN, **options):
    return Study.load(write_study(folder, study, plugin), **options)


def run(study, out="run", **options):
    finished = study.run(out=out, **{"in_process": True, "display": Silent(), **options})
    assert len(finished.trials) >= len(finished.scores["trial_key"].unique())  # reads both tables before anything rewrites them
    return finished


def test_scores_are_the_same_for_one_and_two_jobs_a_reversed_plan_an_empty_cache_and_one_process(folder):
    study = load(folder)
    reference = run(study, "a").scores
    shutil.rmtree(folder / "cache")
    for number, options in enumerate([{"jobs": 1, "order": "reversed"}, {"jobs": 2}]):
        other = run(study, f"b{number}", in_process=False, fresh=True, **options).scores
        pd.testing.assert_frame_equal(reference, other, check_exact=True)
        shutil.rmtree(folder / "cache")


def test_every_planned_trial_is_a_row_in_the_contracts_columns(folder):
    finished = run(load(folder, TWO + "[sweep]\nscene.simulator.p_d = [0.5, 0.9]\npipelines.other.tracker.x_m = [1, 2]\n"))
    names = list(TRIAL_COLUMNS)
    at = names.index("dirty") + 1
    swept = ["p_scene.simulator.p_d", "p_pipelines.other.tracker.x_m"]
    assert list(finished.trials.columns) == [*names[:at], *swept, *names[at:]]
    assert list(finished.scores.columns) == list(SCORE_COLUMNS)
    assert len(finished.trials) == len(finished.scores) == 2 * 2 * 2 * 3
    assert finished.trials["trial_key"].is_unique
    assert set(finished.trials["pipeline"]) == {"guesser", "other[x_m=1]", "other[x_m=2]"}
    assert finished.failed == 0


def test_all_pipelines_see_the_same_recordings_and_repetitions_differ(folder):
    trials = run(load(folder)).trials
    assert (trials.groupby(["scene", "repetition"])["input_sha"].nunique() == 1).all()
    assert trials["input_sha"].nunique() == 4


def test_a_shared_front_end_runs_once_and_keeps_its_cost(folder):
    trials = run(load(folder)).trials
    assert len(list((folder / "cache/scans").glob("*.npz"))) == 4
    assert (trials.groupby("input_sha")["front_end_s"].nunique() == 1).all()
    assert (trials["front_end_s"] > 0).all()


def test_a_second_run_does_nothing_again_and_gives_the_same_tables(folder):
    first = run(load(folder))
    journal = (folder / "run/journal.jsonl").read_bytes()
    shutil.rmtree(folder / "cache")  # not even the recordings are needed
    second = run(load(folder))
    assert (folder / "run/journal.jsonl").read_bytes() == journal
    assert not list((folder / "cache").rglob("*.mcap"))
    pd.testing.assert_frame_equal(first.trials, second.trials)
    pd.testing.assert_frame_equal(first.scores, second.scores)


def test_an_added_pipeline_runs_alone(folder):
    first = run(load(folder, STUDY))
    second = run(load(folder))
    old = second.trials[second.trials["pipeline"] == "guesser"].reset_index(drop=True)
    pd.testing.assert_frame_equal(first.trials.drop(columns="dirty"), old.drop(columns="dirty"))


def test_an_edited_metric_is_scored_anew_and_nothing_else_runs(folder):
    first = run(load(folder))
    metric = PLUGIN.replace('{"": Series(values,', '{"": Series(2 * values,')
    tracker = run(load(folder, plugin=metric))
    # the plugin file holds trackers too, so its edit re-runs them: values are the same trial by trial, doubled
    np.testing.assert_allclose(tracker.scores["value"], 2 * first.scores["value"])
    written = {p.name: p.stat().st_mtime_ns for p in (folder / "run/estimates").iterdir()}
    run(load(folder, TWO.replace('["distance"]', '["distance", { use = "distance", better_at_zero = false }]'), metric))
    assert {p.name: p.stat().st_mtime_ns for p in (folder / "run/estimates").iterdir()} == written


def test_a_torn_last_line_of_the_journal_costs_only_that_line(folder):
    first = run(load(folder))
    journal = folder / "run/journal.jsonl"
    journal.write_bytes(journal.read_bytes()[:-30])
    second = run(load(folder))
    pd.testing.assert_frame_equal(first.scores, second.scores)
    assert all(json.loads(line) for line in journal.read_bytes().splitlines() if b'"recording"' in line)


def test_fresh_runs_everything_again(folder):
    run(load(folder))
    written = {p.name: p.stat().st_mtime_ns for p in (folder / "run/estimates").iterdir()}
    run(load(folder), fresh=True)
    again = {p.name: p.stat().st_mtime_ns for p in (folder / "run/estimates").iterdir()}
    assert again.keys() == written.keys()
    assert all(again[n] > written[n] for n in written)


def test_truth_reaches_neither_estimates_nor_their_keys(folder):
    from sonobench.log import Recording, open_recording, write_recording
    from sonobench.protocols import Rendering
    from sonobench.types import Truth

    run(load(folder))
    recording = open_recording(next((folder / "cache/recordings").glob("*.mcap")))
    truth = recording.truth
    moved = Truth(truth.time_s, truth.label, truth.position[::-1] + 0.3, truth.exists, truth.active, period_s=truth.period_s)
    content = (recording.header, tuple(recording.blocks()), tuple(recording.scans()))
    files = STUDY.replace('scenes = ["one.toml", "two.toml"]', 'recordings = ["*.mcap"]').replace("repetitions = 2", "repetitions = 1")
    found = []
    for held in (truth, moved):
        write_recording(folder / "take.mcap", Rendering(*content, held, {}, {}))
        found.append(run(load(folder, files)))
        found[-1] = (found[-1].trials, found[-1].scores, (found[-1].path / found[-1].trials["estimates_path"][0]).read_bytes())
    (trials, scores, estimates), (moved_trials, moved_scores, moved_estimates) = found
    assert isinstance(recording, Recording)
    assert trials["truth_sha"][0] != moved_trials["truth_sha"][0]
    assert trials["estimate_key"][0] == moved_trials["estimate_key"][0]
    assert estimates == moved_estimates
    assert scores["value"][0] != moved_scores["value"][0]


def test_runs_on_a_file_differ_by_their_number(folder):
    run(load(folder, STUDY.replace('"one.toml", ', "").replace("repetitions = 2", "repetitions = 1")), "a")
    shutil.copy(next((folder / "cache/recordings").glob("*.mcap")), folder / "take.mcap")
    finished = run(load(folder, STUDY.replace('scenes = ["one.toml", "two.toml"]', 'recordings = ["take.mcap"]')), "b")
    assert list(finished.trials["run"]) == [0, 1]
    assert finished.scores["value"].nunique() == 2


def test_a_metric_that_raises_costs_no_other_score_and_is_counted(folder, capsys):
    finished = run(load(folder, STUDY.replace('["distance"]', '["distance", "raising"]')))
    assert list(finished.unscored) == ["raising"]
    assert finished.failed == len(finished.trials) == len(finished.scores)
    assert "metric raising: ValueError: a metric's own fault (4 trials" in capsys.readouterr().err


def test_an_observer_sees_each_new_row_and_one_that_raises_is_a_warning(folder):
    watcher = "\n\n@hookimpl\ndef sonobench_trial_finished(row):\n    open('seen', 'a').write(row['trial_key'] + chr(10))\n    raise OSError('no')\n"
    with pytest.warns(UserWarning, match="observer .* raised OSError: no"):
        finished = run(load(folder, plugin=PLUGIN + watcher))
    assert sorted((folder / "seen").read_text().split()) == sorted(finished.trials["trial_key"])
    run(load(folder, plugin=PLUGIN + watcher))
    assert len((folder / "seen").read_text().split()) == len(finished.trials)


def test_a_second_run_in_the_same_folder_at_the_same_time_is_refused(folder):
    from sonobench.harness.run_folder import locked

    with locked(folder / "run"), pytest.raises(InputError, match="another run is writing here"):
        run(load(folder))


def test_a_folder_of_something_else_is_refused_and_left_alone(folder):
    (folder / "photos").mkdir()
    (folder / "photos/cat.txt").write_text("cat")
    with pytest.raises(InputError, match="no run's folder"):
        run(load(folder), "photos")
    assert [p.name for p in (folder / "photos").iterdir()] == ["cat.txt"]


def test_a_run_is_opened_by_its_folder_or_its_name_in_runs(folder):
    study = load(folder)
    finished = run(study, None)
    assert finished.path == folder / "runs/tiny"
    assert open_run("tiny").metrics == open_run("runs/tiny").metrics == ("distance",)
    assert len(open_run("tiny", folder / "runs/tiny").trials) == len(finished.trials)
    with pytest.raises(InputError, match="neither a run's folder nor a name"):
        open_run("nothing")
    with pytest.raises(InputError, match=r"no study\.json"):
        open_run(folder)


def test_an_interrupted_run_keeps_a_row_for_every_trial(folder):
    study = load(folder)

    class Interrupt(Silent):
        def __call__(self, tally: Tally) -> None:
            if tally.finished == 3:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(study, display=Interrupt())
    trials = open_run("run").trials
    assert list(trials["status"].value_counts().sort_index().items()) == [("ok", 3), ("skipped", 5)]
    assert (run(study).trials["status"] == "ok").all()


def test_progress_without_a_terminal_is_a_line(capsys):
    import sys

    with Lines(sys.stderr) as show:
        show(Tally(4, 3, 1, 0))
    assert "3 of 4 trials, 1 failed" in capsys.readouterr().err


def test_code_imported_by_a_computed_name_makes_a_trial_open_and_it_is_never_reused(folder, monkeypatch, capsys):
    (folder / "secret_helper_of_mine.py").write_text("GAIN = 1.0\n")
    monkeypatch.syspath_prepend(str(folder))
    sly = PLUGIN.replace(
        "state = state + self", "import importlib; importlib.import_module('secret_' + 'helper_of_mine'); state = state + self"
    )
    study = load(folder, STUDY, sly)
    assert run(study).trials["open"].all()
    assert "secret_helper_of_mine" in capsys.readouterr().err
    assert list(run(study).trials["attempts"]) == [2] * 4
    assert not run(load(folder, STUDY), "other").trials["open"].any()
