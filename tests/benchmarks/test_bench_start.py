"""What the command line costs before it does anything, as wall time of whole processes beside bare Python's."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from bench_clock import in_turn, seconds

SCRIPT = Path(sys.executable).with_name("sonobench")
RUNS = 11


def process(*command):
    return lambda: subprocess.run(command, stdout=subprocess.DEVNULL, check=True)


@pytest.mark.parametrize("words", [("--help",), ("run", "--help"), ("plugins", "list"), ("data", "list")], ids=" ".join)
def test_starting_beside_bare_python(benchmark, words):
    work, bare = process(str(SCRIPT), *words), process(sys.executable, "-c", "pass")
    bare_s, work_s = in_turn(RUNS, bare, work)
    benchmark.pedantic(work, rounds=3)
    benchmark.extra_info |= {
        "python -c pass (ms)": 1e3 * bare_s,
        "sonobench (ms)": 1e3 * work_s,
        "difference (ms)": 1e3 * (work_s - bare_s),
    }


def test_importing_the_package_beside_bare_python(benchmark):
    work, bare = process(sys.executable, "-c", "import sonobench"), process(sys.executable, "-c", "pass")
    bare_s, work_s = in_turn(RUNS, bare, work)
    benchmark.pedantic(lambda: seconds(work), rounds=3)
    benchmark.extra_info["difference (ms)"] = 1e3 * (work_s - bare_s)
