"""What a trial costs beyond its own work: dispatch to a kept worker, a fresh worker after one died, the digest of its code."""

from __future__ import annotations

import subprocess
import sys
import time
from statistics import median, quantiles

import pytest
from bench_clock import seconds

from sonobench import Registry
from sonobench.components import build
from sonobench.harness.cell import Cell, Limits
from sonobench.harness.code import closure, code, forget

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
