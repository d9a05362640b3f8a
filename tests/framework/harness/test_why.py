"""What `why` says: what made a trial, what changed since, why a row is open, and the command that repeats it."""

from __future__ import annotations

import json
import shlex

import pytest
from harness_zoo import Zoo

from sonobench.cli import main
from sonobench.errors import InputError
from sonobench.harness import open_run
from sonobench.harness.why import explain


@pytest.fixture
def zoo(tmp_path, monkeypatch):
    with Zoo.installed(tmp_path, monkeypatch) as made:
        yield made


def asked(zoo, trial):
    zoo.forget()
    return explain(zoo.folder / "run", trial)


def told(capsys, *arguments):
    with pytest.raises(SystemExit) as end:
        main(arguments)
    return end.value.code, capsys.readouterr().out


def test_it_says_what_made_a_trial_and_that_nothing_changed(zoo):
    run = zoo.run("plain")
    found = asked(zoo, run.trials["trial_key"][0][:6])
    assert found["changed"] == []
    assert found["verdict"] == "the next run keeps it"
    assert found["scores"] == {"east": "stored"}
    made_of = found["made_of"]
    assert made_of["scene"]["table"]["duration_s"] == 1.0
    assert made_of["pipeline"]["tracker"] == {"use": "plain", "x_m": 1.0}
    assert {"zoo.helper", "zoo.deep", "sonobench.types"} <= set(made_of["code"]["tracker"]["modules"])
    assert "numpy" in made_of["code"]["tracker"]["distributions"]
    assert isinstance(made_of["seed"], int)


def test_it_names_each_part_that_changed(zoo):
    zoo.run("plain", "wheel", "declared")
    zoo.edit("deep.py", "return x", "return 1 + x")
    zoo.edit("helper.py", "from .deep", "import zoo.late\nfrom .deep")
    zoo.release("2.0")
    (zoo.package / "table.txt").write_text("3.0")
    plain, wheel, declared = (asked(zoo, f"{name}/one/0") for name in ("plain", "wheel", "declared"))
    assert plain["changed"] == [
        "code of the tracker: module zoo.deep was edited",
        "code of the tracker: module zoo.helper was edited",
        "code of the tracker: module zoo.late is new",
    ]
    assert plain["verdict"] == "the next run repeats what depends on the change"
    assert wheel["changed"] == ["code of the tracker: distribution stuff_of_a_wheel 1.0 → 2.0"]
    assert declared["changed"] == ["code of the tracker: file table.txt was edited"]


def test_it_names_the_module_of_an_edited_metric_and_says_that_only_scores_are_computed_again(zoo):
    zoo.edit("metric.py", "from sonobench import Series", "from sonobench import Series\nfrom zoo.deep import deep")
    zoo.run("late", "broken")
    zoo.edit("metric.py", "values * 1.0", "deep(values) * 1.0")
    for pipeline in ("late", "broken"):
        found = asked(zoo, f"{pipeline}/one/0")
        assert found["changed"] == ["code of the metric east: module zoo.metric was edited"]
        assert found["verdict"] == "the next run keeps its output and scores it again (east)"
        assert "not there" in found["scores"]["east"]
    zoo.run("late", "broken")
    assert asked(zoo, "late/one/0")["changed"] == []
    zoo.edit("deep.py", "return x", "return 1 + x")  # compared is what scored it last
    assert asked(zoo, "late/one/0")["changed"] == ["code of the metric east: module zoo.deep was edited"]


def test_it_names_what_changed_in_the_tables(zoo):
    zoo.run("plain")
    scene = zoo.folder / "one.toml"
    scene.write_text(scene.read_text().replace("p_d = 0.9", "p_d = 0.8"))
    zoo.edit("plain_tracker.py", "x_m: float = 1.0", "x_m: float = 2.0")
    found = asked(zoo, "plain/one/0")
    assert "scene.simulator.p_d: 0.9 → 0.8" in found["changed"]
    assert "pipeline.tracker.x_m: 1.0 → 2.0" in found["changed"]
    assert "plans another trial in its place" in found["verdict"]


def test_it_names_the_file_or_module_that_keeps_a_row_open(zoo, capsys):
    zoo.run("reading", "computed")
    assert asked(zoo, "reading/one/0")["open_because"] == [f"file {zoo.package / 'secret.txt'}"]
    code, text = told(capsys, "why", "computed/one/0", "run")
    assert code == 0
    assert "open       module zoo.hidden" in text
    assert "it is open: the next run repeats it" in text


def test_it_shows_the_traceback_and_its_command_repeats_this_one_trial(zoo, capsys):
    run = zoo.run("plain", "broken", in_process=False, jobs=1, timeout_s=60)
    key = dict(zip(run.trials["pipeline"], run.trials["trial_key"], strict=True))["broken"]
    code, text = told(capsys, "why", "broken/one/0", "run")
    assert code == 0
    for words in (
        "error, attempt 1, limits 60 s",
        "RuntimeError: a bug of mine",
        'broken_tracker.py", line',
        f"--trial {key} --in-process",
    ):
        assert words in text, words
    command = shlex.split(text.rstrip().splitlines()[-1])
    assert command[0] == "sonobench"
    zoo.forget()
    with pytest.raises(SystemExit) as end:
        main(command[1:])
    assert end.value.code == 3
    again = open_run(f"zoos-{key[:8]}").trials
    assert list(again["trial_key"]) == [key]
    assert again["exc_message"][0] == "a bug of mine"
    assert len(open_run(zoo.folder / "run").trials) == 2


def test_a_run_in_one_process_keeps_tracebacks_of_trials_and_metrics_and_prints_them_too(zoo, capsys):
    zoo.edit("metric.py", "values * 1.0", "values / []")
    run = zoo.run("broken", "plain")
    assert capsys.readouterr().err.count("RuntimeError: a bug of mine") == 1
    row = run.trials.set_index("pipeline").loc["broken"]
    assert row["log_path"] == f"logs/{row['trial_key']}.log"
    traceback = asked(zoo, "broken/one/0")["failure"]["traceback"]
    assert traceback[0] == "Traceback (most recent call last):"
    assert traceback[-1] == "RuntimeError: a bug of mine"
    plain = run.trials.set_index("pipeline").loc["plain"]
    assert plain["log_path"] == ""
    assert "ValueError" in (run.path / f"logs/score-{plain['trial_key']}.log").read_text()
    zoo.edit("broken_tracker.py", "raise RuntimeError('a bug of mine')", "pass")
    assert set(zoo.run("broken").trials["log_path"]) == {""}
    assert not (run.path / row["log_path"]).exists()


def test_its_command_names_what_the_run_was_given_beside_the_study(zoo, capsys):
    from sonobench.harness.progress import Silent
    from sonobench.scene.study import Study

    zoo.study("plain")
    study = Study.load("zoos.toml", also=["late"], repetitions=2, seed=7)
    study.run(out=zoo.folder / "run", in_process=True, display=Silent())
    command = asked(zoo, "late/one/1")["command"]
    assert "--also late --repetitions 2 --seed 7 --trial" in command
    code, text = told(capsys, *shlex.split(command)[1:], "--dry-run", "--json")
    assert code == 0
    assert [(t["pipeline"], t["repetition"]) for t in json.loads(text)["trials"]] == [("late", 1)]


def test_it_speaks_json_and_needs_no_run_where_there_is_one(zoo, capsys):
    zoo.study("plain").run(in_process=True)
    capsys.readouterr()
    code, text = told(capsys, "why", "plain/*/0", "--json")
    assert code == 0
    found = json.loads(text)
    assert found["trial"]["pipeline"] == "plain"
    assert found["failure"] is None


def test_it_refuses_what_is_no_trial_or_several(zoo):
    zoo.run("plain", "late")
    with pytest.raises(InputError, match="no trial of this run is 'zzz'"):
        asked(zoo, "zzz")
    with pytest.raises(InputError, match=r"2 trials are '\*/one/0': .*plain/one/0"):
        asked(zoo, "*/one/0")


def test_a_study_that_is_gone_is_said_and_the_rest_is_told_all_the_same(zoo):
    zoo.run("plain")
    (zoo.folder / "one.toml").unlink()
    found = asked(zoo, "plain/one/0")
    assert "cannot be loaded any more" in found["verdict"]
    assert found["made_of"]["code"]["tracker"]["modules"]
