"""kill -9 of a whole run, at any time and inside any write: the same command goes on, and nothing that was finished is done again."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import uuid
from collections import Counter
from pathlib import Path

import kill_points
import numpy as np
import pandas as pd
import psutil
import pytest
from harness_study import STUDY, write_study

from sonobench.harness import open_run

PIPELINES = 'guesser = {}\nraise = {}\nother = { use = "guesser", tracker = { spread_m = 0.3 } }'
PLANNED = 36
OF_THIS_MACHINE = ["log_path", "wall_s", "cpu_s", "front_end_s", "tracker_s", "real_time_factor", "peak_mb"]
MARK = "SONOBENCH_TEST_RUN"


class Command:
    """`sonobench run tiny.toml` in a folder with a cache of its own."""

    def __init__(self, folder: Path, *options: str) -> None:
        folder.mkdir(exist_ok=True)
        self.folder, self.options, self.mark = folder, options, uuid.uuid4().hex
        write_study(folder, STUDY.replace("guesser = {}", PIPELINES).replace("repetitions = 2", "repetitions = 6"))
        self.environment = {**os.environ, "SONOBENCH_CACHE": str(folder / "cache"), MARK: self.mark}

    def start(self, *program: str) -> subprocess.Popen[bytes]:
        """Begin or go on; `program` stands in for the plain command."""
        command = [sys.executable, *(program or ("-m", "sonobench")), "run", "tiny.toml", "--out", "run", *self.options]
        return subprocess.Popen(
            command, cwd=self.folder, env=self.environment, stdout=subprocess.DEVNULL, stderr=open(self.folder / "stderr", "wb")
        )

    def to_its_end(self, *program: str) -> None:
        """Begin or go on until it is done."""
        code = self.start(*program).wait(timeout=120)
        assert code == 3, (self.folder / "stderr").read_text()  # done, with failed trials

    def journaled(self) -> list[str]:
        """Keys of the trials whose whole line is in the journal, in order."""
        journal = self.folder / "run/journal.jsonl"
        lines = journal.read_bytes().split(b"\n")[:-1] if journal.exists() else []
        return [row["trial"]["trial_key"] for row in map(parsed, lines) if "trial" in row]

    def left(self) -> list[psutil.Process]:
        """Processes that are still there."""
        return [p for p in psutil.process_iter() if self.mark in environment_of(p) and p.status() != psutil.STATUS_ZOMBIE]

    def results(self):
        """What must be the same however often it was killed."""
        run = open_run(self.folder / "run")
        board = run.board("distance").drop(columns="ms_per_frame")
        return run.trials.drop(columns=OF_THIS_MACHINE), run.scores, board


def parsed(line):
    try:
        return json.loads(line)
    except ValueError:
        return {}


def environment_of(process):
    try:
        return process.environ().get(MARK, "")
    except psutil.Error:
        return ""


def wait_for(condition, seconds=5.0):
    until = time.monotonic() + seconds
    while not condition() and time.monotonic() < until:
        time.sleep(0.02)
    return condition()


def equal(found, wanted):
    for one, other in zip(found, wanted, strict=True):
        pd.testing.assert_frame_equal(one, other, check_exact=True)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """A run that nobody kills: its results, how many writes it has, how long it takes with workers."""
    command = Command(tmp_path_factory.mktemp("undisturbed"), "--in-process")
    command.to_its_end(kill_points.__file__, "0")
    return command.results(), int((command.folder / "writes.txt").read_text())


def killed_at_write(command, number):
    before = command.journaled()
    code = command.start(kill_points.__file__, str(number)).wait(timeout=60)
    finished = command.journaled()
    assert finished[: len(before)] == before
    return code == -signal.SIGKILL


def test_a_run_that_is_killed_inside_one_write_after_another_ends_with_the_same_board(tmp_path, undisturbed):
    results, writes = undisturbed
    command = Command(tmp_path / "a", "--in-process")
    number, kills = 3, 0
    while killed_at_write(command, number):
        number, kills = 2 + writes // 3 + kills, kills + 1
    assert kills >= 3
    assert max(Counter(command.journaled()).values()) == 1
    equal(command.results(), results)
    assert not list((command.folder / "run").rglob("*.tmp"))


@pytest.mark.study
@pytest.mark.parametrize("point", range(20))
def test_a_run_that_is_killed_inside_any_write_goes_on(tmp_path, undisturbed, point):
    results, writes = undisturbed
    command = Command(tmp_path / "a", "--in-process")
    number = 1 + int((point + np.random.default_rng(point).uniform()) * writes / 20)
    assert killed_at_write(command, number)
    command.to_its_end()
    assert max(Counter(command.journaled()).values()) == 1
    equal(command.results(), results)


def kill_and_go_on(command, moment):
    """kill -9 once `moment` says so, see that all its processes end, go on; the finished trials' keys at the kill and at the end."""
    process = command.start()
    while process.poll() is None and not moment():
        time.sleep(0.002)
    process.kill()
    process.wait()
    assert wait_for(lambda: not command.left())
    finished = command.journaled()
    command.to_its_end()
    assert max(Counter(command.journaled()).values()) == 1
    return finished, command.journaled()


def test_a_run_with_workers_that_is_killed_in_the_middle_leaves_no_process_and_goes_on(tmp_path, undisturbed):
    command = Command(tmp_path / "a", "--jobs", "2")
    finished, at_the_end = kill_and_go_on(command, lambda: len(command.journaled()) >= 3)
    assert 3 <= len(finished) < len(at_the_end) == PLANNED
    equal(command.results(), undisturbed[0])


@pytest.mark.study
@pytest.mark.parametrize("point", range(20))
def test_a_run_with_workers_that_is_killed_at_a_random_time_goes_on(tmp_path, undisturbed, point):
    rng = np.random.default_rng(100 + point)
    command = Command(tmp_path / "a", "--jobs", "2")
    time_s, share, begun = rng.uniform(0.3, 3.0), rng.uniform(0, PLANNED), time.monotonic()
    while_it_starts = point < 5  # the others while trials end, at any of them

    def moment():
        return time.monotonic() - begun > time_s if while_it_starts else len(command.journaled()) >= share

    finished, at_the_end = kill_and_go_on(command, moment)
    print(f"killed with {len(finished)} of {len(at_the_end)} trials finished")
    equal(command.results(), undisturbed[0])
