"""Whatever a trial does, it is one row, the others are there, and no process is left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from harness_study import STUDY, write_study

from sonobench.harness.cell import Cell, Limits
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
    "hog": ("oom", "--memory"),
    "flood": ("ok", ""),
    "absent": ("unavailable", "no_such_package"),
    "guesser": ("ok", ""),
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("matrix")
    names = "\n".join(f"{name} = {{}}" for name in EXPECTED)
    text = STUDY.replace("guesser = {}", names).replace('"one.toml", ', "").replace("repetitions = 2", "repetitions = 1")
    study = Study.load(write_study(folder, text))
    before = set(psutil.pids())
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SONOBENCH_CACHE", str(folder / "cache"))
        finished = study.run(out=folder / "run", jobs=2, timeout_s=1.5, memory_mb=250)
    left = [p for p in psutil.process_iter(["cmdline"]) if p.pid not in before and "sleep 999" in " ".join(p.info["cmdline"] or [])]
    return finished, left


@pytest.mark.parametrize("name", EXPECTED)
def test_each_misbehaviour_is_one_row_with_its_status_and_a_message(run, name):
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


def test_a_traceback_is_in_the_trials_own_log(run):
    finished, _ = run
    (row,) = finished.trials[finished.trials["pipeline"] == "raise"].itertuples()
    assert "RuntimeError: as told" in (finished.path / row.log_path).read_text()


def test_failed_trials_are_scored_as_empty_output(run):
    finished, _ = run
    values = finished.scores.set_index("trial_key")["value"]
    failed = finished.trials[finished.trials["status"] != "ok"]["trial_key"]
    assert (values[list(failed)] == 9.0).all()
    assert finished.failed == len(failed) == len(EXPECTED) - 2


def nothing(task):
    """A task that does nothing, or leaves something behind."""
    if task["do"] == "thread":
        import threading

        threading.Thread(target=time.sleep, args=(1000,), daemon=True).start()
    if task["do"] in ("child", "hang"):
        subprocess.Popen(["sleep", "1000"], start_new_session=True)
    while task["do"] == "hang":
        pass
    return {"status": "ok", "value": os.getpid(), "peak_mb": 0.0}


@pytest.fixture
def cell(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    made = Cell(perform="test_isolation:nothing", warm=())
    yield made
    made.close()


def done(cell, do):
    cell.submit({"do": do}, Limits())
    return cell.take()


def test_a_worker_is_kept_but_one_that_left_a_thread_is_replaced_and_a_child_is_ended(cell):
    first = done(cell, "nothing").value
    assert done(cell, "nothing").value == first
    assert done(cell, "child").value == first
    others = [p for p in psutil.Process(cell._process.pid).children(recursive=True) if p.pid != first]
    assert all(p.status() == psutil.STATUS_ZOMBIE for p in others)
    assert done(cell, "thread").value == first
    assert done(cell, "nothing").value != first
    assert not psutil.pid_exists(first)


def test_a_guard_that_is_killed_is_a_crash_and_the_cell_goes_on(cell):
    done(cell, "nothing")
    os.kill(cell._process.pid, signal.SIGKILL)
    assert done(cell, "nothing").status == "crash"
    assert done(cell, "nothing").status == "ok"


def test_when_the_run_is_killed_everything_below_it_ends():
    script = (
        "from sonobench.harness.cell import Cell, Limits\n"
        "cell = Cell(perform='test_isolation:nothing', warm=())\n"
        "cell.submit({'do': 'hang'}, Limits())\ncell.take()"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])}
    parent = subprocess.Popen([sys.executable, "-c", script], env=environment)
    below = wait_for(lambda: [p for p in psutil.Process(parent.pid).children(recursive=True) if p.name() == "sleep"])
    everybody = psutil.Process(parent.pid).children(recursive=True)
    assert below
    parent.kill()
    parent.wait()
    wait_for(lambda: not any(p.is_running() and p.status() != psutil.STATUS_ZOMBIE for p in everybody))


def wait_for(condition, seconds=15.0):
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        try:
            if found := condition():
                return found
        except psutil.NoSuchProcess:
            pass
        time.sleep(0.02)
    raise AssertionError("waited in vain")
