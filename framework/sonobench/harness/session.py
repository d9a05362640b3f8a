"""What is to be done next in a run, and what its outcome means.

Recordings are rendered once, shared front ends run once, then trackers, then metrics; a step that fails becomes the row of
every trial that needed it. The session decides and writes the journal; an engine carries its jobs out in any order.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any
from uuid import uuid4

from sonobench.harness.cache import SCANS_BUDGET, Cache
from sonobench.harness.cell import Limits, Outcome
from sonobench.harness.journal import Journal
from sonobench.harness.parts import Codes, covered, keep_parts
from sonobench.harness.plan import Plan, PlannedTrial, Source
from sonobench.harness.reuse import Reuse, output_path
from sonobench.harness.rows import Row, failed_row, planned_row

_TOGETHER = 512  # trials whose lines of the journal are read at once


@dataclass(frozen=True, slots=True)
class Take:
    """One recording of the plan and the trials on it."""

    source: Source
    seed: int | None
    key: str
    path: Path
    trials: tuple[PlannedTrial, ...]


@dataclass(frozen=True, slots=True)
class Job:
    """One step for an engine: what the worker gets, whom it serves, where its output is logged."""

    task: Mapping[str, Any]
    take: Take
    trials: tuple[PlannedTrial, ...]
    log: Path | None = None


@dataclass(slots=True)
class Session:
    """A run in progress.

    Attributes:
        plan, plugins: what is run; version by path of each plugin file.
        folder, cache, journal: where things are kept.
        env_id: the environment's.
        observe: called with the row of each trial that ended in this run.
        limits: what each step may take.
        retry_failed: run failed trials and metrics again, though their code is unchanged.
        ready: jobs that may start now.
        finished: keys of the trials that have ended, whatever became of them; their rows stand in the journal.
        failed: how many of these are not ok.
    """

    plan: Plan
    plugins: Mapping[str, str]
    folder: Path
    cache: Cache
    journal: Journal
    env_id: str
    observe: Callable[[Row], None]
    limits: Limits = field(default_factory=Limits)
    retry_failed: bool = False
    ready: deque[Job] = field(default_factory=deque)
    finished: set[str] = field(default_factory=set)
    failed: int = 0
    metric_faults: Counter[str] = field(default_factory=Counter)  # how many trials each fault of a metric cost
    _codes: Codes = field(init=False)
    _reuse: Reuse = field(init=False)
    _id: str = field(default_factory=lambda: uuid4().hex)  # what an open step made may serve this session alone
    _beyond: dict[str, Sequence[str]] = field(default_factory=dict)  # of scenes, by recording key
    _waiting: dict[str, list[PlannedTrial]] = field(default_factory=dict)
    _rows: dict[str, Row] = field(default_factory=dict)  # ended trials whose scores are not there yet
    _ran: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self._codes = Codes.of(self.plan)
        self._reuse = Reuse(self.plan, self._codes, self.journal.recorded, self.folder, self.env_id, self.limits, self.retry_failed)

    def keep_parts(self) -> None:
        """Write what the plan is made of beside the journal, for `why`."""
        keep_parts(self.folder / "parts.jsonl", self.plan, self._codes)

    @property
    def modules(self) -> tuple[str, ...]:
        """All modules whose code the run's keys are made of; a plugin file is "file:" and its name."""
        groups = (self._codes.front_ends, self._codes.trackers, self._codes.scenes, self._codes.metrics)
        return tuple(sorted({m for group in groups for found in group.values() for m in found.modules}))

    def begin(self, reverse: bool = False) -> None:
        """Queue the first jobs; what is already known needs none."""
        takes = self._takes()
        for take in reversed(takes) if reverse else takes:
            known = self.journal.recorded.recordings.get(take.key)
            if take.source.scene is None:
                known = take.source.sha, take.source.truth_sha
            if known and (rows := self._reuse.complete(take, known)) is not None:
                for trial, row in zip(take.trials, rows, strict=True):
                    self._reused(trial, row)
            elif known and take.source.scene is None:  # a file is its own recording
                self._expand(take, *known)
            elif failures := self._reuse.unrenderable(take):
                self._rows |= failures
                for trial in take.trials:
                    self._finish(trial)
            else:
                about: dict[str, Any] = {"home": take.source.home, "overrides": dict(take.source.overrides), "sha": take.source.sha}
                task = self._task("render", take, None, **about, known=covered(self._codes.scenes[id(take.source)]))
                self.ready.append(Job({**task, "seed": take.seed}, take, take.trials, self._log(f"render-{take.key}")))
        if reverse:
            self.ready.reverse()

    def done(self, job: Job, outcome: Outcome) -> None:
        """Take a job's outcome; further jobs may become ready."""
        {"render": self._rendered, "scans": self._scanned, "track": self._tracked, "score": self._score_done}[job.task["step"]](
            job, outcome
        )

    def rows(self) -> Iterator[tuple[Row, list[Row]]]:
        """The row of every planned trial and its score rows, in the plan's order; what metrics failed on is counted meanwhile."""
        self.metric_faults.clear()
        shas = {m.label: m.sha for m in self.plan.metrics}
        for at in range(0, len(self.plan.trials), _TOGETHER):
            yield from self._rows_of(self.plan.trials[at : at + _TOGETHER], shas)

    def _rows_of(self, trials: Sequence[PlannedTrial], shas: Mapping[str, str]) -> Iterator[tuple[Row, list[Row]]]:
        recorded = self.journal.recorded
        rows = recorded.trials.several(t.trial_key for t in trials if t.trial_key in self.finished or t.trial_key in self._ran)
        keys = {t.trial_key: self._reuse.score_keys(t, rows[t.trial_key]) for t in trials if t.trial_key in rows}
        stored = recorded.scores.several(key for pairs in keys.values() for _, key in pairs)
        for trial in trials:
            if (row := rows.get(trial.trial_key)) is None:
                yield planned_row(trial, self.plan.columns) | {"exc_message": "the run ended before this trial"}, []
                continue
            scores = []
            for label, key in keys[trial.trial_key]:
                found = stored.get(key, {})
                scores += [{"trial_key": trial.trial_key, "metric_sha": shas[label], **score} for score in found.get("rows", ())]
                if "error" in found:
                    self.metric_faults[f"metric {label}: {found['error']}"] += 1
            yield row, scores

    def _takes(self) -> list[Take]:
        groups: dict[tuple[int, int | None], list[PlannedTrial]] = {}
        for trial in self.plan.trials:
            groups.setdefault((id(trial.source), trial.seed), []).append(trial)
        takes = []
        for (_, seed), trials in groups.items():
            source = trials[0].source
            if source.scene is None or seed is None:
                takes.append(Take(source, None, source.sha, Path(source.home), tuple(trials)))
            else:
                key = self._codes.recording_key(source, seed)
                takes.append(Take(source, seed, key, self.cache.recording(key), tuple(trials)))
        return takes

    def _rendered(self, job: Job, outcome: Outcome) -> None:
        if outcome.status == "ok":
            hashes = outcome.value["input_sha"], outcome.value["truth_sha"]
            if outcome.beyond:
                self._beyond[job.take.key] = outcome.beyond  # rendered again by the next run
            elif self.journal.recorded.recordings.get(job.take.key) != hashes:
                self.journal.add(recording={job.take.key: hashes})
            self._expand(job.take, *hashes)
            return
        for trial in job.trials:
            self._end(failed_row(self._reuse.planned(trial, job.take), outcome, "the scene could not be rendered: ", self._log_of(job)))
            self._finish(trial)  # nothing to score against

    def _expand(self, take: Take, input_sha: str, truth_sha: str) -> None:
        """Queue what a recording's trials still need, depth first."""
        jobs: list[Job] = []
        for trial in take.trials:
            row = self._reuse.planned(trial, take) | {"input_sha": input_sha, "truth_sha": truth_sha}
            if trial.entry.pipeline is None:
                self._unavailable(row, trial.entry.reason)
                jobs += self._score_jobs(take, trial)
                continue
            key = self._codes.scans_key(trial.entry, input_sha)
            row["estimate_key"] = self._codes.estimate_key(trial.entry, input_sha, trial.run)
            if (reused := self._reuse.kept(row)) is not None:
                self._rows[trial.trial_key] = reused
                jobs += self._score_jobs(take, trial)
                continue
            self._rows[trial.trial_key] = row
            if key in self._waiting:
                self._waiting[key].append(trial)
            elif self.cache.has_scans(key, self._id):
                jobs.append(self._track_job(take, trial))
            else:
                self._waiting[key] = [trial]
                task = self._task("scans", take, trial, scans_key=key, known=covered(self._codes.front_ends[trial.entry.name]))
                jobs.append(Job(task, take, (trial,), self._log(f"scans-{key}")))
        self.ready.extendleft(reversed(jobs))

    def _reused(self, trial: PlannedTrial, row: Row | None) -> None:
        """A finished trial under its stored row; without one it is ok and the journal says all."""
        if row is None:
            self.finished.add(trial.trial_key)
            return
        if trial.entry.pipeline is None:
            self._unavailable(row, trial.entry.reason)
        else:
            self._rows[trial.trial_key] = row
        self._finish(trial)

    def _unavailable(self, row: Row, reason: str) -> None:
        """A trial whose pipeline cannot be built here; the journal says so once."""
        found = failed_row(row, Outcome("unavailable", exc_type="UnavailableError", exc_message=reason))
        stored = self.journal.recorded.trials.get(row["trial_key"], {})
        if any(stored.get(k) != found[k] for k in ("status", "exc_message", "input_sha", "truth_sha")):
            self._end(found)
        else:
            self._rows[row["trial_key"]] = self._reuse.under_this_name(stored, row)

    def _scanned(self, job: Job, outcome: Outcome) -> None:
        waiting = self._waiting.pop(job.task["scans_key"])
        jobs: list[Job] = []
        for trial in waiting:
            if outcome.status == "ok":
                jobs.append(self._track_job(job.take, trial))
            else:
                row = self._opened(self._rows[trial.trial_key], job.take, outcome.beyond)
                self._end(failed_row(row, outcome, "front end: ", self._log_of(job)))
                jobs += self._score_jobs(job.take, trial)
        self.ready.extendleft(reversed(jobs))

    def _tracked(self, job: Job, outcome: Outcome) -> None:
        (trial,) = job.trials
        value = dict(outcome.value or {})
        row = self._opened(self._rows[trial.trial_key], job.take, [*outcome.beyond, *value.pop("beyond", ())])
        log = self._log_of(job)
        if outcome.status == "ok":
            times = {"wall_s": outcome.wall_s, "peak_mb": outcome.peak_mb, **value}
            row = row | times | {"status": "ok", "log_path": log, "estimates_path": f"estimates/{Path(job.task['output']).name}"}
            self._end(row)
        else:
            self._end(failed_row(row, outcome, log_path=log))
        self.ready.extendleft(reversed(self._score_jobs(job.take, trial)))

    def _opened(self, row: Row, take: Take, beyond: Sequence[str]) -> Row:
        """A row that says what its trial used beyond its keys; it is never reused."""
        found = sorted({*beyond, *self._beyond.get(take.key, ())})
        return row | {"open": bool(found), "open_because": "; ".join(found)}

    def _score_done(self, job: Job, outcome: Outcome) -> None:
        (trial,) = job.trials
        if outcome.status == "ok":
            scores = outcome.value
        else:
            about = {"status": outcome.status, "exc_type": outcome.exc_type, **asdict(self.limits)}
            fault = {"error": f"{outcome.status}: {outcome.exc_message}", **about}
            scores = {item["key"]: fault for item in job.task["metrics"]}
        self._reuse.scored_now.update(scores)
        self.journal.add(trial_key=trial.trial_key, scores=scores)
        self._finish(trial)

    def _score_jobs(self, take: Take, trial: PlannedTrial) -> list[Job]:
        """The scoring that a trial still needs; with none it is finished."""
        row = self._rows[trial.trial_key]
        missing = [(label, key) for label, key in self._reuse.score_keys(trial, row) if not self._reuse.is_scored(key)]
        if not missing:
            self._finish(trial)
            return []
        tables = {m.label: m.table for m in self.plan.metrics}
        task = self._task(
            "score",
            take,
            trial,
            available=trial.entry.pipeline is not None,
            output=str(self.folder / row["estimates_path"]) if row["status"] == "ok" else None,
            metrics=[self._to_score(label, key, tables[label]) for label, key in missing],
            scans_key=self._codes.scans_key(trial.entry, row["input_sha"]),
        )
        return [Job(task, take, (trial,), self._log(f"score-{trial.trial_key}"))]

    def _to_score(self, label: str, key: str, table: Mapping[str, Any]) -> dict[str, Any]:
        return {"label": label, "key": key, "table": dict(table), "known": covered(self._codes.metrics[label])}

    def _track_job(self, take: Take, trial: PlannedTrial) -> Job:
        row = self._rows[trial.trial_key]
        task = self._task(
            "track",
            take,
            trial,
            run=trial.run,
            input_sha=row["input_sha"],
            estimate_key=row["estimate_key"],
            scans_key=self._codes.scans_key(trial.entry, row["input_sha"]),
            known=covered(self._codes.trackers[trial.entry.name]),
            output=str(self.folder / output_path(trial.entry, row["estimate_key"])),
        )
        return Job(task, take, (trial,), self._log(trial.trial_key))

    def _task(self, step: str, take: Take, trial: PlannedTrial | None = None, **more: Any) -> dict[str, Any]:
        common: dict[str, Any] = {
            "step": step,
            "plugins": dict(self.plugins),
            "recording": str(take.path),
            "cache": str(self.cache.root),
            "scans_budget": SCANS_BUDGET,
            "session": self._id,
            "folder": str(self.folder),
        }
        if trial is not None:
            common["pipeline"] = trial.entry.table
            if trial.entry.pipeline is not None:
                common["known_front_end"] = covered(self._codes.front_ends[trial.entry.name])
        return common | more

    def _end(self, row: Row) -> None:
        """A trial has its row; it is safe before anything is scored."""
        self._rows[row["trial_key"]] = row
        self._ran.add(row["trial_key"])
        self.journal.add(trial=row)

    def _finish(self, trial: PlannedTrial) -> None:
        row = self._rows.pop(trial.trial_key)
        self.finished.add(trial.trial_key)
        if trial.trial_key not in self._ran and not self._reuse.is_told(row):
            self.journal.add(trial=row)
        self.failed += row["status"] != "ok"
        if trial.trial_key in self._ran:
            self.observe(row)

    def _log(self, name: str) -> Path:
        return self.folder / "logs" / f"{name}.log"

    def _log_of(self, job: Job) -> str:
        return f"logs/{job.log.name}" if job.log is not None and job.log.exists() else ""
