"""The local engine: cells on this machine, or none at all for debuggers."""

from __future__ import annotations

import os
import select
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO, cast

from sonobench.harness.cell import Cell, Limits, Outcome, close_all
from sonobench.harness.processes import uninterrupted
from sonobench.harness.server import Log
from sonobench.harness.session import Job, Session

_TICK_S = 0.5  # how often progress is told while nothing ends


def processors() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0))


def execute(session: Session, jobs: int, limits: Limits, numba_cache: Path, tick: Callable[[Iterable[Job]], None]) -> None:
    """Carry out a session's jobs in `jobs` cells until nothing is left; all processes end with it, also when interrupted."""
    cells: list[Cell] = []
    busy: dict[Cell, Job] = {}
    try:
        while session.ready or busy:
            while session.ready and len(busy) < jobs:
                cell = next((c for c in cells if c not in busy), None)
                if cell is None:
                    with uninterrupted():
                        cell = Cell(numba_cache)
                        cells.append(cell)
                job = busy[cell] = session.ready.popleft()
                _forget_log(job)
                cell.submit(job.task, limits, job.log)
            tick(busy.values())
            for cell in select.select(list(busy), [], [], _TICK_S)[0]:
                session.done(busy.pop(cell), cell.take())
    finally:
        close_all(cells)


def execute_here(session: Session, tick: Callable[[Iterable[Job]], None]) -> None:
    """Carry out a session's jobs in this process: no isolation, no limits, and a trial's exception is a row all the same.

    A step's log is a copy of what went to sys.stderr: tracebacks and warnings; stdout is the debugger's.
    """
    from sonobench.harness.trial import forget, perform

    forget()
    while session.ready:
        job = session.ready.popleft()
        tick([job])
        _forget_log(job)
        begin = time.perf_counter()
        with _copied(job.log):
            result = perform(job.task)
        if result.get("exc_type") == "KeyboardInterrupt":  # in this process it is the user's, not the component's
            raise KeyboardInterrupt
        session.done(job, Outcome(**result, wall_s=time.perf_counter() - begin))


@contextmanager
def _copied(path: Path | None) -> Iterator[None]:
    log = Log(None if path is None else str(path))
    try:
        with redirect_stderr(cast(TextIO, _Copied(sys.stderr, log))):
            yield
    finally:
        log.close()


@dataclass(frozen=True, slots=True)
class _Copied:
    """A stream, and a copy of what is written to it."""

    stream: TextIO
    log: Log

    def write(self, text: str) -> int:
        self.log.write(text.encode("utf-8", "backslashreplace"))
        return self.stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


def _forget_log(job: Job) -> None:
    if job.log is not None:
        job.log.unlink(missing_ok=True)
