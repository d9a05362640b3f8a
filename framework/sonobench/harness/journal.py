"""The journal of a run: one JSON object a line, appended and flushed as each trial ends; a torn last line is no loss.

A line holds `trial` (a row of trials.parquet), or `trial_key` and `scores` ({score key: {"rows": […]} or {"error": …}}),
or `recording` ({recording key: hashes}). What it says is not held in memory: only where each thing stands in the file,
so that a million trials take some hundred megabytes.
"""

from __future__ import annotations

import json
import os
import weakref
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

_RECENT = 1024  # decoded lines that are kept: a recording's trials are asked for several times in a row
_LENGTH_BITS = 32
_DECODER = json.JSONDecoder()


class Lines:
    """Lines of a file by where they stand: a number that holds position and length."""

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_RDONLY)
        weakref.finalize(self, os.close, self._fd)
        self._recent: dict[int, dict[str, Any]] = {}

    def __getitem__(self, place: int) -> dict[str, Any]:
        line = self._recent.get(place)
        if line is None:
            length = place & ((1 << _LENGTH_BITS) - 1)
            line = _decode(os.pread(self._fd, length, place >> _LENGTH_BITS))
            if len(self._recent) >= _RECENT:
                self._recent.clear()
            self._recent[place] = line
        return line


class Stored(Mapping[str, dict[str, Any]]):
    """What a journal says about things of one kind, by key; read from the file when asked for. Not to be changed."""

    def __init__(self, lines: Lines, part: str, by_key: bool) -> None:
        self._lines, self._part, self._by_key = lines, part, by_key
        self.places: dict[str, int] = {}

    def __getitem__(self, key: str) -> dict[str, Any]:
        found = self._lines[self.places[key]][self._part]
        return found[key] if self._by_key else found

    def get(self, key: str, default: Any = None) -> Any:
        """The thing, or the default."""
        return self[key] if key in self.places else default

    def __contains__(self, key: object) -> bool:
        return key in self.places

    def __iter__(self) -> Iterator[str]:
        return iter(self.places)

    def __len__(self) -> int:
        return len(self.places)


class Recorded:
    """What a journal says: the last line of a kind about a thing holds.

    Attributes:
        trials: row by trial key.
        outputs: row by estimate key, of trials that are ok.
        scores: {"rows": …} or {"error": …} by score key.
        recordings: (input_sha, truth_sha) by recording key.
    """

    def __init__(self, path: Path) -> None:
        lines = Lines(path)
        self.trials, self.outputs, self.scores = Stored(lines, "trial", False), Stored(lines, "trial", False), Stored(lines, "scores", True)
        self.recordings: dict[str, tuple[str, str]] = {}

    def take(self, line: Mapping[str, Any], position: int, length: int) -> None:
        """Add one line and where it stands."""
        place = position << _LENGTH_BITS | length
        if "trial" in line:
            row = line["trial"]
            self.trials.places[row["trial_key"]] = place
            if row["status"] == "ok":
                self.outputs.places[row["estimate_key"]] = place
        for key in line.get("scores", ()):
            self.scores.places[key] = place
        for key, (input_sha, truth_sha) in line.get("recording", {}).items():
            self.recordings[key] = input_sha, truth_sha


class Journal:
    """Appends to a file and says what it holds; one process at a time (the run folder's lock sees to it)."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: BinaryIO = path.open("ab")
        if not _ends_well(path):
            self._file.write(b"\n")
            self._file.flush()
        self.recorded = read(path)

    def add(self, **line: Any) -> None:
        """Append one line; it is with the operating system when this returns."""
        text = json.dumps(line, separators=(",", ":")).encode() + b"\n"
        position = self._file.tell()
        self._file.write(text)
        self._file.flush()
        self.recorded.take(line, position, len(text))

    def close(self) -> None:
        """Have it on the disk; what it says can still be asked for."""
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()


def read(path: Path) -> Recorded:
    """What a journal says; lines that a killed run tore are passed over."""
    recorded = Recorded(path)
    position = 0
    with path.open("rb") as file:
        for text in file:
            try:
                line = _decode(text)
            except ValueError:
                line = None
            if isinstance(line, dict):
                recorded.take(line, position, len(text))
            position += len(text)
    return recorded


def _decode(text: bytes) -> Any:
    """json.loads, at two thirds of its cost for lines that we wrote."""
    line = text.decode().rstrip("\n")
    value, end = _DECODER.raw_decode(line)
    return value if end == len(line) else json.loads(line)


def _ends_well(path: Path) -> bool:
    with path.open("rb") as file:
        if file.seek(0, os.SEEK_END) == 0:
            return True
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"
