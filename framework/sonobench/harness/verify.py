"""Whether a run can be believed: trials are repeated from nothing, or scores computed again from stored estimates.

`verify_trials` repeats a sample of the trials in fresh processes, nothing taken from any cache, and compares their
estimates bit for bit: it finds results that depend on the clock, on other trials, on memory that was not initialised.
`verify_scores` scores what lies in the run's folder again: it finds files that were changed and scores that nothing
stands behind.
"""

from __future__ import annotations

import hashlib
import math
import select
import tempfile
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar
from uuid import uuid4

from sonobench.errors import InputError, SonobenchError
from sonobench.harness import journal, run_folder
from sonobench.harness.cache import SCANS_BUDGET, Cache
from sonobench.harness.cell import Cell, Limits, Outcome, close_all
from sonobench.harness.environment import environment_id
from sonobench.harness.parts import Codes, covered, numba_cache
from sonobench.harness.rows import Row
from sonobench.harness.why import stored_rows, study_of

if TYPE_CHECKING:
    from sonobench.harness.plan import Plan, PlannedTrial
    from sonobench.scene.study import Study

_RELATIVE = 1e-9  # how far a score may be off where it was computed in another environment
_VALUES = ("value", "weight", "coverage")
T = TypeVar("T")
Finding = dict[str, Any]
Chain = Generator[Mapping[str, Any], Outcome, T]  # gives tasks, gets their outcomes, returns what came of them


@dataclass(frozen=True, slots=True)
class Verified:
    """What a verification found.

    Attributes:
        checked, planned: how many trials were looked at, of how many.
        findings: trial_key, pipeline, scene, repetition, and in `fault` what is wrong.
    """

    checked: int
    planned: int
    findings: tuple[Finding, ...]

    def __str__(self) -> str:
        head = f"verified {self.checked} of {self.planned} trials: "
        return head + (f"{len(self.findings)} findings" if self.findings else "all the same")

    def to_table(self) -> dict[str, Any]:
        """Plain data, for JSON."""
        return {"checked": self.checked, "planned": self.planned, "findings": list(self.findings)}


def sample(keys: Iterable[str], share: float) -> list[str]:
    """A share of the keys, at least one, always the same ones.

    Raises:
        InputError: the share is not within (0, 1].
    """
    if not 0 < share <= 1:
        raise InputError(f"a share of {share:g} cannot be verified; say 2% or 0.02")
    ordered = sorted(keys, key=lambda key: hashlib.sha256(f"verify {key}".encode()).digest())
    return ordered[: max(math.ceil(share * len(ordered) - 1e-9), 1)]


def verify_trials(study: Study, folder: Path, share: float, jobs: int | None = None) -> Verified:
    """Repeat a sample of the finished trials of a run of this study, each in a process of its own.

    Raises:
        InputError: a share that is not within (0, 1], or no run's folder.
    """
    rows = {r["trial_key"]: r for r in stored_rows(folder)}
    chosen = sample((k for k, r in rows.items() if r["status"] == "ok"), share)
    plan = study.plan().only(chosen)
    codes = Codes.of(plan)
    with tempfile.TemporaryDirectory(prefix="sonobench-verify-") as scratch:
        chains = (_again(t, rows[t.trial_key], codes, study, folder, Path(scratch) / t.trial_key) for t in plan if chosen)
        faults = _carry(chains, jobs, Path(scratch) / "numba", fresh=True)
    findings = [_finding(rows[t.trial_key], f) for t, f in zip(plan, faults, strict=False) if f]
    return Verified(len(chosen), len(rows), tuple(findings))


def verify_scores(folder: Path, jobs: int | None = None) -> Verified:
    """Compute every score of a run again from its stored estimates; where scores.parquet is missing it is written anew.

    Raises:
        InputError: no run's folder.
        SonobenchError: its study cannot be loaded any more.
    """
    study = study_of(folder)
    plan = study.plan()
    rows = {r["trial_key"]: r for r in stored_rows(folder)}
    codes, planned = Codes.of(plan), {t.trial_key: t for t in plan}
    findings = [_finding(r, "is not planned by the study any more") for k, r in rows.items() if k not in planned]
    altered = {k: fault for k, r in rows.items() if (fault := _altered(folder, r))}
    findings += [_finding(rows[k], fault) for k, fault in altered.items()]
    todo = [planned[k] for k, row in rows.items() if k in planned and k not in altered and row["input_sha"]]
    stored = _stored_scores(folder, plan, codes, todo, rows)
    with tempfile.TemporaryDirectory(prefix="sonobench-verify-") as scratch:
        chains = (_score_again(t, rows[t.trial_key], plan, codes, study, folder, Path(scratch)) for t in todo)
        made = _carry(chains, jobs, numba_cache(plan, Cache.default()), fresh=False)
    again: list[Row] = []
    for trial, result in zip(todo, made, strict=True):
        row = rows[trial.trial_key]
        if isinstance(result, str):
            findings.append(_finding(row, result))
            continue
        again += result
        findings += [_finding(row, fault) for fault in _differences(stored.get(trial.trial_key, {}), result, row)]
    if not (folder / "scores.parquet").exists():
        run_folder.write_scores(folder, again)
    return Verified(len(todo) + len(altered), len(rows), tuple(findings))


def _again(trial: PlannedTrial, row: Row, codes: Codes, study: Study, folder: Path, scratch: Path) -> Chain[str]:
    """Render and track once more; returns what is wrong, "" if nothing is."""
    scratch.mkdir()
    recording, faults = yield from _recording(trial, row, codes, study, scratch)
    if faults:
        return faults
    output = scratch / Path(row["estimates_path"]).name
    entry = trial.entry
    task = _task("track", study, recording, scratch, trial) | {
        "run": trial.run,
        "input_sha": row["input_sha"],
        "estimate_key": row["estimate_key"],
        "scans_key": codes.scans_key(entry, row["input_sha"]),
        "known": covered(codes.trackers[entry.name]),
        "known_front_end": covered(codes.front_ends[entry.name]),
        "output": str(output),
    }
    outcome = yield task
    if outcome.status != "ok":
        return f"ended as {outcome.status} when it was repeated: {outcome.exc_type}: {outcome.exc_message}"
    return _other(folder / row["estimates_path"], output)


def _score_again(
    trial: PlannedTrial, row: Row, plan: Plan, codes: Codes, study: Study, folder: Path, scratch: Path
) -> Chain[list[Row] | str]:
    """Score a stored output; returns rows of scores, or what is wrong."""
    recording, faults = yield from _recording(trial, row, codes, study, Cache.default().root)
    if faults:
        return faults
    metrics = [{"label": m.label, "key": m.label, "table": dict(m.table), "known": covered(codes.metrics[m.label])} for m in plan.metrics]
    task = _task("score", study, recording, scratch, trial) | {
        "available": trial.entry.pipeline is not None,
        "output": str(folder / row["estimates_path"]) if row["status"] == "ok" else None,
        "metrics": metrics,
        "scans_key": codes.scans_key(trial.entry, row["input_sha"]),
    }
    outcome = yield task
    if outcome.status != "ok":
        return f"could not be scored again: {outcome.status}: {outcome.exc_message}"
    shas = {m.label: m.sha for m in plan.metrics}
    made = outcome.value.items()
    return [{"trial_key": trial.trial_key, "metric_sha": shas[k], **r} for k, done in made for r in done.get("rows", ())]


def _recording(trial: PlannedTrial, row: Row, codes: Codes, study: Study, root: Path) -> Chain[tuple[Path, str]]:
    """A trial's recording, rendered if need be, and what is wrong with it."""
    source = trial.source
    if source.scene is None or trial.seed is None:
        found = {"input_sha": source.sha, "truth_sha": source.truth_sha}
        path = Path(source.home)
    else:
        path = Cache(root).recording(codes.recording_key(source, trial.seed))
        about = {"home": source.home, "overrides": dict(source.overrides), "sha": source.sha, "seed": trial.seed}
        outcome = yield _task("render", study, path, root) | about | {"known": covered(codes.scenes[id(source)])}
        if outcome.status != "ok":
            return path, f"its scene could not be rendered again: {outcome.exc_type}: {outcome.exc_message}"
        found = outcome.value
    differs = [name for name in ("input_sha", "truth_sha") if found[name] != row[name]]
    return path, f"its recording is another one now ({' and '.join(differs)} differ)" if differs else ""


def _task(step: str, study: Study, recording: Path, root: Path, trial: PlannedTrial | None = None) -> dict[str, Any]:
    return {
        "step": step,
        "plugins": {str(p.path): p.version for p in study.registry.plugins if p.path is not None},
        "recording": str(recording),
        "cache": str(root),
        "scans_budget": SCANS_BUDGET,
        "session": uuid4().hex,
        "folder": str(root),
        **({"pipeline": trial.entry.table} if trial is not None else {}),
    }


def _carry(chains: Iterable[Chain[T]], jobs: int | None, numba_cache: Path, fresh: bool) -> list[T]:
    """Carry chains out in cells, in a new one each if `fresh`; what they return, in their order."""
    from sonobench.harness.local import processors

    todo = deque(enumerate(chains))
    results: dict[int, T] = {}
    cells: list[Cell] = []
    busy: dict[Cell, tuple[int, Chain[T]]] = {}

    def go_on(cell: Cell, number: int, chain: Chain[T], outcome: Outcome | None) -> None:
        try:
            cell.submit(next(chain) if outcome is None else chain.send(outcome), Limits())
            busy[cell] = number, chain
        except StopIteration as end:
            results[number] = end.value
            if fresh:
                cells.remove(cell)
                cell.close()

    try:
        while todo or busy:
            while todo and len(busy) < (jobs or processors()):
                cell = next((c for c in cells if c not in busy), None)
                if cell is None:
                    cells.append(cell := Cell(numba_cache))
                go_on(cell, *todo.popleft(), None)
            for cell in select.select(list(busy), [], [])[0] if busy else ():
                go_on(cell, *busy.pop(cell), cell.take())
    finally:
        close_all(cells)
    return [results[number] for number in sorted(results)]


def _other(stored: Path, again: Path) -> str:
    """How two outputs of one trial differ, bit for bit; "" if they do not."""
    from sonobench.log import estimates_sha, read_estimates, read_scans
    from sonobench.types import identical

    try:
        if stored.suffix == ".npz":
            return "" if identical(read_scans(stored), read_scans(again)) else "its scans are others when it is repeated"
        (before, space, _), (after, other, _) = read_estimates(stored), read_estimates(again)
    except SonobenchError as error:
        return f"cannot be compared: {error}"
    if estimates_sha(before, space) == estimates_sha(after, other):
        return ""
    if len(before) != len(after) or space != other:
        return f"gives {len(after)} estimates in place of {len(before)} when it is repeated"
    first = next(n for n, (a, b) in enumerate(zip(before, after, strict=True)) if estimates_sha([a], space) != estimates_sha([b], space))
    return f"its estimates are others when it is repeated, from {before[first].time_s:g} s on (scan {first} of {len(before)})"


def _altered(folder: Path, row: Row) -> str:
    """What is wrong with a stored output's file."""
    if row["status"] != "ok":
        return ""
    path = folder / row["estimates_path"]
    if not path.is_file():
        return f"{row['estimates_path']} is missing"
    if hashlib.sha256(path.read_bytes()).hexdigest() != row["output_sha"]:
        return f"{row['estimates_path']} was altered: its SHA-256 is not the row's output_sha"
    return ""


def _stored_scores(
    folder: Path, plan: Plan, codes: Codes, trials: Sequence[PlannedTrial], rows: Mapping[str, Row]
) -> dict[str, dict[tuple[str, str], Row]]:
    """Rows by (metric column, slice) by trial: from scores.parquet, or from the journal, the current code's in either case last."""
    found: dict[str, dict[tuple[str, str], Row]] = {}
    if (folder / "scores.parquet").exists():
        for row in run_folder.read_table(folder, "scores").to_dict("records"):
            found.setdefault(row["trial_key"], {})[row["metric"], row["slice"]] = {str(k): v for k, v in row.items()}
        return found
    scores = journal.read(folder / "journal.jsonl").scores
    for trial in trials:
        for metric in plan.metrics:
            stored = scores.get(codes.score_key(metric, trial.entry, rows[trial.trial_key]), {})
            for row in stored.get("rows", ()):
                found.setdefault(trial.trial_key, {})[row["metric"], row["slice"]] = row
    return found


def _differences(stored: Mapping[tuple[str, str], Row], again: Sequence[Row], row: Row) -> Iterator[str]:
    """Scores that are not what they were: to the last bit in the same environment, else beyond 1e-9 of their size."""
    exact = row["env_id"] == environment_id()
    made = {(r["metric"], r["slice"]): r for r in again}
    for name in sorted(stored.keys() | made.keys()):
        label = " ".join(filter(None, name))
        if name not in made:
            yield f"{label}: is stored, but nothing gives it"
        elif name not in stored:
            yield f"{label}: is not stored (for this output, truth and code of the metric)"
        else:
            for kind in _VALUES:
                before, after = stored[name][kind], made[name][kind]
                if not _agree(before, after, exact):
                    yield f"{label}: {kind} {before!r} is stored, {after!r} comes from the stored estimates"


def _agree(before: float | None, after: float | None, exact: bool) -> bool:
    if before is None or after is None or math.isnan(before) or math.isnan(after):
        return (before is None or math.isnan(before)) == (after is None or math.isnan(after))
    return before == after if exact else math.isclose(before, after, rel_tol=_RELATIVE, abs_tol=0.0)


def _finding(row: Mapping[str, Any], fault: str) -> Finding:
    return {**{k: row[k] for k in ("trial_key", "pipeline", "scene", "repetition")}, "fault": fault}
