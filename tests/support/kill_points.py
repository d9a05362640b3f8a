"""The command line, killed by itself at its N-th write: `python kill_points.py N ARGUMENTS…` (N = 0 counts the writes instead).

A write is a line of the journal (killed with half of it on the disk), or a file that takes its place (killed with half of
it under its temporary name, or when it has just taken its place).
"""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path


class Points:
    """Counts writes and ends the process within the chosen one."""

    def __init__(self, chosen: int) -> None:
        self.chosen, self.count = chosen, 0

    def here(self) -> bool:
        self.count += 1
        return self.count == self.chosen

    def die(self) -> None:
        os.kill(os.getpid(), signal.SIGKILL)


class Torn:
    """A file whose chosen write stops in the middle."""

    def __init__(self, file, points):
        self._file, self._points = file, points

    def write(self, data):
        if len(data) > 1 and self._points.here():
            self._file.write(data[: len(data) // 2])
            self._file.flush()
            self._points.die()
        return self._file.write(data)

    def __getattr__(self, name):
        return getattr(self._file, name)


def install(points: Points) -> None:
    """Wrap the journal's file and the renaming of files."""
    from sonobench.harness import journal

    opened, replace = journal.Journal.__init__, os.replace

    def open_torn(self, *arguments, **more):
        opened(self, *arguments, **more)
        self._file = Torn(self._file, points)

    def replace_or_die(source, target):
        if points.here():
            os.truncate(source, os.stat(source).st_size // 2)
            points.die()
        replace(source, target)
        if points.here():
            points.die()

    journal.Journal.__init__, os.replace = open_torn, replace_or_die


def main() -> None:
    from sonobench.cli import main as command

    points = Points(int(sys.argv[1]))
    install(points)
    try:
        command(sys.argv[2:])
    finally:
        if points.chosen == 0:
            Path("writes.txt").write_text(str(points.count))


if __name__ == "__main__":
    main()
