"""The journal of a run: one JSON object a line, appended and flushed as each trial ends; a torn last line is no loss.

A line holds `trial` (a row of trials.parquet), or `trial_key` and `scores` ({score key: {"rows": […]} or {"error": …}}),
or `recording` ({recording key: hashes}). What it says is not held in memory: only where each thing stands in the file,
so that a million trials take some hundred megabytes.

Most lines say what is plainly there: a trial that is ok and not open, scores of metrics that did not fail. Those begin with a
checksum of the rest of the line and a head, and reading decodes no more than the head of a line that is whole:

    {"crc":"9f3a12bc","is":"trial NAME TRIAL_KEY ESTIMATE_KEY","trial":{…}}      NAME: rows.whole_name
    {"crc":"0c11aa07","is":"scores SCORE_KEY …","trial_key":…,"scores":{…}}

All others, and lines whose checksum is wrong (torn, edited by hand), are decoded when they are read.
"""

from __future__ import annotations

import json
import os
import weakref
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from sonobench.harness.rows import OWN_NAMES, shared_name, whole_name

_RECENT = 1024  # decoded lines that are kept: a recording's trials are asked for several times in a row
_LENGTH_BITS = 32
_PLAIN = 1 << 31  # in a place: the line's head says all that the index needs
_START, _CHECKED, _HEAD = b'{"crc":"', 18, 24  # how a line begins; where what is checked and where the head begin
_NAME = len("trial "), len("trial ") + 16  # where the name stands in a trial's head
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
            line = _decode(os.pread(self._fd, place & (_PLAIN - 1), place >> _LENGTH_BITS))
            if len(self._recent) >= _RECENT:
                self._recent.clear()
            self._recent[place] = line
        return line

    def several(self, places: Sequence[int]) -> list[dict[str, Any]]:
        """Lines decoded together, at two thirds of the cost; none of them is kept."""
        texts = [os.pread(self._fd, place & (_PLAIN - 1), place >> _LENGTH_BITS) for place in places]
        found: list[dict[str, Any]] = json.loads(b"[%s]" % b",".join(texts))
        return found

    def name(self, place: int) -> bytes:
        """The name in a plain trial's head."""
        return os.pread(self._fd, _NAME[1] - _NAME[0], (place >> _LENGTH_BITS) + _HEAD + _NAME[0])


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

    def several(self, keys: Iterable[str]) -> dict[str, dict[str, Any]]:
        """Those of many things that are there; their lines are read together."""
        wanted = {key: self.places[key] for key in keys if key in self.places}
        places = list(dict.fromkeys(wanted.values()))
        lines = dict(zip(places, (line[self._part] for line in self._lines.several(places)), strict=True))
        return {key: lines[place][key] if self._by_key else lines[place] for key, place in wanted.items()}

    def is_plain(self, key: str) -> bool:
        """Whether it is there, a row that is ok and not open, or scores."""
        return bool(self.places.get(key, 0) & _PLAIN)

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
        lines = self._lines = Lines(path)
        self.trials, self.outputs, self.scores = Stored(lines, "trial", False), Stored(lines, "trial", False), Stored(lines, "scores", True)
        self.recordings: dict[str, tuple[str, str]] = {}

    def take(self, text: bytes, position: int) -> None:
        """Add one line and where it stands; one that is not JSON says nothing."""
        place = position << _LENGTH_BITS | len(text)
        kind, *keys = _head_of(text)
        if kind == "trial":
            self.trials.places[keys[1]] = self.outputs.places[keys[2]] = place | _PLAIN
        elif kind == "scores":
            self.scores.places.update(dict.fromkeys(keys, place | _PLAIN))
        else:
            with suppress(KeyError, TypeError, AttributeError, ValueError):  # somebody's own line: it says nothing either
                self._take_decoded(text, place)

    def is_named(self, trial_key: str, estimate_key: str, name: str) -> bool:
        """Whether the last line of a trial is a plain one of this name (`rows.whole_name`) and output."""
        place = self.trials.places.get(trial_key, 0)
        return bool(place & _PLAIN) and self.outputs.places.get(estimate_key) == place and self._lines.name(place) == name.encode()

    def _take_decoded(self, text: bytes, place: int) -> None:
        try:
            line = _decode(text)
        except ValueError:
            return
        if not isinstance(line, dict):
            return
        if "trial" in line:
            key, status, output = (line["trial"][name] for name in ("trial_key", "status", "estimate_key"))
            self.trials.places[key] = place
            if status == "ok":
                self.outputs.places[output] = place
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
        text = encoded(line)
        position = self._file.tell()
        self._file.write(text)
        self._file.flush()
        self.recorded.take(text, position)

    def close(self) -> None:
        """Have it on the disk; what it says can still be asked for."""
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()


def read(path: Path) -> Recorded:
    """What a journal says, nothing where there is none; lines that a killed run tore are passed over."""
    path = path if path.exists() else Path(os.devnull)
    recorded = Recorded(path)
    position = 0
    with path.open("rb") as file:
        for text in file:
            recorded.take(text, position)
            position += len(text)
    return recorded


def encoded(line: Mapping[str, Any]) -> bytes:
    """A line as it stands in the file."""
    text = json.dumps(line, separators=(",", ":"))
    checked = f'"is":"{_head(line)}",{text[1:]}\n'.encode()
    return b'%s%08x",%s' % (_START, zlib.crc32(checked), checked)


def _head(line: Mapping[str, Any]) -> str:
    """What reading needs to know of a plain line; "" of any other."""
    row, scores = line.get("trial"), line.get("scores")
    if row and row["status"] == "ok" and not row["open"]:
        return f"trial {whole_name(shared_name(row), *(row[k] for k in OWN_NAMES))} {row['trial_key']} {row['estimate_key']}"
    if scores and all("rows" in found and not found.get("beyond") for found in scores.values()):
        return " ".join(["scores", *scores])
    return ""


def _head_of(text: bytes) -> list[str]:
    """The words of a whole line's head; [""] where the line must be decoded."""
    if not text.startswith(_START) or b"%08x" % zlib.crc32(memoryview(text)[_CHECKED:]) != text[len(_START) : _CHECKED - 2]:
        return [""]
    return text[_HEAD : text.index(b'"', _HEAD)].decode().split(" ")


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
