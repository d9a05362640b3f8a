"""The folder of a run: its lock, its files, its tables (the harness's only user of pandas)."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sonobench.errors import InputError
from sonobench.files import is_temporary, replace_file, temporaries
from sonobench.harness.compaction import dtype_of, writer
from sonobench.harness.processes import uninterrupted
from sonobench.harness.rows import SCHEMA, SCORE_COLUMNS, TRIAL_COLUMNS, Row

if TYPE_CHECKING:
    import pandas as pd

#: columns that a board needs
_NEEDED = {
    "trials": ("trial_key", "pipeline", "scene", "repetition", "run", "status", "front_end_s", "tracker_s", "frames"),
    "scores": ("trial_key", "metric", "slice", "value", "weight", "unit", "better", "pool", "coverage"),
}
_OURS = ("journal.jsonl", "parts.jsonl", "verify.json", "trials.parquet", "scores.parquet", "env.json", "estimates", "logs", "report")


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Make the folder where it is missing, and hold it alone.

    Raises:
        InputError: another run holds it, or it holds something else than a run.
    """
    import filelock

    refuse_foreign(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = filelock.FileLock(folder / ".lock", timeout=0)
        lock.acquire()
    except filelock.Timeout:
        raise InputError(f"{folder}: another run is writing here; wait for it, or choose another folder with --out") from None
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from None
    try:
        yield
    finally:
        lock.release()


def refuse_foreign(folder: Path) -> None:
    """Nothing is written where something else than a run is.

    Raises:
        InputError: a file, or a folder that holds something else.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; a run needs a folder")
    if folder.is_dir() and any(folder.iterdir()) and not is_run(folder):
        raise InputError(f"{folder}: is not empty and is no run's folder; choose another with --out")


def is_run(folder: Path) -> bool:
    """Whether a folder is a run's (or one that was killed right at its start, before study.json was whole)."""
    return (folder / "study.json").is_file() or all(_is_beginning(p) for p in folder.iterdir())


def _is_beginning(path: Path) -> bool:
    if path.is_dir():
        return path.name in ("estimates", "logs") and not any(path.iterdir())
    return path.name == ".lock" or is_temporary(path)


def clear(folder: Path) -> None:
    """Throw away what earlier runs left, and nothing else."""
    for name in _OURS:
        path = folder / name
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def prepare(folder: Path, study: Mapping[str, Any], environment: Mapping[str, Any]) -> None:
    """Write study.json and env.json, make the folders that trials write to, and remove what a killed run had half written."""
    for name in ("estimates", "logs"):
        try:
            (folder / name).mkdir(exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder / name}: the folder cannot be made: {error.strerror}") from error
    for path in (*temporaries(folder), *temporaries(folder / "estimates")):
        path.unlink(missing_ok=True)
    replace_file(folder / "study.json", _json({"schema": SCHEMA, **study}))
    replace_file(folder / "env.json", _json(environment))


def load() -> None:
    """Import what writing tables needs; an interrupt waits until that is whole."""
    if "pandas" in sys.modules and "pyarrow.parquet" in sys.modules:
        return
    with uninterrupted():
        import pandas  # noqa: F401
        import pyarrow.parquet  # noqa: F401


def write_tables(folder: Path, rows: Iterable[tuple[Row, Sequence[Row]]], swept: Mapping[str, Sequence[Any]]) -> None:
    """Compact to trials.parquet and scores.parquet.

    Args:
        rows: of each trial, with its scores.
        swept: the values that each `p_*` column takes, None among them where some rows have none.
    """
    trials = _trial_columns({name: dtype_of(values) for name, values in swept.items()})
    with writer(folder / "trials.parquet", trials) as add_trial, writer(folder / "scores.parquet", SCORE_COLUMNS) as add_score:
        for trial, scores in rows:
            add_trial(trial)
            for score in scores:
                add_score(score)


def write_scores(folder: Path, scores: Iterable[Row]) -> None:
    """scores.parquet alone."""
    with writer(folder / "scores.parquet", SCORE_COLUMNS) as add:
        for score in scores:
            add(score)


def read_table(folder: Path, name: str, columns: Iterable[str] = ()) -> pd.DataFrame:
    """trials.parquet or scores.parquet; columns beyond those that a board needs may be asked for.

    Raises:
        InputError: it is missing, cannot be read, or lacks columns.
    """
    import pandas as pd

    try:
        table = pd.read_parquet(folder / f"{name}.parquet")
    except FileNotFoundError:
        raise InputError(f"{folder}: has no {name}.parquet; the run was killed before its end: start it again to go on") from None
    except (OSError, ValueError) as error:
        raise InputError(
            f"{folder / name}.parquet: cannot be read: {error}; remove it, and run the study again to have it written"
        ) from None
    lacking = [c for c in dict.fromkeys([*_NEEDED[name], *columns]) if c not in table]
    if lacking:
        raise InputError(f"{folder / name}.parquet: lacks the columns {lacking}; remove it, and run the study again to have it written")
    return table


def read_study(folder: Path) -> dict[str, Any]:
    """study.json.

    Raises:
        InputError: there is none, it is damaged, or a later version wrote it.
    """
    try:
        content = json.loads((folder / "study.json").read_text("utf-8"))
    except FileNotFoundError:
        raise InputError(f"{folder}: is no run's folder (it has no study.json)") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{folder / 'study.json'}: cannot be read: {error}") from None
    if not isinstance(content, dict) or "schema" not in content:
        raise InputError(f"{folder / 'study.json'}: is not what a run writes")
    if content["schema"] != SCHEMA:
        raise InputError(f"{folder / 'study.json'}: version {SCHEMA} of a run is needed, got {content['schema']!r}")
    about = content.get("study")
    if not isinstance(about, dict) or not isinstance(content.get("metrics"), list) or "name" not in about:
        raise InputError(f"{folder / 'study.json'}: does not say which study was run; run it again (finished trials are kept)")
    return content


def _trial_columns(swept: Mapping[str, str]) -> dict[str, str]:
    """The contract's order: the swept parameters stand after `dirty`."""
    names = list(TRIAL_COLUMNS)
    at = names.index("dirty") + 1
    return {name: swept.get(name) or TRIAL_COLUMNS[name] for name in (*names[:at], *swept, *names[at:])}


def _json(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content, indent=1, sort_keys=True).encode() + b"\n"
