"""What /proc says about processes below us, and how to end them (Linux)."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

#: in the environment of everything below a cell, so that it is found even after its guard was killed
MARK = "SONOBENCH_CELL"
_PAGE = os.sysconf("SC_PAGE_SIZE")
_GONE = (FileNotFoundError, ProcessLookupError)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Ctrl-C waits until the block is done (a signal mask would not do: libraries' threads take the signal, and Python still raises here)."""
    if threading.current_thread() is not threading.main_thread():  # never interrupted
        yield
        return
    came: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before or signal.SIG_DFL)
        if came:
            signal.raise_signal(signal.SIGINT)


def descendants(pid: int) -> list[int]:
    """Everything below a process, in sessions of their own too."""
    found = []
    todo = [pid]
    while todo:
        parent = todo.pop()
        try:
            threads = os.listdir(f"/proc/{parent}/task")
            below = [int(c) for t in threads for c in Path(f"/proc/{parent}/task/{t}/children").read_text().split()]
        except _GONE:
            continue
        found += below
        todo += below
    return found


def resident_mb(pid: int) -> float:
    """What a process holds in memory; 0 when it is gone."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE / 1e6
    except (*_GONE, IndexError):
        return 0.0


def has_ended(pid: int) -> bool:
    """Gone, or a zombie without a thread that still runs."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        return state == "Z" and len(os.listdir(f"/proc/{pid}/task")) == 1
    except _GONE:
        return True


def end_below(spare: int | None = None) -> None:
    """Kill and reap everything below this subreaper, but for one worker; orphans come to us, so repeat until nobody is left."""
    for _ in range(1000):
        below = [p for p in descendants(os.getpid()) if p != spare]
        living = [p for p in below if not has_ended(p)]  # a zombie of the spared worker is the worker's to reap
        for pid in living:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        for pid in below:
            with suppress(ChildProcessError):
                os.waitpid(pid, os.WNOHANG)
        if not living:
            return
        time.sleep(0.001)


def end_marked(mark: str) -> None:
    """Kill everything that inherited a cell's mark; for when its guard, who would have done it, is dead."""
    wanted = f"{MARK}={mark}".encode()
    for _ in range(1000):
        living = [p for p in _all() if wanted in _environment(p) and not has_ended(p)]
        for pid in living:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        if not living:
            return
        time.sleep(0.001)


def kernel_kills() -> int:
    """How many processes this machine's kernel has killed for want of memory; 0 where it does not tell."""
    with suppress(OSError):
        for line in Path("/proc/vmstat").read_text().splitlines():
            if line.startswith("oom_kill "):
                return int(line.split()[1])
    return 0


def _all() -> list[int]:
    return [int(name) for name in os.listdir("/proc") if name.isdigit() and int(name) != os.getpid()]


def _environment(pid: int) -> list[bytes]:
    try:
        return Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
    except OSError:  # gone, or somebody else's
        return []
