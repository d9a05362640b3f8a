"""The Dask engine: the session's jobs in chunks by recording, each in a cell held by a Dask worker.

Dask only moves chunks and says which were lost. Isolation, limits and rows are the cells' and the session's, as with
the local engine; only the session writes the journal. A chunk that is lost with its worker is submitted again, each of
its jobs alone, and a job that was lost so often that it must be its own fault becomes a crash. Dask's own retries are
off: they know nothing of trials.
"""

from __future__ import annotations

import itertools
import queue
import secrets
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sonobench.errors import InputError
from sonobench.harness.cell import Limits, Outcome
from sonobench.harness.chunk import Chunk, abandon, carry_out
from sonobench.harness.code import code
from sonobench.harness.session import Job, Session

if TYPE_CHECKING:
    from distributed import Client, Future

_CHUNK = 20  # most jobs in a chunk: Dask's cost of a task, about 2 ms, is spread over them
_AHEAD = 2  # chunks under way for each of the workers' threads, so that none waits for us
_LOSSES = 3  # as often may a job be lost with its worker
_TICK_S = 0.5


def execute(
    session: Session,
    limits: Limits,
    numba_cache: Path,
    tick: Callable[[Iterable[Job]], None],
    client: Client,
) -> None:
    """Carry out a session's jobs on a Dask cluster until nothing is left.

    Raises:
        InputError: the workers run other code than this process, or the scheduler is gone.
    """
    crew = _Crew(session, limits, numba_cache, client)
    try:
        while session.ready or crew.busy:
            crew.send()
            tick(job for jobs in crew.busy.values() for job in jobs)
            for job, outcome in crew.receive():
                session.done(job, outcome)
    finally:
        crew.dismiss()


@dataclass(slots=True)
class _Crew:
    """The workers of one run, and what each is busy with."""

    session: Session
    limits: Limits
    numba_cache: Path
    client: Client
    busy: dict[Future, list[Job]] = field(default_factory=dict)
    _run: str = field(default_factory=lambda: secrets.token_hex(8))
    _ended: queue.SimpleQueue[Future] = field(default_factory=queue.SimpleQueue)
    _alone: list[Job] = field(default_factory=list)  # lost once: in a chunk of its own from now on
    _losses: Counter[str] = field(default_factory=Counter)
    _renders: dict[str, Mapping[str, Any]] = field(default_factory=dict)  # how to make each recording, by its key
    _code: tuple[tuple[str, ...], str] = ((), "")
    _numbers: Iterator[int] = field(default_factory=itertools.count)

    def __post_init__(self) -> None:
        modules = tuple(m for m in self.session.modules if not m.startswith("file:"))
        self._code = modules, code(*modules)

    def send(self) -> None:
        """Keep every thread of every worker supplied."""
        threads = max(sum(self._ask(self.client.nthreads).values()), 1)
        while len(self.busy) < _AHEAD * threads and (jobs := self._next(threads)):
            chunk = self._chunk(jobs)
            key = f"sonobench-{self._run}-{next(self._numbers)}"
            future = self._ask(self.client.submit, carry_out, chunk, key=key, pure=False, retries=0)
            self.busy[future] = jobs
            future.add_done_callback(self._ended.put)

    def receive(self) -> list[tuple[Job, Outcome]]:
        """Outcomes of what ended, after waiting a moment for the first; lost jobs wait to be sent again."""
        done: list[tuple[Job, Outcome]] = []
        try:
            future = self._ended.get(timeout=_TICK_S)
        except queue.Empty:
            return done
        jobs = self.busy.pop(future)
        if future.status == "finished":
            return list(zip(jobs, self._ask(future.result), strict=True))
        self._refuse_faults(future)
        for job in jobs:
            self._losses[_name(job)] += 1
            if self._losses[_name(job)] < _LOSSES or len(jobs) > 1:
                self._alone.append(job)
            else:
                done.append((job, Outcome("crash", exc_type="CellDied", exc_message=f"its Dask worker died {_LOSSES} times under it")))
        return done

    def dismiss(self) -> None:
        """End what is still under way and all cells of this run."""
        from contextlib import suppress

        with suppress(Exception):  # the scheduler may be what is gone; idle cells end by themselves
            self.client.cancel(list(self.busy))
            self.client.run(abandon, self._run)

    def _next(self, threads: int) -> list[Job]:
        """Jobs of one recording: few while few are left, so that all workers have some."""
        if self._alone:
            return [self._alone.pop()]
        ready = self.session.ready
        size = min(_CHUNK, -(-len(ready) // (_AHEAD * threads)))
        jobs: list[Job] = []
        while ready and len(jobs) < size and (not jobs or ready[0].take is jobs[0].take):
            jobs.append(ready.popleft())
        return jobs

    def _chunk(self, jobs: list[Job]) -> Chunk:
        take = jobs[0].take
        for job in jobs:
            if job.task["step"] == "render":
                self._renders[take.key] = job.task
            if job.log is not None:
                job.log.unlink(missing_ok=True)
        return Chunk(
            run=self._run,
            modules=self._code[0],
            code=self._code[1],
            numba_cache=str(self.numba_cache),
            limits=self.limits,
            steps=tuple((job.task, None if job.log is None else str(job.log)) for job in jobs),
            render=self._renders.get(take.key) if jobs[0].task["step"] != "render" else None,
            input_sha=self.session.journal.recorded.recordings.get(take.key, ("",))[0],
        )

    def _refuse_faults(self, future: Future) -> None:
        """Raise what is no loss of a worker: then all chunks would end so."""
        from distributed import KilledWorker

        if future.status != "error":
            return
        error = future.exception()
        if isinstance(error, KilledWorker):
            return
        if isinstance(error, InputError):
            raise error
        raise InputError(
            f"a Dask worker could not start a trial ({type(error).__name__}: {error}); it needs the same sonobench as this process"
        )

    def _ask(self, function: Callable[..., Any], *args: Any, **options: Any) -> Any:
        try:
            return function(*args, **options)
        except OSError as error:  # Dask's CommClosedError and its timeouts too
            gone = f"the Dask scheduler at {self.client.scheduler.address if self.client.scheduler else '?'} is gone"
            raise InputError(f"{gone} ({error}); what ended is kept, run again to go on") from None


def _name(job: Job) -> str:
    return f"{job.task['step']} {job.take.key} {job.trials[0].trial_key}"
