"""Large runs: time and memory of resuming, compacting and boarding grow with the trials, and no faster."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from scale_runs import finished_run

RESUME = """
import json, os, resource, sys, time
from sonobench.harness import run_folder, run_study
from sonobench.harness.progress import Silent
from sonobench.scene.study import Study

marks = {}
write_tables = run_folder.write_tables

def told(name):
    marks[name] = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

def compact(*given):
    told("resume")
    write_tables(*given)
    told("compaction")

told("start")
run_folder.write_tables = compact
finished = run_study(Study.load("tiny.toml"), out="run", jobs=1, display=Silent())
print(json.dumps({name: (cpu - marks["start"][0], mb) for name, (cpu, mb) in marks.items()}))
"""
BOARD = """
import json, resource, time
from sonobench.harness import open_run

begin = time.process_time()
table = open_run("run").board()
assert table["trials"].sum() == len(open_run("run").trials)
print(json.dumps({"board": (time.process_time() - begin, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)}))
"""


def measured(folder: Path, monkeypatch, trials: int) -> dict[str, tuple[float, float]]:
    """(processor seconds, MB resident at most) of each step on a finished run of so many trials."""
    folder.mkdir()
    monkeypatch.setenv("SONOBENCH_CACHE", str(folder / "cache"))
    finished_run(folder, trials)
    found: dict[str, tuple[float, float]] = {}
    journal = (folder / "run/journal.jsonl").stat().st_size
    for program in (RESUME, BOARD):
        done = subprocess.run([sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        found |= json.loads(done.stdout.splitlines()[-1])
    assert (folder / "run/journal.jsonl").stat().st_size == journal, "something ran again"
    found["compaction"] = found["compaction"][0] - found["resume"][0], found["compaction"][1]
    return found


@pytest.mark.study
def test_ten_times_the_trials_take_about_ten_times_as_long_and_little_more_memory(tmp_path, monkeypatch):
    few, many = (measured(tmp_path / str(n), monkeypatch, n) for n in (1_000, 10_000))
    for step in ("resume", "compaction", "board"):
        assert many[step][0] < 15 * few[step][0] + 0.5
        assert many[step][0] < 5, "seconds: imports, a hundredth of what a million trials may take, and a busy machine"
        assert many[step][1] < few[step][1] + 150, "MB"


@pytest.mark.study
def test_a_million_trials_are_resumed_compacted_and_boarded_within_a_minute_and_two_gigabytes_each(tmp_path, monkeypatch, capsys):
    found = measured(tmp_path / "million", monkeypatch, 1_000_000)
    with capsys.disabled():
        print("\n", *(f"{step}: {cpu:.0f} s of one processor, {mb:.0f} MB;" for step, (cpu, mb) in found.items() if step != "start"))
    assert all(cpu < 60 and mb < 2000 for cpu, mb in found.values())
