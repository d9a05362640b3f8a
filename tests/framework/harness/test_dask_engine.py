"""The Dask engine: the same rows as the local one, whatever becomes of its workers."""

from __future__ import annotations

import os
import signal
import threading
import time

import pandas as pd
import psutil
import pytest
from harness_study import PLUGIN, STUDY, write_study

from sonobench.errors import InputError
from sonobench.harness import run_study
from sonobench.harness.progress import Silent
from sonobench.scene.study import Study

pytest.importorskip("distributed", reason="the Dask engine needs the extra `dask`")

FAULTY = STUDY.replace("guesser = {}", "guesser = {}\nraise = {}\nabort = {}\nabsent = {}")
SLOW = PLUGIN.replace(
    "    def step(self, rng, state, scan):\n        state = state + ",
    "    def step(self, rng, state, scan):\n        time.sleep(0.05)\n        state = state + ",
)
TIMES = ["wall_s", "cpu_s", "front_end_s", "tracker_s", "real_time_factor", "peak_mb"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(folder, out, study=FAULTY, plugin=PLUGIN, **options):
    return run_study(Study.load(write_study(folder, study, plugin)), out=folder / out, display=Silent(), **options)


def workers():
    """The processes of Dask workers below this one."""
    below = psutil.Process().children(recursive=True)
    return [p for p in below if p.ppid() == os.getpid() and "multiprocessing.spawn" in " ".join(p.cmdline())]


def test_a_dask_cluster_gives_the_local_engines_rows_failures_too_and_leaves_no_process(folder):
    local, dask = run(folder, "a", jobs=2), run(folder, "b", jobs=2, engine="dask", fresh=True)
    pd.testing.assert_frame_equal(local.trials.drop(columns=TIMES), dask.trials.drop(columns=TIMES), check_exact=True)
    pd.testing.assert_frame_equal(local.scores, dask.scores, check_exact=True)
    assert set(dask.trials["status"]) == {"ok", "error", "crash", "unavailable"}
    assert not [p for p in psutil.Process().children(recursive=True) if "sonobench.harness.server" in " ".join(p.cmdline())]
    assert not workers()


def test_trials_of_a_killed_worker_run_again_on_the_one_that_takes_its_place(folder):
    calm = run(folder, "a", STUDY, SLOW, jobs=2)
    killed = []

    def kill():
        until = time.monotonic() + 30
        while len(killed) < 2 and time.monotonic() < until:
            busy = [p for p in workers() if any("sonobench.harness.server" in " ".join(c.cmdline()) for c in p.children())]
            if busy and list((folder / "b/estimates").glob("*.mcap") if killed else (folder / "b/logs").parent.glob("journal*")):
                busy[0].send_signal(signal.SIGKILL)
                killed.append(busy[0].pid)
            time.sleep(0.3)

    thread = threading.Thread(target=kill)
    thread.start()
    disturbed = run(folder, "b", STUDY, SLOW, jobs=2, engine="dask")
    thread.join()
    assert len(killed) == 2
    pd.testing.assert_frame_equal(calm.trials.drop(columns=TIMES), disturbed.trials.drop(columns=TIMES), check_exact=True)
    pd.testing.assert_frame_equal(calm.scores, disturbed.scores, check_exact=True)


def test_a_scheduler_that_is_there_already_is_joined_and_its_threads_work_side_by_side(folder):
    from distributed import LocalCluster

    local = run(folder, "a", jobs=2)
    with LocalCluster(n_workers=1, threads_per_worker=2, dashboard_address=":0", silence_logs=50) as cluster:
        for out in ("b", "c"):
            joined = run(folder, out, scheduler=cluster.scheduler_address)
            pd.testing.assert_frame_equal(local.scores, joined.scores, check_exact=True)
            cells = [p for p in psutil.Process().children(recursive=True) if "sonobench.harness.server" in " ".join(p.cmdline())]
            assert not [p for p in cells if p.is_running() and p.status() != psutil.STATUS_ZOMBIE]


def test_a_scheduler_that_is_not_there_is_an_input_error(folder, monkeypatch):
    monkeypatch.setattr("sonobench.harness.dask_engine._ANSWER_S", 1)
    with pytest.raises(InputError, match="no Dask scheduler answers"):
        run(folder, "a", STUDY, scheduler="tcp://127.0.0.1:9")
