"""What a cell is told to do in the tests, and the processes that keep cells: plain, or daemonic as a Dask worker is."""

from __future__ import annotations

import ctypes
import json
import multiprocessing
import os
import select
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from sonobench.harness.cell import Cell, Limits
from sonobench.harness.processes import MARK

PERFORM = "cell_tasks:perform"
LIMITS = Limits(timeout_s=1.5, memory_mb=200.0)


def perform(task):
    """Do as told; where `notes` is given, first say under which mark."""
    if "notes" in task and not Path(task["notes"]).exists():
        Path(task["notes"] + ".new").write_text(os.environ[MARK])
        os.replace(task["notes"] + ".new", task["notes"])
    value = globals()[f"do_{task['do']}"]()
    return {"status": "ok", "value": os.getpid() if value is None else value, "peak_mb": 0.0}


def do_nothing(): ...


def do_raise():
    raise RuntimeError("out of the step itself")


def do_abort():
    os.abort()


def do_exit():
    os._exit(0)


def do_hang():
    time.sleep(1000)


def do_hang_with_child():
    subprocess.Popen(["sleep", "1000"])
    time.sleep(1000)


def do_hang_with_grandchild():
    subprocess.run(["sh", "-c", "setsid sleep 1000 & setsid sleep 1000 &"], check=True)  # their parent is gone already
    time.sleep(1000)


def do_hang_in_c():
    ctypes.PyDLL(None).sleep(1000)  # holds the interpreter's lock: no Python code runs beside it


def do_hog():
    kept = bytearray(400_000_000)
    time.sleep(1000)
    return len(kept)


def do_hog_with_children():
    hog = "import time; kept = bytearray(90_000_000); time.sleep(1000)"
    for _ in range(3):
        subprocess.Popen([sys.executable, "-S", "-c", hog])
    time.sleep(1000)


def do_flood():
    for _ in range(300):
        os.write(1, b"x" * 10_000)


def do_thread():
    threading.Thread(target=time.sleep, args=(1000,), daemon=True).start()


def do_child():
    subprocess.Popen(["sleep", "1000"], start_new_session=True)


def do_fork_that_comes_back():
    if os.fork():
        time.sleep(0.05)
        return "the task's own answer"
    return "the fork's answer"


def do_close_streams():
    sys.stdout.close()
    os.close(1)
    os.close(2)


def do_alarm():
    import signal

    signal.setitimer(signal.ITIMER_REAL, 0.2)
    os.chdir("/")


def _sum_of_powers(n):
    total = 0.0
    for k in range(n):
        total += k**0.5 + k**1.5 + k**2.5
    return total


def do_compile():
    import numba

    begin = time.perf_counter()
    compiled = numba.njit(cache=True)(_sum_of_powers)
    compiled(10)
    return sum(compiled.stats.cache_hits.values()), time.perf_counter() - begin


def do_where():
    time.sleep(0.3)
    return os.getcwd()


HOWS = tuple(name.removeprefix("do_") for name in globals() if name.startswith("do_") and name != "do_compile")  # which takes seconds


def outcome(how, log):
    """What becomes of one task, and of an empty one after it in the same cell."""
    cell = Cell(perform=PERFORM, warm=())
    try:
        cell.submit({"do": how}, LIMITS, Path(log))
        first = cell.take()
        cell.submit({"do": "nothing"}, LIMITS)
        return first.status, first.exc_message, cell.take().status
    finally:
        cell.close()


def keep_doing(folder):
    """A cell for each misbehaviour that repeats it for ever, without a limit that would end it."""
    cells = {Cell(perform=PERFORM, warm=()): how for how in HOWS}
    if os.fork() == 0:  # a relative that holds the pipes open longer than we live
        os.closerange(0, 3)
        time.sleep(8)
        os._exit(0)

    def again(cell):
        cell.submit({"do": cells[cell], "notes": f"{folder}/{cells[cell]}.mark"}, Limits(memory_mb=2000.0))

    for cell in cells:
        again(cell)
    while True:
        for cell in select.select(list(cells), [], [])[0]:
            cell.take()
            again(cell)


def all_outcomes(folder):
    """Write what becomes of each misbehaviour to outcomes.json."""
    with ThreadPoolExecutor(6) as threads:
        found = threads.map(lambda how: outcome(how, f"{folder}/{how}.log"), HOWS)
    Path(folder, "outcomes.json").write_text(json.dumps(dict(zip(HOWS, found, strict=True))))


def run_study(folder):
    """Run a small study with two cells."""
    from sonobench.scene.study import Study

    finished = Study.load(Path(folder, "tiny.toml")).run(out=Path(folder, "run"), jobs=2, timeout_s=2.0)
    Path(folder, "statuses.json").write_text(json.dumps(dict(zip(finished.trials["pipeline"], finished.trials["status"], strict=True))))


def main(what, folder, daemonic):
    """Do one of the above here, or in a daemonic process, which may have no children of multiprocessing's."""
    if daemonic == "plain":
        print(os.getpid(), flush=True)
        globals()[what](folder)
        return
    process = multiprocessing.get_context("spawn").Process(target=globals()[what], args=(folder,), daemon=True)
    process.start()
    print(process.pid, flush=True)
    process.join()


if __name__ == "__main__":
    main(*sys.argv[1:])
