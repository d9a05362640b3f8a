"""A cell gives one outcome for each task, whatever it does, and leaves no process, whoever is killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cell_tasks
import psutil
import pytest
from cell_tasks import HOWS, LIMITS, PERFORM
from harness_study import STUDY, write_study

from sonobench.harness.cell import Cell, Limits
from sonobench.harness.processes import MARK, descendants, has_ended

EXPECTED = {
    "raise": ("crash", "exit code 70"),  # only an error of the harness raises here: a component's own is caught in the step
    "abort": ("crash", "SIGABRT"),
    "exit": ("crash", "exit code 0"),
    "hang": ("timeout", "--timeout"),
    "hang_with_child": ("timeout", "--timeout"),
    "hang_with_grandchild": ("timeout", "--timeout"),
    "hang_in_c": ("timeout", "--timeout"),
    "hog": ("oom", "--memory"),
    "hog_with_children": ("oom", "--memory"),
}


def parent(what, folder, daemonic):
    """A process that keeps cells, and the id of the one that really does."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "SONOBENCH_CACHE": str(folder / "cache")}
    command = [sys.executable, cell_tasks.__file__, what, str(folder), daemonic]
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder)
    return process, int(process.stdout.readline())


def marked(mark):
    """Living processes below one cell."""
    wanted, found = f"{MARK}={mark}".encode(), []
    for pid in psutil.pids():
        try:
            if wanted in Path(f"/proc/{pid}/environ").read_bytes().split(b"\0") and not has_ended(pid):
                found.append(pid)
        except OSError:
            continue
    return found


def wait_for(condition, seconds=15.0):
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if found := condition():
            return found
        time.sleep(0.02)
    return condition()


@pytest.fixture(scope="module", params=["plain", "daemonic"])
def outcomes(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("outcomes")
    process, _ = parent("all_outcomes", folder, request.param)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    return folder, json.loads((folder / "outcomes.json").read_text())


@pytest.mark.parametrize("how", HOWS)
def test_each_task_has_one_outcome_and_the_next_task_is_not_harmed_also_below_a_daemonic_process(outcomes, how):
    folder, found = outcomes
    status, message, afterwards = found[how]
    expected, words = EXPECTED.get(how, ("ok", ""))
    assert (status, words in message, afterwards) == (expected, True, "ok"), message
    if expected != "ok":
        assert message in (folder / f"{how}.log").read_text()


def test_an_error_of_the_harness_itself_is_in_the_log(outcomes):
    assert "RuntimeError: out of the step itself" in (outcomes[0] / "raise.log").read_text()


def test_the_log_of_what_hung_or_crashed_says_where(outcomes):
    folder, _ = outcomes
    for how in ("abort", "hang", "hang_with_grandchild", "hang_in_c"):
        assert f"in do_{how}\n" in (folder / f"{how}.log").read_text()


@pytest.fixture(scope="module", params=["plain", pytest.param("daemonic", marks=pytest.mark.study)])
def killed(request, tmp_path_factory):
    """The processes that are left of each cell after kill -9 of their parent."""
    folder = tmp_path_factory.mktemp("killed")
    process, keeper = parent("keep_doing", folder, request.param)
    try:
        marks = [folder / f"{how}.mark" for how in HOWS]
        wait_for(lambda: all(m.exists() for m in marks))
        time.sleep(0.3)  # well into hogs and floods
        names = {how: (folder / f"{how}.mark").read_text() for how in HOWS}
        before = {how: marked(name) for how, name in names.items()}
        os.kill(keeper, signal.SIGKILL)
        wait_for(lambda: not any(marked(name) for name in names.values()), 5.0)
        return before, {how: marked(name) for how, name in names.items()}
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("how", HOWS)
def test_when_the_parent_is_killed_in_the_middle_no_process_is_left(killed, how):
    before, after = killed
    assert len(before[how]) >= {"hang_with_child": 3, "hang_with_grandchild": 4, "hog_with_children": 5}.get(how, 2 if "hang" in how else 1)
    assert after[how] == []


@pytest.fixture
def cell():
    made = Cell(perform=PERFORM, warm=())
    yield made
    made.close()


def done(cell, do, limits=LIMITS):
    cell.submit({"do": do}, limits)
    return cell.take()


def test_a_worker_is_kept_but_one_that_left_a_thread_is_replaced_and_a_child_is_ended(cell):
    first = done(cell, "nothing").value
    assert done(cell, "nothing").value == first
    assert done(cell, "child").value == first
    assert all(has_ended(p) for p in descendants(cell._process.pid) if p != first)
    assert done(cell, "thread").value == first
    assert done(cell, "nothing").value != first
    assert not psutil.pid_exists(first)


def test_a_fork_that_comes_back_does_not_answer_for_the_next_task(cell):
    for _ in range(5):
        assert done(cell, "fork_that_comes_back").value == "the task's own answer"
        assert isinstance(done(cell, "nothing").value, int)


def test_a_worker_whose_streams_were_closed_is_replaced(cell, tmp_path):
    first = done(cell, "close_streams").value
    assert done(cell, "nothing").value != first
    cell.submit({"do": "flood"}, LIMITS, tmp_path / "log")
    assert cell.take().log_bytes == 3_000_000


def test_an_alarm_and_a_changed_folder_do_not_reach_the_next_task(cell):
    done(cell, "alarm")
    assert done(cell, "where").value == os.getcwd()


def test_a_guard_that_is_killed_is_a_crash_nothing_is_left_of_it_and_the_cell_goes_on(cell, tmp_path):
    cell.submit({"do": "hang_with_grandchild", "notes": str(tmp_path / "mark")}, Limits())
    wait_for(lambda: (tmp_path / "mark").exists() and len(marked((tmp_path / "mark").read_text())) >= 4)
    before = marked((tmp_path / "mark").read_text())
    assert len(before) >= 4
    os.kill(cell._process.pid, signal.SIGKILL)
    ended = cell.take()
    assert (ended.status, ended.exc_type) == ("crash", "CellDied")
    assert all(has_ended(p) for p in before)
    assert done(cell, "nothing").status == "ok"


def test_the_code_that_a_killed_worker_compiled_is_reused(tmp_path):
    cell = Cell(tmp_path / "numba", perform=PERFORM, warm=("sonobench.harness.warm:compiler",))
    try:
        hits, compiling_s = done(cell, "compile", Limits()).value
        assert hits == 0
        assert done(cell, "abort").status == "crash"
        hits, loading_s = done(cell, "compile", Limits()).value
        assert hits == 1
        assert loading_s < compiling_s / 2
    finally:
        cell.close()


def test_a_worker_is_the_first_that_the_kernel_ends_and_its_guard_is_not(cell):
    worker = done(cell, "nothing").value
    assert Path(f"/proc/{worker}/oom_score_adj").read_text() == "1000\n"
    assert Path(f"/proc/{cell._process.pid}/oom_score_adj").read_text() == Path("/proc/self/oom_score_adj").read_text()


GROUP = Path("/sys/fs/cgroup/memory")
IN_A_GROUP = """
import os, sys
open(sys.argv[1] + "/cgroup.procs", "w").write(str(os.getpid()))
from sonobench.harness.cell import Cell, Limits
cell = Cell(perform="cell_tasks:perform", warm=())
for do in ("hog", "nothing"):
    cell.submit({"do": do}, Limits())
    print(cell.take().status, flush=True)
cell.close()
"""


def test_a_hog_that_outruns_the_watch_dies_before_its_parent_and_is_oom():
    group = GROUP / f"sonobench-test-{os.getpid()}"
    try:
        group.mkdir()
        (group / "memory.limit_in_bytes").write_text("250000000")
    except OSError as error:
        pytest.skip(f"no memory group of our own here: {error}")
    try:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        command = [sys.executable, "-c", IN_A_GROUP, str(group)]
        ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
        assert (ended.returncode, ended.stdout) == (0, "oom\nok\n"), ended.stderr
    finally:
        wait_for(lambda: not (group / "cgroup.procs").read_text())
        group.rmdir()


def test_cells_are_closed_together_and_soon_even_while_they_import():
    from sonobench.harness.cell import close_all

    cells = [Cell() for _ in range(3)]
    time.sleep(0.2)
    begin = time.monotonic()
    close_all(cells)
    assert time.monotonic() - begin < 0.5  # they do not wait for their imports
    assert not any(marked(c._mark) for c in cells)


def test_a_study_runs_below_a_daemonic_process(tmp_path):
    names = {"guesser": "ok", "abort": "crash"}
    pipelines = "\n".join(f"{name} = {{}}" for name in names)
    write_study(
        tmp_path, STUDY.replace("guesser = {}", pipelines).replace('"one.toml", ', "").replace("repetitions = 2", "repetitions = 1")
    )
    process, _ = parent("run_study", tmp_path, "daemonic")
    _, errors = process.communicate(timeout=60)
    assert (tmp_path / "statuses.json").exists(), errors
    assert json.loads((tmp_path / "statuses.json").read_text()) == names
