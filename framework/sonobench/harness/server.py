"""The process that guards one worker: `python -m sonobench.harness.server IN OUT`.

It imports what every task needs (nothing that starts a thread), forks a worker, hands it one task at a time and watches it. Whatever the worker does
(raise, abort, exit, hang, hog, flood), exactly one answer goes back for each task. The guard is the subreaper of
everything below it, so that no grandchild outlives the worker, even one in a session of its own. When its parent is
gone it ends all that it started: it holds a handle of the parent's process, since other processes may keep the parent's pipes open.
"""

from __future__ import annotations

import ctypes
import faulthandler
import importlib
import os
import pickle
import select
import signal
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sonobench.harness import frames
from sonobench.harness.processes import descendants, end_below, kernel_kills, resident_mb
from sonobench.harness.warm import make_ready

LOG_CAP = 1_000_000  # bytes of a task's own output that are kept
_WATCH_S = 0.02  # how often the resident size is looked at
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
_TELL_WHERE = signal.SIGUSR1  # a worker that is told so prints its threads' stacks, also from within C code


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
        os.write(self._open(), data[:room])
        if len(data) > room:
            os.write(self._open(), b"\n[cut here: the output went on]\n")

    def note(self, text: str) -> None:
        """Add a line of the guard's own, whatever the cap."""
        if self._path is not None:
            os.write(self._open(), f"[{text}]\n".encode())

    def close(self) -> None:
        """End it."""
        if self._file >= 0:
            os.close(self._file)

    def _open(self) -> int:
        if self._file < 0 and self._path is not None:
            Path(self._path).parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(self._path, os.O_CREAT | os.O_WRONLY | os.O_TRUNC, 0o666)
        return self._file


@dataclass(frozen=True, slots=True)
class Parent:
    """Who asks: the ends of its pipes, and a handle that becomes readable when it dies."""

    inlet: int
    outlet: int
    handle: int

    def next(self) -> bytes | None:
        """Its next message, still pickled; None when it is gone."""
        ready = select.select([self.inlet, self.handle], [], [])[0]
        return None if self.handle in ready else frames.receive_bytes(self.inlet)

    def close(self) -> None:
        for fd in (self.inlet, self.outlet, self.handle):
            os.close(fd)


def main() -> None:
    """Serve until the parent is gone; nothing below outlives this, even where the guard itself fails."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)
    guard = os.getpid()
    try:
        _serve_all(int(sys.argv[1]), int(sys.argv[2]))
    except (BrokenPipeError, EOFError, ProcessLookupError):  # the parent is gone
        pass
    finally:
        if os.getpid() == guard:
            end_below()


def _serve_all(inlet: int, outlet: int) -> None:
    hello = frames.receive(inlet)
    parent = Parent(inlet, outlet, os.pidfd_open(hello["parent"]))
    sys.path[:] = hello["path"]
    make_ready(hello["warm"])
    perform = _named(hello["perform"])
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # up to here it ended us at once; from now on there is a worker to be ended first
    worker = _fork(parent, perform)
    while (limits := parent.next()) is not None and (task := parent.next()) is not None:
        answer, kept = _serve(worker, task, pickle.loads(limits), parent)
        if not kept:
            end_below()
            worker.close()
            worker = _fork(parent, perform)
        frames.send(parent.outlet, answer)


def _serve(worker: Worker, task: bytes, limits: dict[str, Any], parent: Parent) -> tuple[dict[str, Any], bool]:
    """The answer to one task, and whether the worker may take another."""
    log = Log(limits["log"])
    begin, kills = time.monotonic(), kernel_kills()
    deadline = None if limits["timeout_s"] is None else begin + limits["timeout_s"]
    with suppress(BrokenPipeError):  # it died between two tasks; its end is found below
        frames.send_bytes(worker.tasks, task)
    answer, kept = _watch(worker, deadline, limits, parent, log)
    if answer["status"] == "timeout":
        _tell_where(worker)
    _drain(worker.output, log)
    if answer.get("signal") == signal.SIGKILL and kernel_kills() > kills:
        answer |= {"status": "oom", "message": "killed by the kernel: the machine, or its share of it, was out of memory"}
    if answer["status"] != "ok":
        log.note(answer["message"])
    log.close()
    return {**answer, "log_bytes": log.size, "wall_s": time.monotonic() - begin}, kept


def _watch(worker: Worker, deadline: float | None, limits: dict[str, Any], parent: Parent, log: Log) -> tuple[dict[str, Any], bool]:
    poll = select.poll()
    for fd in (parent.inlet, parent.handle, worker.handle, worker.results, worker.output):
        poll.register(fd, select.POLLIN)
    incoming, peak, cap, hidden = frames.Frames(), 0.0, limits["memory_mb"], False
    while True:
        left = _WATCH_S if cap is not None else 1.0
        if deadline is not None:
            left = min(left, deadline - time.monotonic())
        ready = {fd for fd, _ in poll.poll(max(left, 0) * 1000)}
        if worker.output in ready:
            data = os.read(worker.output, 1 << 16)
            log.write(data)
            if not data:  # the task closed its standard streams: the next one needs a worker that has some
                hidden = True
                poll.unregister(worker.output)
        if worker.results in ready or worker.handle in ready:
            for result in incoming.feed(_available(worker.results)):
                retire = hidden or result[:1] == b"!"
                end_below(spare=worker.pid)
                return {"status": "ok", "value": result[1:], "peak_mb": peak}, not retire
        if worker.handle in ready:
            return {"status": "crash", "peak_mb": peak, **_end_of(worker.pid)}, False
        if parent.inlet in ready or parent.handle in ready:  # only its end can be: the parent waits for our answer
            raise EOFError
        if cap is not None:
            size = sum(map(resident_mb, descendants(os.getpid())))
            peak = max(peak, size)
            if size > cap:
                return {"status": "oom", "message": f"held {size:.0f} MB, {cap:g} MB are allowed (--memory)", "peak_mb": peak}, False
        if deadline is not None and time.monotonic() >= deadline:
            return {"status": "timeout", "message": f"took longer than {limits['timeout_s']:g} s (--timeout)", "peak_mb": peak}, False


def _tell_where(worker: Worker) -> None:
    """Have a worker that is about to be killed print where it is."""
    with suppress(ProcessLookupError):
        os.kill(worker.pid, _TELL_WHERE)
        select.select([worker.output, worker.handle], [], [], 0.2)
        time.sleep(0.01)  # several threads' stacks are several writes


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


def _end_of(pid: int) -> dict[str, Any]:
    _, status = os.waitpid(pid, 0)
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        name = signal.Signals(number).name if number in set(signal.Signals) else f"signal {number}"
        return {"message": f"killed by {name}", "signal": number}
    return {"message": f"the process ended itself with exit code {os.WEXITSTATUS(status)}"}


def _named(name: str) -> Callable[[Any], Any]:
    module, _, function = name.partition(":")
    found: Callable[[Any], Any] = getattr(importlib.import_module(module), function)
    return found


def _fork(parent: Parent, perform: Callable[[Any], Any]) -> Worker:
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
        parent.close()
        for fd in (task_out, result_in, output_in):
            os.close(fd)
        _become_worker(guard, output_out)
        _work(task_in, result_out, perform)
    except BaseException:  # the harness's own fault: `perform` raises nothing
        traceback.print_exc()
    finally:
        os._exit(70)  # never back into the guard's own loop


def _become_worker(guard: int, output: int) -> None:
    os.setsid()
    _prctl(_PR_SET_CHILD_SUBREAPER, 0)
    _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != guard:
        os._exit(0)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])  # a Dask worker that asks has it blocked
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    with suppress(OSError):  # a read-only /proc
        Path("/proc/self/oom_score_adj").write_text("1000")  # a hog that outruns the watch dies before anybody else
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.close(output)
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    faulthandler.enable(file=2)  # where it was when it crashed is in its log
    faulthandler.register(_TELL_WHERE, file=2)


def _work(tasks: int, results: int, perform: Callable[[Any], Any]) -> None:
    """Answer tasks until the guard is gone; a leading "!" asks for a fresh worker (a thread was left behind)."""
    me, home = os.getpid(), os.getcwd()
    while (content := frames.receive_bytes(tasks)) is not None:
        threads = len(os.listdir("/proc/self/task"))
        answer = pickle.dumps(perform(pickle.loads(content)), pickle.HIGHEST_PROTOCOL)
        if os.getpid() != me:  # a fork that the task made and forgot: the answer is its parent's to give
            return
        for stream in (sys.stdout, sys.stderr):
            with suppress(Exception):  # the task may have closed or replaced it
                stream.flush()
        signal.setitimer(signal.ITIMER_REAL, 0)  # an alarm that was set must not strike the next task
        os.chdir(home)
        left = len(os.listdir("/proc/self/task")) > threads
        frames.send_bytes(results, (b"!" if left else b".") + answer)


def _prctl(option: int, value: int) -> None:
    if ctypes.CDLL(None, use_errno=True).prctl(option, value, 0, 0, 0):
        raise OSError(ctypes.get_errno(), f"prctl({option}, {value})")


if __name__ == "__main__":
    main()
