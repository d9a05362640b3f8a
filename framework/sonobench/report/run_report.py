"""Pictures of a run's trials: their estimates, and the recordings they were made on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sonobench.errors import InputError
from sonobench.report.choice import choose
from sonobench.report.figures import pictures

if TYPE_CHECKING:
    from sonobench.harness.run import Run
    from sonobench.log import Recording


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
    names = _asked(run, trials) if trials else _chosen(run, metric or run.metrics[0])
    if not names:
        raise InputError(f"{run.path}: no trial has estimates to draw; the causes stand in `sonobench run` and in {run.path / 'logs'}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}") from None
    written: list[Path] = []
    recordings: dict[str, Recording] = {}
    for key, why in names.items():
        row = {str(k): v for k, v in rows.loc[key].items()}
        name = " ".join([str(row["pipeline"]), *([why] if why else []), str(row["scene"]), f"rep {row['repetition']}", key[:8]])
        written += _drawn(run, row, name, folder, recordings)
    return written


def _chosen(run: Run, metric: str) -> dict[str, str]:
    """{trial key: "best", …}; one that is several things has all its names."""
    names: dict[str, list[str]] = {}
    tracked = run.trials[run.trials["estimates_path"].astype(str).str.endswith(".mcap")]  # the others end at their scans
    for found in choose(tracked, run.scores, metric).values():
        for why, key in found.items():
            names.setdefault(key, []).append(why)
    return {key: "+".join(whys) for key, whys in names.items()}


def _asked(run: Run, heads: Sequence[str]) -> dict[str, str]:
    keys = [str(k) for k in run.trials["trial_key"]]
    found: dict[str, str] = {}
    for head in heads:
        matching = [k for k in keys if k.startswith(head)]
        if len(matching) != 1:
            raise InputError(f"--trial {head}: {len(matching)} trials of {run.path} have keys that begin so; name one of {len(keys)}")
        found[matching[0]] = ""
    return found


def _drawn(run: Run, row: Mapping[str, Any], name: str, folder: Path, recordings: dict[str, Recording]) -> list[Path]:
    from sonobench.log import read_estimates

    homes = [p for p in run.paths if row["estimates_path"] and (p / row["estimates_path"]).is_file()]
    if not homes:
        raise InputError(
            f"trial {row['trial_key']} ({row['pipeline']} on {row['scene']}) has no estimates: {row['status']} {row['exc_message']}"
        )
    if not row["estimates_path"].endswith(".mcap"):
        raise InputError(
            f"trial {row['trial_key']} ({row['pipeline']} on {row['scene']}) ends at its scans; there are no estimates to draw"
        )
    estimates, space, _ = read_estimates(homes[0] / row["estimates_path"])
    if row["recording_key"] not in recordings:
        recordings[row["recording_key"]] = _recording(homes[0], row)
    recording = recordings[row["recording_key"]]
    return pictures(folder, name, recording.header, recording.truth, estimates, space)


def _recording(folder: Path, row: Mapping[str, Any]) -> Recording:
    """The recording of a trial: from the cache, else its file, else rendered again."""
    from sonobench.harness.cache import Cache
    from sonobench.log import Recording, open_recording

    cached = Cache.default().recording(row["recording_key"])
    if cached.exists():
        return open_recording(cached)
    planned = next((t for t in _study(folder).plan() if t.trial_key == row["trial_key"]), None)
    if planned is None:
        raise InputError(f"{folder}: the study's scenes or pipelines are no longer those of trial {row['trial_key']}; run it again")
    scene = planned.source.scene
    recording = open_recording(planned.source.home) if scene is None else Recording.of(scene.simulate(planned.seed))
    if row["truth_sha"] not in ("", recording.truth_sha):
        raise InputError(f"{folder}: the truth of {row['scene']} is no longer that of trial {row['trial_key']}; run it again")
    return recording


def _study(folder: Path) -> Any:
    """The study that study.json holds."""
    from sonobench.harness.run_folder import read_study
    from sonobench.scene import Study

    table = dict(read_study(folder)["study"])
    name, home = table.pop("name"), table.pop("folder")
    sweep: dict[str, Any] = {}
    for path, values in table.pop("sweep").items():
        *heads, last = path.split(".")
        leaf = sweep
        for head in heads:
            leaf = leaf.setdefault(head, {})
        leaf[last] = values
    return Study.from_table({**table, "sweep": sweep}, Path(home) / f"{name}.toml")
