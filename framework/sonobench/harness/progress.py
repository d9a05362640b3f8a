"""Progress on stderr: a bar on a terminal, else a line every ten seconds."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Protocol, TextIO

_LINE_EVERY_S = 10.0


@dataclass(frozen=True, slots=True)
class Tally:
    """Where a run stands: trials planned, finished, of these failed; steps under way."""

    planned: int
    finished: int
    failed: int
    running: int


class Display(Protocol):
    """Shows tallies as they come."""

    def __enter__(self) -> Display: ...

    def __call__(self, tally: Tally) -> None: ...

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None: ...


def display(stream: TextIO | None = None) -> Display:
    """The display that suits a stream (stderr)."""
    stream = sys.stderr if stream is None else stream
    return Bar(stream) if stream.isatty() else Lines(stream)


@dataclass(slots=True)
class Lines:
    """A line every ten seconds, and one at the end."""

    stream: TextIO
    _begin: float = field(default_factory=time.monotonic)
    _told: float = field(default_factory=time.monotonic)
    _last: Tally | None = None

    def __enter__(self) -> Lines:
        return self

    def __call__(self, tally: Tally) -> None:
        self._last = tally
        if time.monotonic() - self._told >= _LINE_EVERY_S:
            self._tell()

    def __exit__(self, *_: object) -> None:
        self._tell()

    def _tell(self) -> None:
        self._told = time.monotonic()
        if self._last is not None:
            t = self._last
            failed = f", {t.failed} failed" if t.failed else ""
            running = f", {t.running} running" if t.running else ""
            spent = self._told - self._begin
            print(f"{t.finished} of {t.planned} trials{failed}{running} after {spent:.0f} s", file=self.stream, flush=True)


class Bar:
    """A rich progress bar."""

    def __init__(self, stream: TextIO) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        self._bar = Progress(
            TextColumn("trials"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[failed]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=Console(file=stream),
        )
        self._task: Any = None

    def __enter__(self) -> Bar:
        self._bar.start()
        return self

    def __call__(self, tally: Tally) -> None:
        failed = f"[red]{tally.failed} failed" if tally.failed else ""
        if self._task is None:
            self._task = self._bar.add_task("trials", total=tally.planned, failed=failed)
        self._bar.update(self._task, completed=tally.finished, failed=failed)

    def __exit__(self, *_: object) -> None:
        self._bar.stop()


class Silent:
    """Shows nothing."""

    def __enter__(self) -> Silent:
        return self

    def __call__(self, tally: Tally) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass
