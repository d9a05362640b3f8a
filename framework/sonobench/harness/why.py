"""Why a trial's row is what it is: what made its key, what changed since, how it ended, and how to repeat it alone."""

from __future__ import annotations

import fnmatch
import itertools
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sonobench.errors import InputError, SonobenchError
from sonobench.harness import journal, run_folder
from sonobench.harness.keys import score_keys, seed_of
from sonobench.harness.parts import Codes, Part, pipeline_part, read_parts, scene_part, scored_output
from sonobench.harness.rows import TRIAL_COLUMNS, Row

if TYPE_CHECKING:
    from sonobench.harness.plan import MetricEntry, Plan, PlannedTrial
    from sonobench.scene.study import Study

_LINES = 60  # of a log that are shown
_STUDY_KEYS = ("scenes", "recordings", "repetitions", "seed", "metrics", "pipelines", "sweep")


def explain(folder: Path, trial: str) -> dict[str, Any]:
    """All that is known of one trial of a run, as plain data.

    Args:
        folder: the run's.
        trial: head of a trial's key, or PIPELINE/SCENE/REPETITION (patterns such as "mine*/lab/0" too).

    Raises:
        InputError: no run's folder, or not exactly one such trial.
    """
    stored = run_folder.read_study(folder)
    row = find(stored_rows(folder), trial)
    parts = read_parts(folder / "parts.jsonl")
    made_of = _made_of(row, parts, stored["study"])
    explained: dict[str, Any] = {"trial": row, "made_of": made_of, "open_because": list(filter(None, row["open_because"].split("; ")))}
    explained["failure"] = _failure(folder, row)
    try:
        study = study_of(folder)
        before = _Before(made_of, parts, stored.get("metric_tables", {}), journal.read(folder / "journal.jsonl"))
        explained |= _now(study.plan(), row, before)
        explained["command"] = command(study, row)
    except SonobenchError as error:
        explained |= {"changed": [], "verdict": f"the study cannot be loaded any more: {error}", "scores": {}, "command": None}
    return explained


def stored_rows(folder: Path) -> list[Row]:
    """A run's rows; from the journal where the tables were not written yet, or are damaged.

    Raises:
        InputError: neither holds any.
    """
    try:
        frame = run_folder.read_table(folder, "trials", TRIAL_COLUMNS)
    except InputError as error:
        if not (rows := list(journal.read(folder / "journal.jsonl").trials.values())):
            raise InputError(f"{error}; the journal has no trial either") from None
        return rows
    return [_plain(row) for row in frame.to_dict("records")]


def find(rows: Sequence[Row], trial: str) -> Row:
    """The one row that a head of a key, or PIPELINE/SCENE/REPETITION, names.

    Raises:
        InputError: none, or more than one.
    """
    found = [r for r in rows if trial and str(r["trial_key"]).startswith(trial)]
    if "/" in trial:
        found = [r for r in rows if fnmatch.fnmatchcase(f"{r['pipeline']}/{r['scene']}/{r['repetition']}", _literal(trial))]
    if len(found) == 1:
        return found[0]
    if not found:
        raise InputError(f"no trial of this run is {trial!r}; give the head of a trial_key, or PIPELINE/SCENE/REPETITION")
    shown = ", ".join(f"{r['trial_key'][:8]} ({r['pipeline']}/{r['scene']}/{r['repetition']})" for r in found[:10])
    raise InputError(f"{len(found)} trials are {trial!r}: {shown}{' …' if len(found) > 10 else ''}")


def study_of(folder: Path) -> Study:
    """The study of a run's folder, from what it wrote down.

    Raises:
        SonobenchError: it cannot be loaded any more.
    """
    from sonobench.scene.study import Study

    about = run_folder.read_study(folder)["study"]
    if lacking := [k for k in ("folder", "plugins", *_STUDY_KEYS) if k not in about]:
        raise InputError(f"{folder / 'study.json'}: lacks {lacking} of the study; run it again (finished trials are kept)")
    return Study.from_table({k: about[k] for k in _STUDY_KEYS}, Path(about["folder"]) / f"{about['name']}.toml", about["plugins"])


def command(study: Study, row: Mapping[str, Any]) -> str:
    """The command line that repeats one trial alone, in this process, in a folder of its own."""
    from sonobench.scene.study import Study as Loaded

    path = study.folder / f"{study.name}.toml"
    try:
        shipped = study.registry.find_data("studies", study.name, ".toml") == path
    except SonobenchError:
        shipped = False
    words = ["sonobench", "run", study.name if shipped else str(path)]
    as_written = Loaded.load(words[-1])
    for plugin in study.plugins:
        words += [] if plugin in as_written.plugins else ["--plugin", str(plugin)]
    for name in study.pipelines:
        words += [] if name in as_written.pipelines else ["--also", name]
    for name in ("repetitions", "seed"):
        words += [] if getattr(study, name) == getattr(as_written, name) else [f"--{name}", str(getattr(study, name))]
    return shlex.join([*words, "--trial", row["trial_key"], "--in-process", "--fresh"])


def _made_of(row: Row, parts: Mapping[str, Part], about: Mapping[str, Any]) -> dict[str, Any]:
    scene, pipeline = parts.get(row["scene_sha"], {}), parts.get(row["pipeline_sha"], {})
    codes = {"scene": scene.get("code"), "front_end": pipeline.get("front_end"), "tracker": pipeline.get("tracker")}
    return {
        "scene": {k: v for k, v in scene.items() if k not in ("kind", "code")},
        "seed": seed_of(about.get("seed", 0), row["scene"], row["repetition"]) if "table" in scene else None,
        "run": row["run"],
        "recording_key": row["recording_key"],
        "input_sha": row["input_sha"],
        "pipeline": pipeline.get("table", {}),
        "code": {part: parts.get(sha, {}) for part, sha in codes.items() if sha},
        "estimate_key": row["estimate_key"],
    }


@dataclass(frozen=True, slots=True)
class _Before:
    """What the run's folder says of what it was made of.

    Attributes:
        made_of: a trial's parts.
        parts: all of them, by name.
        metrics: the full table of each metric.
        recorded: the journal.
    """

    made_of: Mapping[str, Any]
    parts: Mapping[str, Part]
    metrics: Mapping[str, Any]
    recorded: journal.Recorded


def _now(plan: Plan, row: Row, before: _Before) -> dict[str, Any]:
    """What differs between the stored row and the study as it stands, and what the next run will do about it."""
    names = ("pipeline", "scene", "repetition", "run")
    same = [t for t in plan if t.trial_key == row["trial_key"]] or [t for t in plan if all(getattr(t, n) == row[n] for n in names)]
    if not same:
        return {"changed": [], "verdict": "it is not planned any more", "scores": {}}
    trial, codes = same[0], Codes.of(plan)
    told = bool(before.made_of["scene"] and before.made_of["pipeline"])
    changed = list(_changes(trial, codes, before.made_of)) if told else []
    scores = {m.label: _score(before.recorded, codes.score_key(m, trial.entry, row)) for m in plan.metrics}
    others = {m.label: list(_metric_changes(m, trial, codes, row, before)) for m in plan.metrics}
    verdict = _verdict(trial, codes, row, changed, [label for label, found in others.items() if found])
    lost = [] if told else ["unknown: parts.jsonl, which says what it was made of, is missing or damaged"]
    return {"changed": [*lost, *changed, *itertools.chain(*others.values())], "verdict": verdict, "scores": scores}


def _changes(trial: PlannedTrial, codes: Codes, made_of: Mapping[str, Any]) -> Iterator[str]:
    scene, pipeline = scene_part(trial.source, codes), pipeline_part(trial.entry, codes)
    tables = list(_table_changes("scene", made_of["scene"].get("table", {}), scene.get("table", {})))
    yield from tables
    if not tables and made_of["scene"].get("content") != scene.get("content"):
        yield "scene: the content of a sound's file"
    if made_of["scene"].get("input_sha") != scene.get("input_sha"):
        yield f"recording: its content (input_sha {made_of['scene'].get('input_sha')} → {scene.get('input_sha')})"
    yield from _table_changes("pipeline", made_of["pipeline"], pipeline["table"])
    groups = {"scene": codes.scenes.get(id(trial.source))}
    groups |= {"front_end": codes.front_ends.get(trial.entry.name), "tracker": codes.trackers.get(trial.entry.name)}
    for part, found in groups.items():
        if found is not None and (stored := made_of["code"].get(part)):
            yield from _code_changes(f"code of the {part.replace('_', ' ')}", stored, found.to_table())


def _metric_changes(metric: MetricEntry, trial: PlannedTrial, codes: Codes, row: Row, before: _Before) -> Iterator[str]:
    """What is other in a metric than when this row's output was last scored; nothing where the score is there, or never was."""
    if codes.score_key(metric, trial.entry, row) in before.recorded.scores:
        return
    table, output = before.metrics.get(metric.label, metric.table), scored_output(trial.entry, row)
    keys = {sha: score_keys(table, sha)(output, row["truth_sha"]) for sha, part in before.parts.items() if part["kind"] == "code"}
    used = [sha for sha, key in keys.items() if key in before.recorded.scores]  # the code that scored it is the one that the key is made of
    if used:
        yield from _table_changes(f"metric {metric.label}", table, metric.table)
        yield from _code_changes(f"code of the metric {metric.label}", before.parts[used[-1]], codes.metrics[metric.label].to_table())


def _code_changes(head: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[str]:
    if old["python"] != new["python"]:
        yield f"{head}: Python {old['python']} → {new['python']}"
    for kind, word in (("modules", "module"), ("distributions", "distribution"), ("files", "file")):
        before, after = dict(old[kind]), dict(new[kind])
        for name in sorted(before.keys() | after.keys()):
            was, now = before.get(name), after.get(name)
            if was is None or now is None:
                yield f"{head}: {word} {name} is {'new' if was is None else 'gone'}"
            elif was != now:
                yield f"{head}: {word} {name} {f'{was} → {now}' if kind == 'distributions' else 'was edited'}"


def _table_changes(path: str, old: Any, new: Any) -> Iterator[str]:
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in sorted(old.keys() | new.keys()):
            yield from _table_changes(f"{path}.{key}", old.get(key), new.get(key))
    elif _listed(old) != _listed(new):
        yield f"{path}: {old!r} → {new!r}"


def _verdict(trial: PlannedTrial, codes: Codes, row: Row, changed: Sequence[str], metrics: Sequence[str]) -> str:
    if row["status"] == "skipped":
        return "it has not run; the next run begins it"
    if trial.trial_key != row["trial_key"]:
        return f"the study now plans another trial in its place ({trial.trial_key})"
    if row["open"]:
        return "it is open: the next run repeats it"
    if changed:
        return "the next run repeats what depends on the change"
    runs = trial.entry.pipeline is not None and row["input_sha"]
    if runs and codes.estimate_key(trial.entry, row["input_sha"], trial.run) != row["estimate_key"]:
        return "its key has changed: the next run repeats it"
    if metrics:
        return f"the next run keeps its output and scores it again ({', '.join(metrics)})"
    if row["status"] in ("timeout", "oom"):
        return "the next run repeats it if the limit that it met is higher, or with --retry failed"
    return "the next run keeps it" if row["status"] == "ok" else "the next run keeps it, unless with --retry failed"


def _score(recorded: journal.Recorded, key: str) -> str:
    stored = recorded.scores.get(key)
    if stored is None:
        return "not there for this output, truth and metric; the next run computes it"
    if "error" in stored:
        return str(stored["error"])
    return f"open: {'; '.join(stored['beyond'])}" if stored.get("beyond") else "stored"


def _failure(folder: Path, row: Row) -> dict[str, Any] | None:
    """How a trial ended that is not ok: its exception, and the end of its log from the last traceback on."""
    if row["status"] == "ok":
        return None
    text = ""
    if row["log_path"] and (path := folder / row["log_path"]).is_file():
        text = path.read_text("utf-8", "replace")
    lines = text[max(text.rfind("Traceback (most recent call last)"), 0) :].splitlines()
    return {"exc_type": row["exc_type"], "exc_message": row["exc_message"], "log": row["log_path"], "traceback": lines[-_LINES:]}


def _listed(value: Any) -> Any:
    return [_listed(v) for v in value] if isinstance(value, (list, tuple)) else value


def _literal(pattern: str) -> str:
    return pattern.replace("[", "[[]")  # swept entries are named mine[floor=0.1]


def _plain(row: Mapping[Any, Any]) -> Row:
    import pandas as pd

    return {str(k): None if pd.isna(v) else v.item() if hasattr(v, "item") else v for k, v in row.items()}
