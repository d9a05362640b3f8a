"""Ctrl-C: a real SIGINT to a running command ends it and all below it within two seconds, and what was done is kept."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import psutil
import pytest
from harness_study import PLUGIN, STUDY, write_study

from sonobench.harness import open_run
from sonobench.harness.processes import has_ended, uninterrupted

COMPILING = '''

@dataclass(frozen=True)
class Compiling:
    """Takes minutes to compile."""

    space = SPACE

    def init(self, rng, setup):
        import numba
        lines = "\\n".join(f"    x = x * {k}.5 + (y if x > {k} else x)" for k in range(4000))
        names = {}
        exec("def long(x, y):\\n" + lines + "\\n    return x", names)
        open("compiling", "w").close()
        return numba.njit(names["long"])(1.0, 2.0)

    def step(self, rng, state, scan):
        return state, Estimate(scan.time_s, np.zeros((0, 2)))
'''


def command(folder, slow):
    plugin = PLUGIN.replace(
        "        if state == 1:", "        if state == 1:\n            self.how == 'gil' and open('hanging', 'w').close()", 1
    )
    plugin = (plugin + COMPILING).replace('"tracker": {"guess"', '"tracker": {"compiling": Compiling, "guess"')
    compiling = 'compiling = { use = "guesser", tracker = { use = "compiling" } }'
    write_study(folder, STUDY.replace("guesser = {}", f"guesser = {{}}\n{compiling if slow == 'compiling' else slow + ' = {}'}"), plugin)
    return [sys.executable, "-m", "sonobench", "run", "tiny.toml", "--out", "run", "--jobs", "2"]


def allowed_s():
    """Two seconds on a machine that has a processor for us."""
    return 2.0 if os.getloadavg()[0] < len(os.sched_getaffinity(0)) else 5.0


def journaled(folder):
    path = folder / "run/journal.jsonl"
    lines = path.read_bytes().split(b"\n")[:-1] if path.exists() else []
    return [line["trial"] for line in map(json.loads, lines) if "trial" in line]


def interrupted(folder, arguments, moment):
    """Start, wait for the moment, interrupt all as a terminal does: (exit code, seconds, processes that were there and are left, stderr)."""
    environment = {**os.environ, "SONOBENCH_CACHE": str(folder / "cache")}
    process = subprocess.Popen(
        arguments, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, process_group=0
    )
    until = time.monotonic() + 30
    while not moment(process) and process.poll() is None and time.monotonic() < until:
        time.sleep(0.01)
    below = psutil.Process(process.pid).children(recursive=True)
    begin = time.monotonic()
    os.killpg(process.pid, signal.SIGINT)
    errors = process.communicate(timeout=30)[1]
    seconds = time.monotonic() - begin
    until = time.monotonic() + 1
    while (left := [p for p in below if not has_ended(p.pid)]) and time.monotonic() < until:  # multiprocessing's tracker ends after us
        time.sleep(0.02)
    return process.returncode, seconds, left, errors


@pytest.mark.parametrize(("slow", "sign"), [("gil", "hanging"), ("compiling", "compiling")])
def test_an_interrupt_ends_within_two_seconds_while_a_worker_hangs_or_compiles_and_keeps_what_is_done(tmp_path, slow, sign):
    arguments = command(tmp_path, slow)
    code, seconds, left, errors = interrupted(tmp_path, arguments, lambda _: (tmp_path / sign).exists() and journaled(tmp_path))
    done = journaled(tmp_path)
    assert (code, left) == (130, []), errors
    assert seconds < allowed_s()
    assert "interrupted; what was finished is kept" in errors
    assert "Traceback" not in errors
    trials = open_run(tmp_path / "run").trials
    assert len(trials) == 8
    assert set(trials["status"]) == {"ok", "skipped"}
    assert (trials["status"] == "ok").sum() == len(done) >= 1
    if slow == "gil":  # the same for both, and it takes its time
        again = [*arguments, "--only", "guesser"]
        subprocess.run(again, cwd=tmp_path, env={**os.environ, "SONOBENCH_CACHE": str(tmp_path / "cache")}, check=True)
        finished = [row["trial_key"] for row in journaled(tmp_path)]
        assert len(set(finished)) == len(finished) == 4


def test_an_interrupt_while_cells_start_ends_within_two_seconds(tmp_path):
    arguments = command(tmp_path, "gil")
    code, seconds, left, errors = interrupted(tmp_path, arguments, lambda p: len(psutil.Process(p.pid).children()) == 2)
    assert (code, left) == (130, []), errors
    assert seconds < allowed_s()


def test_an_interrupt_of_a_run_on_dask_is_the_runs_alone_and_no_worker_prints_a_traceback(tmp_path):
    pytest.importorskip("distributed", reason="the Dask engine needs the extra `dask`")
    arguments = [*command(tmp_path, "gil"), "--engine", "dask"]
    code, seconds, left, errors = interrupted(tmp_path, arguments, lambda _: (tmp_path / "hanging").exists() and journaled(tmp_path))
    assert (code, left) == (130, []), errors
    assert seconds < allowed_s()
    assert errors.splitlines()[-1] == "interrupted; what was finished is kept"
    assert "Traceback" not in errors
    trials = open_run(tmp_path / "run").trials
    assert set(trials["status"]) == {"ok", "skipped"}
    assert (trials["status"] == "ok").sum() == len(journaled(tmp_path)) >= 1


def test_an_interrupt_of_a_run_in_one_process_is_the_users_and_no_trials_failure(tmp_path):
    arguments = [*command(tmp_path, "hang")[:-2], "--in-process"]
    code, seconds, _, errors = interrupted(tmp_path, arguments, lambda _: journaled(tmp_path))
    assert code == 130, errors
    assert seconds < allowed_s()
    assert {row["status"] for row in journaled(tmp_path)} == {"ok"}


def test_an_interrupt_waits_for_what_must_be_whole():
    done = []

    def nested():
        with uninterrupted():
            with uninterrupted():
                signal.raise_signal(signal.SIGINT)
                done.append("inner")
            done.append("outer")
        done.append("after")

    with pytest.raises(KeyboardInterrupt):
        nested()
    assert done == ["inner", "outer"]
