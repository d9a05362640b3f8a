"""Running a study, and what comes of it."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from sonobench.errors import InputError, SonobenchError, TableError
from sonobench.harness import run_folder
from sonobench.harness.cache import Cache
from sonobench.harness.cell import Limits

if TYPE_CHECKING:
    import pandas as pd

    from sonobench.harness.plan import Plan
    from sonobench.harness.progress import Display
    from sonobench.harness.session import Job, Session
    from sonobench.registry import Registry
    from sonobench.scene.reference import Reference
    from sonobench.scene.study import Study

RUNS = "runs"  # where runs lie unless --out says otherwise
_SOON = 10_000  # trials whose tables are written within a fraction of a second


@dataclass(frozen=True)
class Run:
    """The results of one or several runs.

    Attributes:
        paths: their folders.
        metrics: labels of the studies' metrics, the first study's first.
    """

    paths: tuple[Path, ...]
    metrics: tuple[str, ...]

    @property
    def path(self) -> Path:
        """The (first) run's folder."""
        return self.paths[0]

    @property
    def trials(self) -> pd.DataFrame:
        """trials.parquet: one row for every planned trial, whatever became of it; of several runs each trial once."""
        return self._tables[0]

    @property
    def scores(self) -> pd.DataFrame:
        """scores.parquet: one row for every trial, metric column and slice."""
        return self._tables[1]

    @cached_property
    def studies(self) -> list[dict[str, Any]]:
        """study.json of every run."""
        return [run_folder.read_study(p) for p in self.paths]

    @cached_property
    def registry(self) -> Registry:
        """What is installed, and the studies' own plugin files as far as they are still there."""
        from sonobench.registry import Registry

        plugins = dict.fromkeys(p for study in self.studies for p in study["study"].get("plugins", ()) if Path(p).is_file())
        return Registry.load(plugins)

    @property
    def failed(self) -> int:
        """How many planned trials are not ok, or lack a metric's score because the metric failed on them."""
        bad = set(self.trials.loc[self.trials["status"] != "ok", "trial_key"])
        return len(bad.union(*self.unscored.values()))

    @cached_property
    def unscored(self) -> dict[str, set[str]]:
        """Keys of the trials that a metric says nothing of, by metric; only metrics with such trials."""
        planned = set(self.trials["trial_key"])
        heads = {m: self.scores["metric"].map(lambda name, m=m: name == m or name.startswith(f"{m}.")) for m in self.metrics}
        missing = {m: planned - set(self.scores.loc[head.astype(bool), "trial_key"]) for m, head in heads.items()}
        return {m: keys for m, keys in missing.items() if keys}

    def board(
        self,
        metric: str | None = None,
        by: str | None = None,
        vs: str | None = None,
        also: Sequence[str] = (),
        references: Sequence[str] = (),
    ) -> pd.DataFrame:
        """The leaderboard of a metric (by default the first); see `sonobench.board.leaderboard` and, for `references`, `beside`.

        References that the study names are always there; further ones are names, `dist:name` or paths of .toml files.
        """
        from sonobench.board import absent, beside, leaderboard, noted

        table = noted(leaderboard(self.trials, self.scores, self._metric(metric), by, vs, also), absent(self.studies))
        found, lost = self._references(references)
        metrics = {label: own for study in self.studies for label, own in study.get("metric_tables", {}).items()}
        return beside(table, found, metrics, lost) if found or lost else table

    def attribution(self, role: str, metric: str | None = None, by: str | None = None, vs: str | None = None) -> pd.DataFrame:
        """What swapping a component of a role is worth; see `sonobench.board.attribution`."""
        from sonobench.board import absent, attribution, noted, same_entries

        entries = same_entries([study.get("entries", {}) for study in self.studies], [str(p) for p in self.paths])
        return noted(attribution(self.trials, self.scores, self._metric(metric), role, entries, by, vs), absent(self.studies))

    def where(self, scenes: Sequence[str] = (), at: Mapping[str, Sequence[Any]] | None = None, pipelines: Sequence[str] = ()) -> Run:
        """The same run, of these scenes, swept values and pipelines alone; see `sonobench.report.chosen`."""
        from sonobench.report import chosen

        part = Run(self.paths, self.metrics)
        part.__dict__["_tables"] = chosen(self.trials, scenes, at, pipelines), self.scores  # where cached_property looks
        return part

    def curve(self, over: str, metrics: Sequence[str] = (), references: Sequence[str] = ()) -> pd.DataFrame:
        """Metrics against a swept value, or (over = "time") at every evaluation time; see `sonobench.report.curve` and `over_time`."""
        from sonobench.report import curve, over_time

        return over_time(self, metrics) if over == "time" else curve(self, over, metrics, references)

    def report(
        self,
        trials: Sequence[str] = (),
        metric: str | Sequence[str] | None = None,
        out: str | Path | None = None,
        over: str | None = None,
        references: Sequence[str] = (),
        frames_s: Sequence[float] = (),
    ) -> list[Path]:
        """Write pictures of trials, of single frames of them, or with `over` of metrics.

        See `sonobench.report.write_report`, `write_frames` and `write_curves`.
        """
        from sonobench.report import write_curves, write_frames, write_report

        metrics = (metric,) if isinstance(metric, str) else tuple(metric or ())
        if frames_s and (over is not None or metrics or references):
            raise InputError("--frame draws single frames of trials; leave --over, --metric and --reference out")
        if frames_s:
            return write_frames(self, frames_s, trials, out)
        if over is not None and trials:
            raise InputError("--over draws metrics over all trials; leave --trial out, or narrow down with --scene, --at, --pipeline")
        if over is not None:
            return write_curves(self, over, metrics, references, out)
        if references or len(metrics) > 1:
            raise InputError("pictures of trials have no references and one metric, which chooses them; with --over they have several")
        return write_report(self, trials=trials, metric=self._metric(*metrics or [None]), out=out)

    def _metric(self, metric: str | None) -> str:
        if metric is None and not self.metrics:
            raise InputError(f"{self.path}: the run has no metric")
        return self.metrics[0] if metric is None else metric

    @cached_property
    def _tables(self) -> tuple[pd.DataFrame, pd.DataFrame]:
        trials, scores = ([run_folder.read_table(p, name) for p in self.paths] for name in ("trials", "scores"))
        if len(self.paths) == 1:
            return trials[0], scores[0]
        from sonobench.board import refuse_two_parts, same_entries, together

        names = [str(p) for p in self.paths]
        refuse_two_parts(self.studies, trials, names)
        same_entries([study.get("entries", {}) for study in self.studies], names)
        return together(trials, scores, names)

    def _references(self, asked: Sequence[str]) -> tuple[list[Reference], dict[str, str]]:
        """References asked for and named by the studies, and why those of a study that are not here cannot be read."""
        named = [r for study in self.studies for r in study["study"].get("reference", ())]
        if not named and not asked:
            return [], {}
        from sonobench.scene.reference import Reference

        found: dict[str, Reference] = {}
        lost: dict[str, str] = {}
        for name in dict.fromkeys([*named, *asked]):
            try:
                reference = Reference.load(name, self.registry)
                found.setdefault(reference.name, reference)
            except SonobenchError as error:
                if name in asked:
                    raise
                lost[name] = str(error)
        return list(found.values()), lost


def open_run(*runs: str | Path) -> Run:
    """The results of one or several runs; each is a folder, or a name in runs/.

    Raises:
        InputError: not a run's folder.
    """
    if not runs:
        raise InputError("name a run: a folder, or a name in runs/")
    paths = tuple(dict.fromkeys(_found(r) for r in runs))
    metrics = [m for p in paths for m in run_folder.read_study(p)["metrics"]]
    return Run(paths, tuple(dict.fromkeys(metrics)))


def run_study(
    study: Study,
    *,
    trials: Sequence[str] = (),
    shard: tuple[int, int] | None = None,
    out: str | Path | None = None,
    jobs: int | None = None,
    timeout_s: float | None = None,
    memory_mb: float | None = None,
    fresh: bool = False,
    retry: Literal["failed"] | None = None,
    in_process: bool = False,
    engine: Literal["local", "dask"] = "local",
    scheduler: str | None = None,
    order: Literal["planned", "reversed"] = "planned",
    display: Display | None = None,
) -> Run:
    """Execute a study; what an earlier run in the same folder finished is kept.

    Args:
        study: validated.
        trials: only these, by the heads of their keys.
        shard: (k, n): the k-th of n parts of the plan, by recording, in a folder of its own; their boards can be one.
        out: the run's folder; by default runs/NAME in the current folder, with the keys of chosen trials or the shard.
        jobs: worker processes; by default the processors.
        timeout_s, memory_mb: what one step of a trial (rendering, front end, tracker, scoring) may take.
        fresh: throw away what is in the folder.
        retry: "failed" runs again what failed, though its code is unchanged; without it only timeouts and memory are tried again, under higher limits.
        in_process: no workers, hence no isolation and no limits, for debuggers and notebooks.
        engine: "dask" carries the jobs out on a Dask cluster: one of `jobs` workers on this machine, or the one at `scheduler`.
        scheduler: address of a Dask scheduler to join, such as "tcp://host:8786".
        order: in which trials are begun; results do not depend on it.
        display: shows progress; by default on stderr.

    Raises:
        TableError: the study cannot be run as it stands.
        InputError: the folder is in use or is not a run's.
    """
    from sonobench.describe import roles_within
    from sonobench.harness.code import forget
    from sonobench.harness.environment import environment, environment_id
    from sonobench.harness.journal import Journal
    from sonobench.harness.session import Session

    if jobs is not None and jobs < 1:
        raise InputError(f"jobs is {jobs}; at least 1 is needed")
    for name, limit in (("timeout_s", timeout_s), ("memory_mb", memory_mb)):
        if limit is not None and not 0 < limit < math.inf:
            raise InputError(f"{name} is {limit:g}; a positive number is needed, or none for no limit")
    if retry not in (None, "failed"):
        raise InputError(f"retry is {retry!r}; 'failed' is what can be tried again")
    if engine not in ("local", "dask"):
        raise InputError(f"engine is {engine!r}; 'local' and 'dask' are there")
    if in_process and (engine == "dask" or scheduler is not None):
        raise InputError("in_process (--in-process) means this process alone; leave out the engine and the scheduler")
    planned = chosen(study, trials, shard)
    forget()  # workers import what the sources say now
    cache = Cache.default()
    cache.sweep()
    folder = folder_of(study, planned if trials else None, shard, out)
    with run_folder.locked(folder):
        if fresh:
            run_folder.clear(folder)
        about = {
            "study": study.to_table(),
            "metrics": [m.label for m in planned.metrics],
            "metric_tables": {m.label: m.table for m in planned.metrics},
            "entries": {e.name: {"table": e.table, "roles": roles_within(e.pipeline)} for e in planned.entries},
            "swept": list(planned.columns),
            "shard": None if shard is None else f"{shard[0]}/{shard[1]}",
        }
        run_folder.prepare(folder, about, environment())
        journal = Journal(folder / "journal.jsonl")
        plugins = {str(p.path): p.version for p in study.registry.plugins if p.path is not None}
        limits = Limits() if in_process else Limits(timeout_s, memory_mb)
        observe, failed = study.registry.trial_finished, retry == "failed"
        session = Session(planned, plugins, folder, cache, journal, environment_id(), observe, limits, failed)
        session.keep_parts()
        complete = True
        try:
            begin = partial(session.begin, order == "reversed")
            how = None if in_process else _engine("dask" if scheduler is not None else engine, jobs, scheduler)
            _carry_out(session, begin, how, display)
        except KeyboardInterrupt:
            complete = len(planned) <= _SOON  # what is done is in the journal; whoever interrupts wants to have the terminal back
            raise
        finally:
            journal.close()
            if complete:
                run_folder.write_tables(folder, session.rows(), planned.swept)
    for fault, count in sorted(session.metric_faults.items()):
        print(f"{fault} ({count} trials; see {folder / 'logs'}/score-*.log)", file=sys.stderr)
    return open_run(folder)


def chosen(study: Study, trials: Sequence[str] = (), shard: tuple[int, int] | None = None) -> Plan:
    """The plan of a study, or of a part of it.

    Raises:
        TableError: the study cannot be run as it stands.
        InputError: no such trial or part.
    """
    planned = study.plan()
    if planned.faults:
        raise TableError(planned.faults)
    planned = planned.only(trials)
    return planned if shard is None else planned.shard(*shard)


def folder_of(study: Study, picked: Plan | None, shard: tuple[int, int] | None, out: str | Path | None) -> Path:
    """Where a run is kept: `out`, else runs/NAME, with the heads of picked trials' keys, and "-1of4" for a shard."""
    if out is not None:
        return Path(out).resolve()
    heads = [] if picked is None else [t.trial_key[:8] for t in picked]
    part = [] if shard is None else [f"{shard[0]}of{shard[1]}"]
    return Path(RUNS, "-".join([study.name, *heads, *part])).resolve()


Tick = Callable[[Iterable["Job"]], None]


def _carry_out(
    session: Session, begin: Callable[[], None], how: Callable[[Session, Path, Tick], None] | None, display: Display | None
) -> None:
    from sonobench.harness.local import execute_here
    from sonobench.harness.parts import numba_cache
    from sonobench.harness.progress import Tally
    from sonobench.harness.progress import display as suitable

    with display or suitable() as show:

        def tick(running: Iterable[Job]) -> None:
            run_folder.load()  # while workers start, so that an interrupt need not wait for it
            show(Tally(len(session.plan), len(session.finished), session.failed, len(list(running))))

        begin()
        if how is None:
            execute_here(session, tick)
        elif session.ready:
            how(session, numba_cache(session.plan, session.cache), tick)
        tick([])


def _engine(name: str, jobs: int | None, scheduler: str | None) -> Callable[[Session, Path, Tick], None]:
    """What carries out a session's jobs in worker processes, given where compiled code is kept."""
    from sonobench.harness import local

    workers = jobs or local.processors()

    def on_dask(session: Session, numba_cache: Path, tick: Tick) -> None:
        from sonobench.harness.dask_cluster import connected
        from sonobench.harness.dask_engine import execute

        with connected(workers, scheduler) as client:
            execute(session, session.limits, numba_cache, tick, client)

    def here(session: Session, numba_cache: Path, tick: Tick) -> None:
        local.execute(session, workers, session.limits, numba_cache, tick)

    return on_dask if name == "dask" else here


def _found(run: str | Path) -> Path:
    path = Path(run)
    if path.is_dir() or len(path.parts) != 1:
        return path.resolve()
    named = Path(RUNS) / path
    if named.is_dir():
        return named.resolve()
    raise InputError(f"{run}: neither a run's folder nor a name in {RUNS}/")
