"""Pictures of a run's trials: their estimates, and the recordings they were made on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sonobench.errors import InputError
from sonobench.report.choice import choose
from sonobench.report.figures import pictures
from sonobench.report.recordings import Recordings, stored_estimates
from sonobench.report.style import shown

if TYPE_CHECKING:
    from sonobench.harness.run import Run


def write_report(run: Run, trials: Sequence[str] = (), metric: str | None = None, out: str | Path | None = None) -> list[Path]:
    """Write pictures of trials.

    Args:
        run: finished, or as far as it came.
        trials: heads of trial keys; by default each pipeline's best, median and worst trial.
        metric: what best and worst refer to; by default the run's first.
        out: folder of the pictures; by default `report` in the run's folder.

    Returns:
        The pictures' paths.

    Raises:
        InputError: no such trial, it has no estimates, or its recording cannot be had any more.
    """
    folder = run.path / "report" if out is None else Path(out)
    rows = run.trials.set_index("trial_key", drop=False)
    names = asked(run, trials) if trials else _chosen(run, metric or run.metrics[0])
    if not names:
        raise InputError(f"{run.path}: no trial has estimates to draw; the causes stand in `sonobench run` and in {run.path / 'logs'}")
    made(folder)
    written: list[Path] = []
    recordings = Recordings(run)
    for key, why in names.items():
        row = {str(k): v for k, v in rows.loc[key].items()}
        name = " ".join([str(row["pipeline"]), *([why] if why else []), *place_words(row), f"rep {row['repetition']}", key[:8]])
        written += _drawn(run, row, name, folder, recordings)
    return written


def made(folder: Path) -> Path:
    """The folder, made where it is missing.

    Raises:
        InputError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}") from None
    return folder


def place_words(row: Mapping[str, Any]) -> list[str]:
    """A trial's scene and what is swept in it: ["chen2012", "p_d=0.98"]."""
    import pandas as pd

    swept = {c: v for c, v in row.items() if c.startswith("p_") and not c.startswith("p_pipelines.")}
    return [str(row["scene"]), *(f"{c.rpartition('.')[2]}={shown(v)}" for c, v in swept.items() if not pd.isna(v))]


def _chosen(run: Run, metric: str) -> dict[str, str]:
    """{trial key: "best", …}; one that is several things has all its names."""
    names: dict[str, list[str]] = {}
    tracked = run.trials[run.trials["estimates_path"].astype(str).str.endswith(".mcap")]  # the others end at their scans
    for found in choose(tracked, run.scores, metric).values():
        for why, key in found.items():
            names.setdefault(key, []).append(why)
    return {key: "+".join(whys) for key, whys in names.items()}


def asked(run: Run, heads: Sequence[str]) -> dict[str, str]:
    """{trial key: ""} of the heads of keys.

    Raises:
        InputError: a head that no trial, or more than one, has.
    """
    keys = [str(k) for k in run.trials["trial_key"]]
    found: dict[str, str] = {}
    for head in heads:
        matching = [k for k in keys if k.startswith(head)]
        if len(matching) != 1:
            raise InputError(f"--trial {head}: {len(matching)} trials of {run.path} have keys that begin so; name one of {len(keys)}")
        found[matching[0]] = ""
    return found


def _drawn(run: Run, row: Mapping[str, Any], name: str, folder: Path, recordings: Recordings) -> list[Path]:
    estimates, space = stored_estimates(run.paths, row)
    recording = recordings.of(row)
    return pictures(folder, name, recording.header, recording.truth, estimates, space)
