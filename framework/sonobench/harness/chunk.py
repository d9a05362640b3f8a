"""What a Dask worker does with a chunk: its jobs one after the other in a cell that the worker process holds.

The recording is made where it is missing, so a cache folder that is local to a machine does as well as a shared one.
"""

from __future__ import annotations

import select
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sonobench.errors import InputError
from sonobench.harness.cell import Cell, Limits, Outcome, close_all
from sonobench.harness.code import code, forget

_IDLE_S = 120.0  # a run that was killed leaves its cells to this clock
_FIRST = threading.Lock()  # the threads of a worker get their first chunks at once; Python 3.11 cannot parse in two of them
_LOOK_S = 0.25  # how often a busy cell looks whether its run was given up


@dataclass(frozen=True, slots=True)
class Chunk:
    """Jobs on one recording, as they travel.

    Attributes:
        run: names the run that they are of.
        modules, code: what the run depends on; a worker that reads other sources refuses.
        numba_cache: where compiled code is kept.
        limits: of each job.
        steps: (task, path of its log) of each job.
        render: the task that makes the recording where it is missing; None: it need not be there, or it is the user's file.
        input_sha: what the recording must be.
    """

    run: str
    modules: tuple[str, ...]
    code: str
    numba_cache: str
    limits: Limits
    steps: tuple[tuple[Mapping[str, Any], str | None], ...]
    render: Mapping[str, Any] | None
    input_sha: str


class Abandoned(Exception):
    """The run that a chunk is of was given up."""


@dataclass(slots=True)
class Cells:
    """The cells that one worker process holds for one run: one a thread, since each does one job at a time."""

    idle: list[tuple[Cell, threading.Timer]] = field(default_factory=list)
    abandoned: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock)

    @contextmanager
    def one(self, numba_cache: Path) -> Iterator[Cell]:
        """An idle cell or a new one; it is kept for the next chunk, but for two minutes at most."""
        with self.lock:
            cell, timer = self.idle.pop() if self.idle else (None, None)
        if timer is not None:
            timer.cancel()
        cell = cell or Cell(numba_cache)
        try:
            yield cell
        except BaseException:
            cell.close()
            raise
        timer = threading.Timer(_IDLE_S, self._dispose, [cell])
        timer.daemon = True
        with self.lock:
            if not self.abandoned:
                self.idle.append((cell, timer))
                timer.start()
                return
        cell.close()

    def close(self) -> None:
        """Give the run up: idle cells end now, busy ones within a moment."""
        with self.lock:
            self.abandoned = True
            idle, self.idle = self.idle, []
        for _, timer in idle:
            timer.cancel()
        close_all([cell for cell, _ in idle])

    def _dispose(self, cell: Cell) -> None:
        with self.lock:
            mine = [pair for pair in self.idle if pair[0] is cell]
            self.idle = [pair for pair in self.idle if pair[0] is not cell]
        close_all([cell for cell, _ in mine])


def carry_out(chunk: Chunk) -> list[Outcome]:
    """The outcome of each job of a chunk, in its order.

    Raises:
        InputError: this worker's code or its rendering differs from the run's.
        Abandoned: the run was given up meanwhile.
    """
    from distributed import get_worker

    worker = get_worker()
    held: dict[str, Cells] = worker.__dict__.setdefault("sonobench_cells", {})
    with _FIRST:
        if chunk.run not in held:
            _compare(chunk, worker.address)
            held[chunk.run] = Cells()
        cells = held[chunk.run]
    with cells.one(Path(chunk.numba_cache)) as cell:
        if chunk.render is not None and not Path(chunk.render["recording"]).exists():
            made = _outcome(cell, cells, chunk, chunk.render, None)
            if made.status != "ok":
                return [made] * len(chunk.steps)
            if made.value["input_sha"] != chunk.input_sha:
                raise InputError(f"Dask worker {worker.address} renders other samples than the first machine did; share the cache folder")
        return [_outcome(cell, cells, chunk, task, log) for task, log in chunk.steps]


def abandon(run: str, dask_worker: Any) -> None:
    """Give up a run on this worker; Dask's `Client.run` passes the worker."""
    cells = dask_worker.__dict__.setdefault("sonobench_cells", {}).pop(run, None)
    if cells is not None:
        cells.close()


def _outcome(cell: Cell, cells: Cells, chunk: Chunk, task: Mapping[str, Any], log: str | None) -> Outcome:
    cell.submit(task, chunk.limits, None if log is None else Path(log))
    while not select.select([cell], [], [], _LOOK_S)[0]:
        if cells.abandoned:
            raise Abandoned(f"run {chunk.run} was given up")
    return cell.take()


def _compare(chunk: Chunk, address: str) -> None:
    """Keys are made of the run's own code, so a worker must have the same."""
    forget()
    if code(*chunk.modules) != chunk.code:
        raise InputError(
            f"Dask worker {address} has other code than this run: versions of sonobench, plugins, Python and the packages that they "
            "import must be the same; install the same there, or restart its workers after an edit"
        )
