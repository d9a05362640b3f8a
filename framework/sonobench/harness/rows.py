"""Rows of trials.parquet and scores.parquet: the contract that boards, reports and other tools read."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from sonobench.harness.cell import Limits, Outcome

if TYPE_CHECKING:
    from sonobench.harness.plan import PlannedTrial

Row = dict[str, Any]
SCHEMA = 1

DISK = "DiskError"  # exc_type where a disk was full or could not be written
_MESSAGE_CAP = 4000  # characters of a message that a row keeps; the log has all of it

#: columns of trials.parquet with their pandas dtypes; `p_*` columns of the sweep stand after `dirty`
TRIAL_COLUMNS: Mapping[str, str] = {
    "trial_key": "string",
    "study": "string",
    "pipeline": "string",
    "distribution": "string",
    "version": "string",
    "code_sha": "string",
    "dirty": "bool",
    "scene": "string",
    "repetition": "int64",
    "run": "int64",
    "scene_sha": "string",
    "pipeline_sha": "string",
    "recording_key": "string",
    "input_sha": "string",
    "truth_sha": "string",
    "estimate_key": "string",
    "status": "string",
    "exc_type": "string",
    "exc_message": "string",
    "attempts": "int64",
    "timeout_s": "float64",
    "memory_mb": "float64",
    "open": "bool",
    "open_because": "string",
    "log_path": "string",
    "wall_s": "float64",
    "cpu_s": "float64",
    "front_end_s": "float64",
    "tracker_s": "float64",
    "frames": "int64",
    "real_time_factor": "float64",
    "peak_mb": "float64",
    "given": "string",
    "estimates_path": "string",
    "output_sha": "string",
    "env_id": "string",
}
SCORE_COLUMNS: Mapping[str, str] = {
    "trial_key": "string",
    "metric": "string",
    "metric_sha": "string",
    "slice": "string",
    "value": "float64",
    "weight": "float64",
    "unit": "string",
    "better": "string",
    "pool": "string",
    "coverage": "float64",
}
#: what names a trial in its row, the rest says what became of it: what source and entry share (with `p_*`), and the trial's own
SHARED_NAMES = ("study", "pipeline", "distribution", "version", "scene", "scene_sha", "pipeline_sha")
OWN_NAMES = ("trial_key", "repetition", "run", "recording_key", "truth_sha")
_ZERO: Mapping[str, Any] = {"string": "", "bool": False, "int64": 0, "float64": None}


def planned_row(trial: PlannedTrial, columns: tuple[str, ...]) -> Row:
    """The row of a trial that has not run: status "skipped"."""
    row = {name: _ZERO[dtype] for name, dtype in TRIAL_COLUMNS.items()}
    swept = {**trial.source.swept, **trial.entry.swept}
    return row | {
        "trial_key": trial.trial_key,
        "study": trial.study,
        "pipeline": trial.pipeline,
        "distribution": trial.entry.distribution,
        "version": trial.entry.version,
        "dirty": trial.entry.dirty,
        "scene": trial.scene,
        "repetition": trial.repetition,
        "run": trial.run,
        "status": "skipped",
        **{name: swept.get(name) for name in columns},
    }


def shared_name(row: Mapping[str, Any]) -> str:
    """One word for what a row has of its source and its entry."""
    shared = [[k, row.get(k)] for k in (*SHARED_NAMES, *sorted(k for k in row if k.startswith("p_")))]
    return hashlib.sha256(json.dumps(shared).encode()).hexdigest()


def whole_name(shared: str, *own: Any) -> str:
    """One word (16 hexadecimal digits) for all that names a trial, from the shared name and the values of `OWN_NAMES`."""
    return hashlib.sha256(" ".join([shared, *map(str, own)]).encode()).hexdigest()[:16]


def failed_row(row: Row, outcome: Outcome, prefix: str = "", log_path: str = "") -> Row:
    """The row of a trial that ended badly."""
    return row | {
        "status": outcome.status,
        "exc_type": outcome.exc_type,
        "exc_message": prefix + _storable(outcome.exc_message),
        "wall_s": outcome.wall_s or None,
        "peak_mb": outcome.peak_mb or None,
        "log_path": log_path,
    }


def stands(failure: Mapping[str, Any], limits: Limits) -> bool:
    """Whether a failure of unchanged code need not be tried again: it was the code's own, and no limit that it met is higher now.

    Args:
        failure: status, exc_type and the limits timeout_s and memory_mb that it ended under (None: none).
        limits: those of the run that is being planned.
    """
    if failure.get("exc_type") in ("CellDied", DISK):  # killed from outside
        return False
    met = {"timeout": ("timeout_s", limits.timeout_s), "oom": ("memory_mb", limits.memory_mb)}
    if failure.get("status") not in met:
        return True
    name, now = met[failure["status"]]
    before = failure.get(name)
    return before is None or (now is not None and now <= before)


def _storable(message: str) -> str:
    """A message as Parquet takes it: no lone surrogates, no megabytes."""
    text = message.encode("utf-8", "backslashreplace").decode("utf-8")
    return text if len(text) <= _MESSAGE_CAP else f"{text[:_MESSAGE_CAP]} …"
