"""A cell runs one task at a time, apart from us: whatever the task does, one outcome comes back."""

from __future__ import annotations

import os
import pickle
import secrets
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sonobench.harness import frames
from sonobench.harness.processes import MARK, end_marked, uninterrupted
from sonobench.harness.warm import WARM

_PATIENCE_S = 0.7  # for a guard to end what is below it, before it is ended itself

#: one thread each, so that two workers on two cores do not fight, and sums are added in one order
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


@dataclass(frozen=True, slots=True)
class Limits:
    """What one step of a trial may take: seconds, and MB of resident memory of its whole process tree; None is no limit."""

    timeout_s: float | None = None
    memory_mb: float | None = None


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a task.

    Attributes:
        status: ok, error, invalid, crash, timeout or oom.
        value: what the task returned, where it is ok.
        exc_type, exc_message: what went wrong.
        wall_s: seconds from dispatch to answer.
        peak_mb: the most that the process held.
        log_bytes: size of the task's own output.
        beyond: what the task used that its keys do not cover, in words.
    """

    status: str
    value: Any = None
    exc_type: str = ""
    exc_message: str = ""
    wall_s: float = 0.0
    peak_mb: float = 0.0
    log_bytes: int = 0
    beyond: Sequence[str] = ()


class Cell:
    """A guarded worker process; see `server`.

    Args:
        numba_cache: where compiled code is kept.
        perform: "module:function" that turns a task into a dictionary of Outcome's fields and never raises.
        warm: what is made ready before workers are forked, so that a fresh worker costs milliseconds; see `warm`.
    """

    def __init__(
        self, numba_cache: Path | None = None, perform: str = "sonobench.harness.trial:perform", warm: tuple[str, ...] = WARM
    ) -> None:
        self._perform, self._warm, self._mark = perform, warm, secrets.token_hex(8)
        self._environment = {**os.environ, **ONE_THREAD, MARK: self._mark}
        if numba_cache is not None:
            self._environment["NUMBA_CACHE_DIR"] = str(numba_cache)
        self._process: subprocess.Popen[bytes] | None = None
        self._to = self._from = -1
        self._start()

    def _start(self) -> None:
        theirs_in, self._to = os.pipe()
        self._from, theirs_out = os.pipe()
        command = [sys.executable, "-P", "-m", "sonobench.harness.server", str(theirs_in), str(theirs_out)]
        home = str(Path(__file__).parents[2])
        environment = {**self._environment, "PYTHONPATH": os.pathsep.join([home, *filter(None, [os.environ.get("PYTHONPATH")])])}
        with uninterrupted():  # an interrupted Popen would be a process that nobody knows
            self._process = subprocess.Popen(
                command, pass_fds=(theirs_in, theirs_out), env=environment, stdin=subprocess.DEVNULL, start_new_session=True
            )
        os.close(theirs_in)
        os.close(theirs_out)
        path = [p or os.getcwd() for p in sys.path]
        with suppress(BrokenPipeError):  # `take` finds the end of its pipe
            frames.send(self._to, {"parent": os.getpid(), "path": path, "perform": self._perform, "warm": self._warm})

    def fileno(self) -> int:
        """Readable when the outcome of the submitted task is there."""
        return self._from

    def submit(self, task: Mapping[str, Any], limits: Limits, log: Path | None = None) -> None:
        """Hand over one task; the one before must have been taken."""
        head = {"timeout_s": limits.timeout_s, "memory_mb": limits.memory_mb, "log": None if log is None else str(log)}
        with suppress(BrokenPipeError):  # the guard was killed; `take` finds the end of its pipe
            frames.send(self._to, head)
            frames.send(self._to, dict(task))

    def take(self) -> Outcome:
        """Wait for the outcome of the submitted task."""
        try:
            answer = frames.receive(self._from)
        except EOFError:
            code = self._process.wait() if self._process else None
            self.close()
            end_marked(self._mark)  # grandchildren in sessions of their own, which the guard would have ended
            self._start()
            how = f"failed with exit code {code}, see stderr" if code and code > 0 else "was killed from outside"
            return Outcome("crash", exc_type="CellDied", exc_message=f"the guarding process {how}")
        common = {"wall_s": answer["wall_s"], "log_bytes": answer["log_bytes"]}
        if answer["status"] != "ok":
            kinds = {"crash": "Crash", "timeout": "TimeoutError", "oom": "MemoryError"}
            kind = kinds[answer["status"]]
            return Outcome(answer["status"], exc_type=kind, exc_message=answer["message"], peak_mb=answer["peak_mb"], **common)
        result = pickle.loads(answer["value"])
        peak = max(answer["peak_mb"], result.pop("peak_mb"))
        return Outcome(**result, peak_mb=peak, **common)

    def close(self) -> None:
        """End the worker and everything below it."""
        close_all([self])

    def _hang_up(self) -> None:
        """The guard sees the end of its pipe and ends what is below it."""
        if self._to >= 0:
            os.close(self._to)
            os.close(self._from)
            self._to = self._from = -1
        if self._process is not None:
            self._process.terminate()  # heeded only while it imports and has nothing below it

    def _wait(self, until: float) -> None:
        if self._process is None:
            return
        try:
            self._process.wait(timeout=max(until - time.monotonic(), 0))
        except subprocess.TimeoutExpired:  # it is stopped, or starved
            self._process.kill()
            self._process.wait()
            end_marked(self._mark)
        self._process = None


def close_all(cells: Iterable[Cell]) -> None:
    """End cells together, within about a second however many they are."""
    cells = list(cells)
    for cell in cells:
        cell._hang_up()
    until = time.monotonic() + _PATIENCE_S
    for cell in cells:
        cell._wait(until)
