"""What an earlier run left of a plan's trials, and whether it still holds.

A stored output holds while its key is the same, its file is there and nothing beyond the key was used; a stored failure
while its key is the same and no limit that it met is higher now (`rows.stands`).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from sonobench.harness.cell import Limits
from sonobench.harness.parts import Codes, pipeline_part, scene_part, sha_of
from sonobench.harness.plan import PipelineEntry, Plan, PlannedTrial
from sonobench.harness.rows import OWN_NAMES, SHARED_NAMES, Row, planned_row, shared_name, stands, whole_name

if TYPE_CHECKING:
    from sonobench.harness.journal import Recorded
    from sonobench.harness.session import Take

_OWN_FAILURES = ("error", "invalid", "crash", "timeout", "oom")  # of a trial that ran


@dataclass(slots=True)
class Reuse:
    """Decides for one run.

    Attributes:
        plan, codes: what is run, and the code behind it.
        recorded: what the journal says.
        folder: the run's.
        env_id: the environment's.
        limits: what each step may take now.
        retry_failed: run failed trials and metrics again, though their code is unchanged.
        scored_now: keys of the scores that this run computed.
    """

    plan: Plan
    codes: Codes
    recorded: Recorded
    folder: Path
    env_id: str
    limits: Limits
    retry_failed: bool
    scored_now: set[str] = field(default_factory=set)
    _parts: dict[int, str] = field(default_factory=dict)  # names in parts.jsonl by `id` of entries and sources
    _templates: dict[tuple[int, int], tuple[Row, str]] = field(
        default_factory=dict
    )  # what rows of a source and an entry share, and its name

    def __post_init__(self) -> None:
        self._parts = {id(s): sha_of(scene_part(s, self.codes)) for s in self.plan.sources}
        self._parts |= {id(e): sha_of(pipeline_part(e, self.codes)) for e in self.plan.entries}

    def planned(self, trial: PlannedTrial, take: Take) -> Row:
        """A trial's row before it ran."""
        attempts = self.recorded.trials.get(trial.trial_key, {}).get("attempts", 0)
        own = {"trial_key": trial.trial_key, "repetition": trial.repetition, "run": trial.run, "attempts": attempts + 1}
        return self._template(trial)[0] | own | {"recording_key": take.key}

    def kept(self, row: Row) -> Row | None:
        """The stored row of a trial that need not run again: its output is there, or the same code failed and may take no more than before."""
        stored = self._output(row)
        return self._failure(row, "estimate_key") if stored is None else stored

    def unrenderable(self, take: Take) -> dict[str, Row] | None:
        """The stored rows of a recording's trials, where rendering it failed for all of them and would again."""
        rows = {}
        for trial in take.trials:
            stored = self._failure(self.planned(trial, take) | {"truth_sha": ""}, "recording_key")
            if stored is None or stored["input_sha"]:
                return None
            rows[trial.trial_key] = stored
        return rows

    def complete(self, take: Take, hashes: tuple[str, str]) -> list[Row | None] | None:
        """The rows of a recording's trials, where all are there, scores too, so that it need not be rendered.

        None stands for a row that the journal has exactly so, of a trial that is ok: most rows of most runs, and not read.
        """
        rows: list[Row | None] = []
        for trial in take.trials:
            if self._is_unchanged(trial, take, hashes):
                rows.append(None)
                continue
            row = self.planned(trial, take) | {"input_sha": hashes[0], "truth_sha": hashes[1], "status": "unavailable"}
            if trial.entry.pipeline is not None:
                reused = self.kept(row | {"estimate_key": self.codes.estimate_key(trial.entry, hashes[0], trial.run)})
                if reused is None:
                    return None
                row = reused
            if not all(self.is_scored(key) for _, key in self.score_keys(trial, row)):
                return None
            rows.append(row)
        return rows

    def score_keys(self, trial: PlannedTrial, row: Mapping[str, object]) -> list[tuple[str, str]]:
        """Label and score key of each metric on a trial's row."""
        return [(m.label, self.codes.score_key(m, trial.entry, row)) for m in self.plan.metrics]

    def is_scored(self, key: str) -> bool:
        """Whether a score is there, or the same code of the metric failed on the same output and trying again would tell nothing new."""
        if self.recorded.scores.is_plain(key):
            return True
        stored = self.recorded.scores.get(key, {})
        if stored.get("beyond") and key not in self.scored_now:  # the metric used more than its key covers
            return False
        if "rows" in stored:
            return True
        own = "error" in stored and stored.get("status") != "error"  # a step that raised met a damaged file, not a metric's fault
        return own and not self.retry_failed and stands(stored, self.limits)

    def under_this_name(self, stored: Row, row: Row) -> Row:
        """A stored row as that of the trial that `row` was planned for."""
        return stored | {k: row[k] for k in self._names}

    def is_told(self, row: Row) -> bool:
        """Whether the journal says of a trial what its row says: a kept row may come from another trial, or from before a renaming."""
        stored = self.recorded.trials.get(row["trial_key"])
        return stored is not None and all(stored.get(k) == row.get(k) for k in (*self._names, "status", "estimate_key"))

    @property
    def _names(self) -> Sequence[str]:
        return (*SHARED_NAMES, *OWN_NAMES, *self.plan.columns)

    def _is_unchanged(self, trial: PlannedTrial, take: Take, hashes: tuple[str, str]) -> bool:
        """Whether a trial is ok and scored, and the journal's last line about it says just what would be written now; of most without reading it."""
        if trial.entry.pipeline is None:
            return False
        name = whole_name(self._template(trial)[1], trial.trial_key, trial.repetition, trial.run, take.key, hashes[1])
        key = self.codes.estimate_key(trial.entry, hashes[0], trial.run)
        if not self.recorded.is_named(trial.trial_key, key, name) or not os.path.exists(f"{self.folder}/{output_path(trial.entry, key)}"):
            return False
        return all(self.recorded.scores.is_plain(self.codes.score_keys(m)(key, hashes[1])) for m in self.plan.metrics)

    def _template(self, trial: PlannedTrial) -> tuple[Row, str]:
        pair = id(trial.source), id(trial.entry)
        if pair not in self._templates:
            given = () if trial.entry.pipeline is None else trial.entry.pipeline.given
            code = self.codes.trackers.get(trial.entry.name)
            about = {
                "scene_sha": self._parts[id(trial.source)],
                "pipeline_sha": self._parts[id(trial.entry)],
                "code_sha": code.digest if code else "",
                "given": ",".join(given),
                "env_id": self.env_id,
            }
            row = planned_row(trial, self.plan.columns) | about | asdict(self.limits)
            self._templates[pair] = row, shared_name(row)
        return self._templates[pair]

    def _output(self, row: Row) -> Row | None:
        """The stored row of the same output, under this trial's name."""
        stored = self.recorded.outputs.get(row["estimate_key"])
        if stored is None or stored["open"] or not os.path.exists(f"{self.folder}/{stored['estimates_path']}"):
            return None
        return self.under_this_name(stored, row)

    def _failure(self, row: Row, same: str) -> Row | None:
        """The stored failure of a trial whose key `same` has not changed, where trying again would tell nothing new."""
        stored = self.recorded.trials.get(row["trial_key"])
        if self.retry_failed or stored is None or stored["status"] not in _OWN_FAILURES:
            return None
        if stored[same] != row[same] or stored["open"] or not stands(stored, self.limits):
            return None
        return self.under_this_name(stored, row)


def output_path(entry: PipelineEntry, estimate_key: str) -> str:
    """Where an output lies in the run's folder: estimates, or scans where there is no tracker."""
    return f"estimates/{estimate_key}.{'npz' if entry.pipeline is None or entry.pipeline.tracker is None else 'mcap'}"
