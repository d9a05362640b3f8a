"""Whatever a trial does, it is one row, the others are there, and no process is left."""

from __future__ import annotations

import psutil
import pytest
from harness_study import STUDY, write_study

from sonobench.scene.study import Study

EXPECTED = {
    "nan": ("invalid", "NaN"),
    "shape": ("invalid", "(1, 5)"),
    "raise": ("error", "as told"),
    "quit": ("error", "0"),
    "abort": ("crash", "SIGABRT"),
    "exit": ("crash", "exit code 0"),
    "hang": ("timeout", "--timeout"),
    "child": ("timeout", "--timeout"),
    "grandchild": ("timeout", "--timeout"),
    "gil": ("timeout", "--timeout"),
    "hog": ("oom", "--memory"),
    "odd": ("error", "udcff xxx"),
    "flood": ("ok", ""),
    "thread": ("ok", ""),
    "orphan": ("ok", ""),
    "absent": ("unavailable", "no_such_package"),
    "guesser": ("ok", ""),
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("matrix")
    names = "\n".join(f"{name} = {{}}" for name in EXPECTED)
    text = STUDY.replace("guesser = {}", names).replace('"one.toml", ', "").replace("repetitions = 2", "repetitions = 1")
    study = Study.load(write_study(folder, text))
    with pytest.MonkeyPatch.context() as patch:  # everything below inherits the cache's path, which nobody else has
        patch.setenv("SONOBENCH_CACHE", str(folder / "cache"))
        finished = study.run(out=folder / "run", jobs=2, timeout_s=1.5, memory_mb=400)
    left = [p for p in psutil.process_iter(["environ"]) if (p.info["environ"] or {}).get("SONOBENCH_CACHE") == str(folder / "cache")]
    return finished, left


@pytest.mark.parametrize("name", EXPECTED)
def test_each_misbehaviour_is_exactly_one_row_with_its_status_and_a_message(run, name):
    trials = run[0].trials
    (row,) = trials[trials["pipeline"] == name].itertuples()
    status, words = EXPECTED[name]
    assert (row.status, words in row.exc_message) == (status, True), row.exc_message


def test_no_child_of_a_trial_is_left_even_in_its_own_session(run):
    assert run[1] == []


def test_a_flood_of_output_is_cut_and_the_trial_is_ok(run):
    finished, _ = run
    (row,) = finished.trials[finished.trials["pipeline"] == "flood"].itertuples()
    text = (finished.path / row.log_path).read_bytes()
    assert 1_000_000 <= len(text) < 1_001_000
    assert b"cut here" in text


@pytest.mark.parametrize("name", [name for name, (status, _) in EXPECTED.items() if status not in ("ok", "unavailable")])
def test_each_failure_has_its_exception_and_a_log_that_says_where_or_how_it_ended(run, name):
    finished, _ = run
    (row,) = finished.trials[finished.trials["pipeline"] == name].itertuples()
    log = (finished.path / row.log_path).read_text(errors="replace")
    assert row.exc_type
    assert len(row.exc_message) < 5000
    where = {"abort": "in _abort", "hang": "in _hang", "child": "in _child", "grandchild": "in _grandchild", "gil": "in _gil"}
    assert where.get(name, "Traceback" if row.status in ("error", "invalid") else row.exc_message) in log


def test_a_traceback_is_in_the_trials_own_log(run):
    finished, _ = run
    (row,) = finished.trials[finished.trials["pipeline"] == "raise"].itertuples()
    assert "RuntimeError: as told" in (finished.path / row.log_path).read_text()


def test_failed_trials_are_scored_as_empty_output(run):
    finished, _ = run
    values = finished.scores.set_index("trial_key")["value"]
    failed = finished.trials[finished.trials["status"] != "ok"]["trial_key"]
    assert (values[list(failed)] == 9.0).all()
    assert finished.failed == len(failed) == sum(status != "ok" for status, _ in EXPECTED.values())
