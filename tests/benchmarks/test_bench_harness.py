"""What a trial costs beyond its own work: dispatch to a kept worker, a fresh worker after one died, the digest of its code."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from functools import partial
from itertools import pairwise
from statistics import median, quantiles

import pytest
from bench_clock import seconds
from harness_study import STUDY, write_study

from sonobench import Registry
from sonobench.components import build
from sonobench.harness import local
from sonobench.harness.cell import Cell, Limits
from sonobench.harness.code import closure, code, forget
from sonobench.harness.progress import Silent
from sonobench.scene.study import Study

TASKS, DEATHS = 1000, 30


@pytest.fixture(scope="module")
def cell():
    """A cell with all that real trials import."""
    begin = time.perf_counter()
    made = Cell(perform="bench_tasks:perform")
    made.submit({"do": "nothing"}, Limits())
    made.take()
    yield made, time.perf_counter() - begin
    made.close()


def asked(cell, do, limits=Limits()):  # noqa: B008 - frozen
    cell.submit({"do": do}, limits)
    return cell.take()


@pytest.mark.parametrize("limits", [Limits(), Limits(timeout_s=60.0, memory_mb=4000.0)], ids=["no limits", "time and memory watched"])
def test_dispatch_of_an_empty_task_to_a_kept_worker(benchmark, cell, limits):
    made, start_s = cell
    first = asked(made, "nothing").value
    taken = [seconds(lambda: asked(made, "nothing", limits)) for _ in range(TASKS)]
    benchmark(asked, made, "nothing", limits)
    assert asked(made, "nothing").value == first
    benchmark.extra_info |= {
        "median (ms)": 1e3 * median(taken),
        "95 % (ms)": 1e3 * quantiles(taken, n=20)[-1],
        "a new cell, imports included (s)": start_s,
    }


def test_a_fresh_worker_after_one_died(benchmark, cell):
    made, _ = cell

    def death_and_next():
        assert asked(made, "exit").status == "crash"
        return asked(made, "nothing").value

    workers = set()
    died = [seconds(lambda: workers.add(death_and_next())) for _ in range(DEATHS)]
    kept = median(seconds(lambda: asked(made, "nothing")) for _ in range(100))
    benchmark.pedantic(death_and_next, rounds=10)
    assert len(workers) == DEATHS
    benchmark.extra_info |= {
        "death, a fresh worker and its first answer (ms)": 1e3 * median(died),
        "a kept worker's answer (ms)": 1e3 * kept,
    }


def test_the_code_that_a_killed_worker_compiled_is_reused(benchmark, tmp_path):
    cell = Cell(tmp_path, perform="cell_tasks:perform", warm=("numba", "sonobench.harness.warm:compiler"))
    compiled_s = []
    for _ in range(5):
        _, seconds_ = asked(cell, "compile").value
        compiled_s.append(seconds_)
        asked(cell, "abort")
    benchmark.pedantic(lambda: asked(cell, "nothing"), rounds=1)
    cell.close()
    benchmark.extra_info |= {
        "compiling (ms)": 1e3 * compiled_s[0],
        "after the worker was killed, from the cache (ms)": 1e3 * median(compiled_s[1:]),
    }


@pytest.mark.parametrize("limits", [{}, {"timeout_s": 60.0, "memory_mb": 4000.0}], ids=["no limits", "time and memory watched"])
def test_dispatch_row_and_journal_of_1000_empty_trials(benchmark, tmp_path, monkeypatch, limits):
    """The real session, engine, journal and tables; only the steps do nothing: a tracker's and a metric's dispatch each trial."""
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    one = STUDY.replace('"one.toml", ', "").replace("repetitions = 2", "repetitions = 1")
    Study.load(write_study(tmp_path, one)).run(out="first", in_process=True, display=Silent())
    shutil.copy(next((tmp_path / "cache/recordings").glob("*.mcap")), tmp_path / "take.mcap")
    text = one.replace('scenes = ["two.toml"]', 'recordings = ["take.mcap"]').replace("repetitions = 1", f"repetitions = {TASKS}")
    study = Study.load(write_study(tmp_path, text))
    monkeypatch.setattr(local, "Cell", partial(Cell, perform="bench_tasks:empty", warm=()))
    ended = []
    monkeypatch.setattr(study.registry, "trial_finished", lambda row: ended.append(time.perf_counter()))
    whole = benchmark.pedantic(lambda: seconds(lambda: study.run(out="run", jobs=1, display=Silent(), **limits)), rounds=1)
    assert len(ended) == TASKS
    each = [after - before for before, after in pairwise(ended)]
    benchmark.extra_info |= {
        "a trial, two dispatches, median (ms)": 1e3 * median(each),
        "a trial, 95 % (ms)": 1e3 * quantiles(each, n=20)[-1],
        "the whole run: plan, cell, trials, tables (s)": whole,
    }


FIRST = """
import time
from sonobench import Registry
from sonobench.components import build
from sonobench.harness.code import code
pipeline = build("pipeline", "ck-phd", Registry.load(), "bench")
begin = time.perf_counter()
code(pipeline.tracker)
print(time.perf_counter() - begin)
"""


def test_the_digest_of_a_trackers_code(benchmark):
    tracker = build("pipeline", "ck-phd", Registry.load(), "bench").tracker
    first = [float(subprocess.run([sys.executable, "-c", FIRST], capture_output=True, text=True, check=True).stdout) for _ in range(7)]

    def anew():
        forget()
        code(tracker)

    anew()
    again = median(seconds(anew) for _ in range(30))
    benchmark(anew)
    benchmark.extra_info |= {
        "modules read": len(closure(tracker).modules),
        "first in a process (ms)": 1e3 * median(first),
        "after forget(), unchanged sources (ms)": 1e3 * again,
        "same objects again (us)": 1e6 * median(seconds(lambda: code(tracker)) for _ in range(200)),
    }
