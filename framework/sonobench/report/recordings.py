"""The recordings and stored outputs that a run's trials were made on and of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sonobench.errors import InputError

if TYPE_CHECKING:
    from sonobench.harness.plan import PlannedTrial
    from sonobench.harness.run import Run
    from sonobench.log import Recording
    from sonobench.pipeline import Pipeline
    from sonobench.types import Estimate, Space


class Recordings:
    """Opens the recordings of a run's trials: from the cache, else their file, else rendered again.

    The last one stays open, so ask for the trials of one recording one after the other.
    """

    def __init__(self, run: Run) -> None:
        self._paths = run.paths
        self._planned: dict[str, Any] | None = None
        self._last: tuple[str, Recording] | None = None

    def of(self, row: Mapping[str, Any]) -> Recording:
        """The recording of a trial (a row of trials.parquet).

        Raises:
            InputError: it cannot be had any more.
        """
        if self._last is None or self._last[0] != row["recording_key"]:
            self._last = str(row["recording_key"]), self._found(row)
        return self._last[1]

    def pipeline(self, row: Mapping[str, Any]) -> Pipeline:
        """The pipeline of a trial, built anew.

        Raises:
            InputError: the study no longer has it, or it is unavailable here.
        """
        entry = self._plan_of(row).entry
        if entry.pipeline is None:
            raise InputError(f"pipeline {entry.name} is unavailable here: {entry.reason}")
        return entry.pipeline

    def _plan_of(self, row: Mapping[str, Any]) -> PlannedTrial:
        if self._planned is None:
            self._planned = _planned(self._paths)
        planned: PlannedTrial | None = self._planned.get(row["trial_key"])
        if planned is None:
            raise InputError(
                f"{self._paths[0]}: the study's scenes or pipelines are no longer those of trial {row['trial_key']}; run it again"
            )
        return planned

    def _found(self, row: Mapping[str, Any]) -> Recording:
        from sonobench.harness.cache import Cache
        from sonobench.log import Recording, open_recording

        cached = Cache.default().recording(row["recording_key"])
        if cached.exists():
            return open_recording(cached)
        planned, where = self._plan_of(row), self._paths[0]
        scene = planned.source.scene
        recording = open_recording(planned.source.home) if scene is None else Recording.of(scene.simulate(planned.seed))
        if row["truth_sha"] not in ("", recording.truth_sha):
            raise InputError(f"{where}: the truth of {row['scene']} is no longer that of trial {row['trial_key']}; run it again")
        return recording


def stored_estimates(paths: Sequence[Path], row: Mapping[str, Any]) -> tuple[list[Estimate], Space]:
    """The estimates of a trial that has some, and their space.

    Raises:
        InputError: it has none: it failed, it ends at its scans, or the file is gone.
    """
    from sonobench.log import read_estimates

    who = f"trial {row['trial_key']} ({row['pipeline']} on {row['scene']})"
    homes = [p for p in paths if row["estimates_path"] and (p / row["estimates_path"]).is_file()]
    if not homes:
        raise InputError(f"{who} has no estimates: {row['status']} {row['exc_message']}")
    if not row["estimates_path"].endswith(".mcap"):
        raise InputError(f"{who} ends at its scans; there are no estimates to draw")
    estimates, space, _ = read_estimates(homes[0] / row["estimates_path"])
    return estimates, space


def _planned(folders: Sequence[Path]) -> dict[str, Any]:
    """Planned trials by key; what no study plans any more is missing."""
    from sonobench.harness.why import study_of

    return {t.trial_key: t for folder in folders for t in study_of(folder).plan()}
