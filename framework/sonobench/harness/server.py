"""The process that guards one worker: `python -m sonobench.harness.server IN OUT`.

It imports what every task needs (nothing that starts a thread), forks a worker, hands it one task at a time and watches it. Whatever the worker does
(raise, abort, exit, hang, hog, flood), exactly one answer goes back for each task. The guard is the subreaper of
everything below it, so that no grandchild outlives the worker, even one in a session of its own. When its parent is
gone its inlet ends, and it ends all that it started.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import pickle
import select
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sonobench.harness import frames

LOG_CAP = 1_000_000  # bytes of a task's own output that are kept
_WATCH_S = 0.02  # how often the resident size is looked at
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
_PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True, slots=True)
class Worker:
    """A forked worker and the guard's ends of its pipes."""

    pid: int
    handle: int
    tasks: int
    results: int
    output: int

    def close(self) -> None:
        for fd in (self.handle, self.tasks, self.results, self.output):
            os.close(fd)


class Log:
    """A task's own output, opened at its first byte and cut at the cap."""

    def __init__(self, path: str | None) -> None:
        self._path, self._file, self.size = path, -1, 0

    def write(self, data: bytes) -> None:
        """Keep what fits."""
        room = LOG_CAP - self.size
        self.size += len(data)
        if not data or self._path is None or room <= 0:
            return
        if self._file < 0:
            Path(self._path).parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(self._path, os.O_CREAT | os.O_WRONLY | os.O_TRUNC, 0o666)
        os.write(self._file, data[:room])
        if len(data) > room:
            os.write(self._file, b"\n[cut here: the output went on]\n")

    def close(self) -> None:
        """End it."""
        if self._file >= 0:
            os.close(self._file)


def main() -> None:
    """Serve until the parent is gone."""
    inlet, outlet = int(sys.argv[1]), int(sys.argv[2])
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)
    hello = frames.receive(inlet)
    sys.path[:] = hello["path"]
    for name in hello["warm"]:
        importlib.import_module(name)
    perform = _named(hello["perform"])
    worker = _fork(inlet, outlet, perform)
    while (content := frames.receive_bytes(inlet)) is not None:
        limits = pickle.loads(content)
        task = frames.receive_bytes(inlet)
        if task is None:
            break
        answer, kept = _serve(worker, task, limits, inlet)
        if not kept:
            _end_all()
            worker.close()
            worker = _fork(inlet, outlet, perform)
        frames.send(outlet, answer)
    _end_all()


def _serve(worker: Worker, task: bytes, limits: dict[str, Any], inlet: int) -> tuple[dict[str, Any], bool]:
    """The answer to one task, and whether the worker may take another."""
    log = Log(limits["log"])
    begin = time.monotonic()
    deadline = None if limits["timeout_s"] is None else begin + limits["timeout_s"]
    with suppress(BrokenPipeError):  # it died between two tasks; its end is found below
        frames.send_bytes(worker.tasks, task)
    try:
        answer, kept = _watch(worker, deadline, limits, inlet, log)
    finally:
        _drain(worker.output, log)
        log.close()
    return {**answer, "log_bytes": log.size, "wall_s": time.monotonic() - begin}, kept


def _watch(worker: Worker, deadline: float | None, limits: dict[str, Any], inlet: int, log: Log) -> tuple[dict[str, Any], bool]:
    poll = select.poll()
    for fd in (inlet, worker.handle, worker.results, worker.output):
        poll.register(fd, select.POLLIN)
    incoming, peak, cap = frames.Frames(), 0.0, limits["memory_mb"]
    while True:
        left = _WATCH_S if cap is not None else 1.0
        if deadline is not None:
            left = min(left, deadline - time.monotonic())
        ready = {fd for fd, _ in poll.poll(max(left, 0) * 1000)}
        if worker.output in ready:
            log.write(os.read(worker.output, 1 << 16))
        if worker.results in ready or worker.handle in ready:
            for result in incoming.feed(_available(worker.results)):
                retire = result[:1] == b"!"
                _end_all(spare=worker.pid)
                return {"status": "ok", "value": result[1:], "peak_mb": peak}, not retire
        if worker.handle in ready:
            return {"status": "crash", "message": _end_of(worker.pid), "peak_mb": peak}, False
        if inlet in ready:  # only its end can be: the parent waits for our answer
            _end_all()
            os._exit(1)
        if cap is not None:
            size = sum(map(_resident_mb, _descendants(os.getpid())))
            peak = max(peak, size)
            if size > cap:
                return {"status": "oom", "message": f"held {size:.0f} MB, {cap:g} MB are allowed (--memory)", "peak_mb": peak}, False
        if deadline is not None and time.monotonic() >= deadline:
            return {"status": "timeout", "message": f"took longer than {limits['timeout_s']:g} s (--timeout)", "peak_mb": peak}, False


def _available(pipe: int) -> bytes:
    content = bytearray()
    while select.select([pipe], [], [], 0)[0]:
        part = os.read(pipe, 1 << 20)
        if not part:
            break
        content += part
    return bytes(content)


def _drain(pipe: int, log: Log) -> None:
    until = time.monotonic() + 0.5  # what a flood left in the pipe, but not a flood that goes on
    while time.monotonic() < until and select.select([pipe], [], [], 0)[0]:
        data = os.read(pipe, 1 << 16)
        if not data:
            return
        log.write(data)


def _end_of(pid: int) -> str:
    _, status = os.waitpid(pid, 0)
    if os.WIFSIGNALED(status):
        return f"killed by {signal.Signals(os.WTERMSIG(status)).name}"
    return f"the process ended itself with exit code {os.WEXITSTATUS(status)}"


def _descendants(pid: int) -> list[int]:
    found = []
    todo = [pid]
    while todo:
        parent = todo.pop()
        try:
            threads = os.listdir(f"/proc/{parent}/task")
            below = [int(c) for t in threads for c in Path(f"/proc/{parent}/task/{t}/children").read_text().split()]
        except (FileNotFoundError, ProcessLookupError):
            continue
        found += below
        todo += below
    return found


def _resident_mb(pid: int) -> float:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE / 1e6
    except (FileNotFoundError, ProcessLookupError, IndexError):
        return 0.0


def _end_all(spare: int | None = None) -> None:
    """Kill and reap everything below, but for one worker; orphans come to us, so repeat until nobody is left."""
    for _ in range(1000):
        below = [p for p in _descendants(os.getpid()) if p != spare]
        living = [p for p in below if not _is_zombie(p)]  # a zombie of the spared worker is the worker's to reap
        for pid in living:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        for pid in below:
            with suppress(ChildProcessError):
                os.waitpid(pid, os.WNOHANG)
        if not living:
            return
        time.sleep(0.001)


def _is_zombie(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


def _named(name: str) -> Callable[[Any], Any]:
    module, _, function = name.partition(":")
    found: Callable[[Any], Any] = getattr(importlib.import_module(module), function)
    return found


def _fork(inlet: int, outlet: int, perform: Callable[[Any], Any]) -> Worker:
    task_in, task_out = os.pipe()
    result_in, result_out = os.pipe()
    output_in, output_out = os.pipe()
    guard = os.getpid()
    pid = os.fork()
    if pid:
        for fd in (task_in, result_out, output_out):
            os.close(fd)
        return Worker(pid, os.pidfd_open(pid), task_out, result_in, output_in)
    try:
        for fd in (inlet, outlet, task_out, result_in, output_in):
            os.close(fd)
        _become_worker(guard, output_out)
        _work(task_in, result_out, perform)
    finally:
        os._exit(70)  # never back into the guard's own loop


def _become_worker(guard: int, output: int) -> None:
    os.setsid()
    _prctl(_PR_SET_CHILD_SUBREAPER, 0)
    _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != guard:
        os._exit(0)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    Path("/proc/self/oom_score_adj").write_text("1000")  # a hog that outruns the watch dies before anybody else
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.close(output)
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]


def _work(tasks: int, results: int, perform: Callable[[Any], Any]) -> None:
    """Answer tasks until the guard is gone; a leading "!" asks for a fresh worker (a thread was left behind)."""
    while (content := frames.receive_bytes(tasks)) is not None:
        threads = len(os.listdir("/proc/self/task"))
        answer = pickle.dumps(perform(pickle.loads(content)), pickle.HIGHEST_PROTOCOL)
        sys.stdout.flush()
        sys.stderr.flush()
        left = len(os.listdir("/proc/self/task")) > threads
        frames.send_bytes(results, (b"!" if left else b".") + answer)


def _prctl(option: int, value: int) -> None:
    if ctypes.CDLL(None, use_errno=True).prctl(option, value, 0, 0, 0):
        raise OSError(ctypes.get_errno(), f"prctl({option}, {value})")


if __name__ == "__main__":
    main()
