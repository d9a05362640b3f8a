"""The Dask engine: the same rows as the local one, whatever becomes of its workers."""

from __future__ import annotations

import json
import os
import shutil
import signal
import threading
import time
from dataclasses import replace
from pathlib import Path

import pandas as pd
import psutil
import pytest
from harness_study import PLUGIN, STUDY, write_study
from harness_zoo import Zoo

from sonobench.cli import main
from sonobench.errors import InputError
from sonobench.harness import dask_engine, run_study
from sonobench.harness.progress import Silent
from sonobench.harness.session import Session
from sonobench.scene.study import Study

pytest.importorskip("distributed", reason="the Dask engine needs the extra `dask`")

FAULTY = STUDY.replace("guesser = {}", "guesser = {}\nraise = {}\nabort = {}\nabsent = {}")
ONE = STUDY.replace(', "two.toml"', "").replace("repetitions = 2", "repetitions = 1")
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


def cells():
    """The guards below this process that live."""
    below = [p for p in psutil.Process().children(recursive=True) if p.status() != psutil.STATUS_ZOMBIE]
    return [p for p in below if "sonobench.harness.server" in " ".join(p.cmdline())]


def blocks_interrupts(process):
    """Whether a process has SIGINT blocked."""
    mask = Path(f"/proc/{process.pid}/status").read_text().split("SigBlk:")[1].split()[0]
    return bool(int(mask, 16) >> (signal.SIGINT - 1) & 1)


def test_a_dask_cluster_gives_the_local_engines_rows_failures_too_and_leaves_no_process(folder):
    local, dask = run(folder, "a", jobs=2), run(folder, "b", jobs=2, engine="dask", fresh=True)
    pd.testing.assert_frame_equal(local.trials.drop(columns=TIMES), dask.trials.drop(columns=TIMES), check_exact=True)
    pd.testing.assert_frame_equal(local.scores, dask.scores, check_exact=True)
    assert set(dask.trials["status"]) == {"ok", "error", "crash", "unavailable"}
    assert not cells()
    assert not workers()


def test_trials_of_a_killed_worker_run_again_on_the_one_that_takes_its_place(folder):
    calm = run(folder, "a", STUDY, SLOW, jobs=2)
    killed, interruptible = [], []

    def kill():
        until = time.monotonic() + 30
        while len(killed) < 2 and time.monotonic() < until:
            busy = [p for p in workers() if any("sonobench.harness.server" in " ".join(c.cmdline()) for c in p.children())]
            if busy and list((folder / "b/estimates").glob("*.mcap") if killed else (folder / "b/logs").parent.glob("journal*")):
                interruptible.extend(p.pid for p in workers() if not blocks_interrupts(p))
                busy[0].send_signal(signal.SIGKILL)
                killed.append(busy[0].pid)
            time.sleep(0.3)

    thread = threading.Thread(target=kill)
    thread.start()
    disturbed = run(folder, "b", STUDY, SLOW, jobs=2, engine="dask")
    thread.join()
    assert len(killed) == 2
    assert not interruptible
    pd.testing.assert_frame_equal(calm.trials.drop(columns=TIMES), disturbed.trials.drop(columns=TIMES), check_exact=True)
    pd.testing.assert_frame_equal(calm.scores, disturbed.scores, check_exact=True)


@pytest.fixture(scope="module")
def cluster():
    """A worker with two threads in this process."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None, silence_logs=50) as there:
        yield there.scheduler_address


def test_a_scheduler_that_is_there_already_is_joined_and_its_threads_work_side_by_side(folder, cluster):
    calm = run(folder, "a", STUDY, in_process=True)
    for out in ("b", "c"):
        joined = run(folder, out, STUDY, scheduler=cluster)
        pd.testing.assert_frame_equal(calm.scores, joined.scores, check_exact=True)
        assert not cells()


def elsewhere(monkeypatch, input_sha=None):
    """Each recording is rendered by a machine whose cache no other one sees."""
    rendered = Session._rendered

    def lost(session, job, outcome):
        if input_sha is not None:
            outcome = replace(outcome, value={**outcome.value, "input_sha": input_sha})
        rendered(session, job, outcome)
        job.take.path.unlink()

    monkeypatch.setattr(Session, "_rendered", lost)


def test_a_worker_renders_a_recording_that_its_cache_lacks(folder, cluster, monkeypatch):
    calm = run(folder, "a", ONE, in_process=True)
    shutil.rmtree(folder / "cache/recordings")
    shutil.rmtree(folder / "cache/scans")
    elsewhere(monkeypatch)
    joined = run(folder, "b", ONE, scheduler=cluster)
    pd.testing.assert_frame_equal(calm.trials.drop(columns=TIMES), joined.trials.drop(columns=TIMES), check_exact=True)
    pd.testing.assert_frame_equal(calm.scores, joined.scores, check_exact=True)
    assert len(list((folder / "cache/recordings").glob("*.mcap"))) == 1


def test_a_worker_that_renders_other_samples_is_refused(folder, cluster, monkeypatch):
    elsewhere(monkeypatch, input_sha="0" * 64)
    with pytest.raises(InputError, match="renders other samples than the first machine did; share the cache folder"):
        run(folder, "a", ONE, scheduler=cluster)
    assert not cells()


def test_a_scene_that_a_worker_cannot_render_is_each_trials_error(folder, cluster, monkeypatch):
    elsewhere(monkeypatch)
    chunk_of = dask_engine._Crew._chunk

    def spoilt(crew, jobs):
        chunk = chunk_of(crew, jobs)
        return chunk if chunk.render is None else replace(chunk, render={**chunk.render, "sha": "another scene's"})

    monkeypatch.setattr(dask_engine._Crew, "_chunk", spoilt)
    trials = run(folder, "a", ONE, scheduler=cluster).trials
    assert set(trials["status"]) == {"error"}
    assert trials["exc_message"].str.contains("changed while the study ran").all()


@pytest.fixture
def zoo(folder, monkeypatch):
    with Zoo.installed(folder, monkeypatch) as made:
        yield made


def test_a_worker_that_reads_other_code_is_refused(zoo, cluster, monkeypatch):
    chunk_of = dask_engine._Crew._chunk

    def edited(crew, jobs):
        (zoo.package / "deep.py").write_text("def deep(x):\n    return 2 * x\n")
        return chunk_of(crew, jobs)

    monkeypatch.setattr(dask_engine._Crew, "_chunk", edited)
    with pytest.raises(InputError, match=r"Dask worker inproc://.* has other code than this run: .* must be the same"):
        zoo.run("plain", in_process=False, scheduler=cluster)
    assert not cells()


def test_a_shard_that_ran_on_dask_is_verified_and_a_tracker_seeded_by_the_clock_is_found(zoo, cluster, capsys):
    zoo.study("plain", "clock")
    with pytest.raises(SystemExit) as end:
        main(["run", "zoos.toml", "--repetitions", "2", "--shard", "2/2", "--scheduler", cluster, "--verify", "100%", "--json"])
    out, err = capsys.readouterr()
    assert end.value.code == 3, err
    found = json.loads(out)
    (finding,) = found["verified"]["findings"]
    assert Path(found["run"]).name == "zoos-2of2"
    assert (found["verified"]["checked"], finding["pipeline"], finding["repetition"]) == (2, "clock", 1)
    assert "its estimates are others when it is repeated" in finding["fault"]


def test_a_scheduler_that_is_not_there_is_an_input_error(folder, monkeypatch):
    monkeypatch.setattr("sonobench.harness.dask_cluster._ANSWER_S", 1)
    with pytest.raises(InputError, match="no Dask scheduler answers"):
        run(folder, "a", STUDY, scheduler="tcp://127.0.0.1:9")
