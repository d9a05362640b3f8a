"""What a run would do: counts, what is there already, and a guess of how long the rest takes."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

from sonobench.harness.cache import Cache
from sonobench.harness.cell import Limits, Outcome
from sonobench.harness.environment import environment_id
from sonobench.harness.journal import Journal, Recorded, read
from sonobench.harness.plan import Plan, PlannedTrial
from sonobench.harness.session import Job, Session

_COSTS = ("front_end_s", "wall_s")  # of a trial: its share of the front end, and all of its own step


@dataclass(frozen=True, slots=True)
class Forecast:
    """What is planned and what of it is there.

    Attributes:
        trials: planned.
        finished: of these, the ones whose row and scores would be kept.
        to_run, to_score: the ones to be run, and the ones that only lack scores.
        recordings: planned; `to_render` of them are not in the cache.
        front_ends: runs of front ends that are needed; None where that cannot be told before rendering.
        seconds: of all steps but rendering, one after the other, from what earlier trials of the same pipelines took; None where none has run.
        unknown: pipelines that no earlier trial tells of.
        jobs: workers that share the seconds.
    """

    trials: int
    finished: int
    to_run: int
    to_score: int
    recordings: int
    to_render: int
    front_ends: int | None
    seconds: float | None
    unknown: tuple[str, ...]
    jobs: int

    def __str__(self) -> str:
        known = "front ends: known after rendering" if self.front_ends is None else f"front ends to run: {self.front_ends}"
        lines = [
            f"{self.trials} trials: {self.finished} finished, {self.to_run} to run, {self.to_score} to score",
            f"{self.recordings} recordings: {self.recordings - self.to_render} in the cache or files, {self.to_render} to render; {known}",
            f"time: {self._time()}",
        ]
        return "\n".join(lines)

    def _time(self) -> str:
        if not self.to_run:
            return "seconds"
        if self.seconds is None:
            return "unknown, no trial of these pipelines has run yet"
        shared = self.seconds / self.jobs
        amount = f"{shared:.0f} s" if shared < 120 else f"{shared / 60:.0f} min" if shared < 7200 else f"{shared / 3600:.1f} h"
        rendering = ", without rendering" if self.to_render else ""
        missing = f", and what {', '.join(self.unknown)} take (none has run yet)" if self.unknown else ""
        return f"about {amount} with {self.jobs} jobs{rendering}, from what earlier trials took{missing}"


class Glance:
    """A journal that is looked at and not written; a run may hold it meanwhile."""

    def __init__(self, recorded: Recorded) -> None:
        self.recorded = recorded

    def add(self, **line: Any) -> None:
        """Nothing is kept."""


def forecast(plan: Plan, folder: Path, jobs: int, limits: Limits, retry_failed: bool = False, fresh: bool = False) -> Forecast:
    """Look at a run's folder (there may be none yet) and at the cache; nothing is written.

    With `fresh`, what is in the folder only tells what trials take.
    """
    earlier = read(folder / "journal.jsonl") if (folder / "journal.jsonl").exists() else Recorded(Path(os.devnull))
    recorded = Recorded(Path(os.devnull)) if fresh else earlier
    journal: Journal = Glance(recorded)  # type: ignore[assignment]  # a session only asks it and adds to it
    session = Session(plan, {}, folder, Cache.default(), journal, environment_id(), lambda row: None, limits, retry_failed)
    session.begin()
    tally = _tally(session)
    alone, shared = _costs(earlier)
    own = {t.pipeline for t in tally.trials}
    unknown = tuple(sorted(p for p in own if not _known(alone, p)))
    seconds = sum(_cost(alone, t) for t in tally.trials) + sum(_cost(shared, t) for t in tally.front_ends)
    return Forecast(
        trials=len(plan),
        finished=len(plan) - len(tally.trials) - tally.to_score,
        to_run=len(tally.trials),
        to_score=tally.to_score,
        recordings=len({(id(t.source), t.seed) for t in plan}),
        to_render=tally.to_render,
        front_ends=None if tally.hidden else len(tally.front_ends),
        seconds=seconds if tally.trials and len(unknown) < len(own) else None if tally.trials else 0.0,
        unknown=unknown,
        jobs=jobs,
    )


@dataclass(slots=True)
class _Tally:
    """What is to be done: trials; those whose front end must run; recordings; whether some of it cannot be told yet."""

    trials: list[PlannedTrial]
    front_ends: list[PlannedTrial]
    to_score: int = 0
    to_render: int = 0
    hidden: bool = False


def _tally(session: Session) -> _Tally:
    """Play the session's jobs through as far as outcomes can be foretold."""
    tally = _Tally([], [])
    while session.ready:
        job = session.ready.popleft()
        step = job.task["step"]
        if step == "render":
            tally.to_render += not job.take.path.exists()
            hashes = session.journal.recorded.recordings.get(job.take.key)
            if hashes is None:
                tally.hidden = True
                _unrendered(job, tally)
            else:
                session.done(job, Outcome("ok", {"input_sha": hashes[0], "truth_sha": hashes[1]}))
        elif step == "scans":
            tally.front_ends += job.trials
            session.done(job, Outcome("ok"))
        elif step == "track":
            tally.trials += job.trials
        else:
            tally.to_score += 1
    return tally


def _unrendered(job: Job, tally: _Tally) -> None:
    """All trials of a recording that nothing is known of: they share what front ends they share."""
    from sonobench.components import canonical_json

    front_ends: dict[str, PlannedTrial] = {}
    for trial in job.trials:
        if trial.entry.pipeline is not None:
            tally.trials.append(trial)
            front_ends.setdefault(canonical_json([trial.entry.table["front_end"], trial.entry.pipeline.given]), trial)
    tally.front_ends += front_ends.values()


_Costs = Mapping[tuple[str, str], float]  # mean seconds by pipeline and scene, and by pipeline and ""


def _costs(recorded: Recorded) -> tuple[_Costs, _Costs]:
    """What a trial's own step and its front end took, of all trials that ended well."""
    found: tuple[dict[Any, list[float]], ...] = (defaultdict(list), defaultdict(list))
    for row in recorded.trials.values():
        if row["status"] == "ok":
            front_end_s, wall_s = (row.get(name) or 0.0 for name in _COSTS)
            for scene in (row["scene"], ""):
                found[0][row["pipeline"], scene].append(wall_s)
                found[1][row["pipeline"], scene].append(front_end_s)
    alone, shared = ({key: fmean(values) for key, values in group.items()} for group in found)
    return alone, shared


def _known(costs: _Costs, pipeline: str) -> bool:
    return (pipeline, "") in costs


def _cost(costs: _Costs, trial: PlannedTrial) -> float:
    return costs.get((trial.pipeline, trial.scene), costs.get((trial.pipeline, ""), 0.0))
