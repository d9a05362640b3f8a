"""What a run would do: counts, what is there already, and a guess of how long the rest takes."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from statistics import fmean
from typing import Any

from sonobench.components import digest
from sonobench.harness import run_folder
from sonobench.harness.cache import Cache
from sonobench.harness.cell import Limits, Outcome
from sonobench.harness.environment import environment_id
from sonobench.harness.journal import Journal, Recorded, read
from sonobench.harness.plan import Plan, PlannedTrial
from sonobench.harness.session import Job, Session, Take

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
        render_seconds: of rendering, one after the other, from what renderings in this cache took; None where none tells.
        unrendered: scenes that no earlier rendering tells of.
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
    render_seconds: float | None
    unrendered: tuple[str, ...]
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
        if not self.to_run and not self.to_render:
            return "seconds"
        amounts = [(self.seconds, f"for {self.to_run} trials", self.to_run), (self.render_seconds, "to render", self.to_render)]
        known = [(amount, what) for amount, what, count in amounts if count and amount is not None]
        if not known:
            return "unknown, none of this has run yet"
        parts = " + ".join(f"{_amount(amount / self.jobs)} {what}" for amount, what in known)
        whole = f"about {_amount(sum(amount for amount, _ in known) / self.jobs)} with {self.jobs} jobs ({parts}), from what it took before"
        missing = []
        if self.unknown:
            missing.append(f"trials of {', '.join(self.unknown)}")
        if self.unrendered:
            missing.append(f"rendering {', '.join(self.unrendered)}")
        return whole + (f"; unknown, since none has run yet: {' and '.join(missing)}" if missing else "")


def _amount(seconds: float) -> str:
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


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
    run_folder.refuse_foreign(folder)
    earlier = read(folder / "journal.jsonl")
    recorded = Recorded(Path(os.devnull)) if fresh else earlier
    journal: Journal = Glance(recorded)  # type: ignore[assignment]  # a session only asks it and adds to it
    session = Session(plan, {}, folder, Cache.default(), journal, environment_id(), lambda row: None, limits, retry_failed)
    session.begin()
    tally = _tally(session)
    alone, shared = _costs(earlier)
    own = {t.pipeline for t in tally.trials}
    unknown = tuple(sorted(p for p in own if not _known(alone, p)))
    seconds = sum(_cost(alone, t) for t in tally.trials) + sum(_cost(shared, t) for t in tally.front_ends)
    costs = session.cache.costs()
    rendering = [(take.source.name, _rendering(take, *costs)) for take in tally.renders]
    unrendered = tuple(sorted({name for name, cost in rendering if cost is None}))
    found = [cost for _, cost in rendering if cost is not None]
    return Forecast(
        trials=len(plan),
        finished=len(plan) - len(tally.trials) - tally.to_score,
        to_run=len(tally.trials),
        to_score=tally.to_score,
        recordings=len({(id(t.source), t.seed) for t in plan}),
        to_render=len(tally.renders),
        front_ends=None if tally.hidden else len(tally.front_ends),
        seconds=seconds if tally.trials and len(unknown) < len(own) else None if tally.trials else 0.0,
        unknown=unknown,
        render_seconds=sum(found) if found or not rendering else None,
        unrendered=unrendered,
        jobs=jobs,
    )


@dataclass(slots=True)
class _Tally:
    """What is to be done: trials; those whose front end must run; recordings; whether some of it cannot be told yet."""

    trials: list[PlannedTrial] = field(default_factory=list)
    front_ends: list[PlannedTrial] = field(default_factory=list)
    renders: list[Take] = field(default_factory=list)
    to_score: int = 0
    hidden: bool = False


def _tally(session: Session) -> _Tally:
    """Play the session's jobs through as far as outcomes can be foretold."""
    tally = _Tally()
    while session.ready:
        job = session.ready.popleft()
        step = job.task["step"]
        if step == "render":
            tally.renders += [] if job.take.path.exists() else [job.take]
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


def _rendering(take: Take, scenes: Mapping[str, float], simulators: Mapping[str, float]) -> float | None:
    """What rendering a recording takes: as this scene did, else as scenes of the same simulator did."""
    scene = take.source.scene
    per_s = scenes.get(take.source.sha[:32], simulators.get(digest(scene.table["simulator"])))
    return None if per_s is None else per_s * float(scene.duration_s)


def _known(costs: _Costs, pipeline: str) -> bool:
    return (pipeline, "") in costs


def _cost(costs: _Costs, trial: PlannedTrial) -> float:
    return costs.get((trial.pipeline, trial.scene), costs.get((trial.pipeline, ""), 0.0))
