"""The journal of a run: one JSON object a line, appended and flushed as each trial ends; a torn last line is no loss.

A line holds `trial` (a row of trials.parquet), or `trial_key` and `scores` ({score key: {"rows": […]} or {"error": …}}),
or `recording` ({recording key: hashes}).
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO


@dataclass(slots=True)
class Recorded:
    """What a journal says: the last line of a kind about a thing holds.

    Attributes:
        trials: row by trial key.
        outputs: row by estimate key, of trials that are ok.
        scores: {"rows": …} or {"error": …} by score key.
        recordings: (input_sha, truth_sha) by recording key.
    """

    trials: dict[str, dict[str, Any]] = field(default_factory=dict)
    outputs: dict[str, dict[str, Any]] = field(default_factory=dict)
    scores: dict[str, dict[str, Any]] = field(default_factory=dict)
    recordings: dict[str, tuple[str, str]] = field(default_factory=dict)

    def take(self, line: Mapping[str, Any]) -> None:
        """Add one line."""
        if "trial" in line:
            row = line["trial"]
            self.trials[row["trial_key"]] = row
            if row["status"] == "ok":
                self.outputs[row["estimate_key"]] = row
        self.scores.update(line.get("scores", {}))
        self.recordings.update({k: (v[0], v[1]) for k, v in line.get("recording", {}).items()})


class Journal:
    """Appends to a file and keeps what it says at hand; one process at a time (the run folder's lock sees to it)."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.recorded = read(path)
        self._file: BinaryIO = path.open("ab")
        if not _ends_well(path):
            self._file.write(b"\n")

    def add(self, **line: Any) -> None:
        """Append one line; it is with the operating system when this returns."""
        self._file.write(json.dumps(line, separators=(",", ":")).encode() + b"\n")
        self._file.flush()
        self.recorded.take(line)

    def close(self) -> None:
        """Have it on the disk."""
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()


def read(path: Path) -> Recorded:
    """What a journal says; lines that a killed run tore are passed over."""
    recorded = Recorded()
    if path.exists():
        with path.open("rb") as file:
            for text in file:
                try:
                    line = json.loads(text)
                except ValueError:
                    continue
                if isinstance(line, dict):
                    recorded.take(line)
    return recorded


def _ends_well(path: Path) -> bool:
    with path.open("rb") as file:
        if file.seek(0, os.SEEK_END) == 0:
            return True
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"
