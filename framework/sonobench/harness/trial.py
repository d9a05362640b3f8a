"""The steps of a trial, as they run inside a worker: render, front end, tracker, score.

A step takes and returns plain data; what is large goes through files. Components arrive as tables and are built here.
Only a component's own work is timed: the first scans are run once untimed, so that imports and stored machine code
are in place, and Numba's compilation is subtracted.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sonobench.components import canonical_json, digest
from sonobench.errors import InputError, LogError, SetupError
from sonobench.files import no_room, replace_file
from sonobench.harness.cache import Cache
from sonobench.harness.rows import DISK
from sonobench.uses import beyond, follow, watching

if TYPE_CHECKING:
    from sonobench.log import Recording
    from sonobench.pipeline import Pipeline
    from sonobench.registry import Registry
    from sonobench.types import Scan, Setup, Space

Task = Mapping[str, Any]
_WARM_BLOCKS, _WARM_SCANS = 2, 3
_WARMED: set[str] = set()  # what has run once in this process


def perform(task: Task) -> dict[str, Any]:
    """Do one step and say what became of it; nothing is raised."""
    _reset_peak()
    step = {"render": render, "scans": scans, "track": track, "score": score}[task["step"]]
    try:
        with watching():
            follow(task.get("known", {}).get("names", ()))
            result = {"status": "ok", "value": step(task)}
    except BaseException as error:  # a component may raise anything, SystemExit and KeyboardInterrupt too
        traceback.print_exc()
        kind = DISK if no_room(error) else type(error).__name__
        result = {"status": status_of(error), "exc_type": kind, "exc_message": str(error)}
    found = _beyond(task, "known")
    if found:
        print(f"open: used beyond what keys cover: {'; '.join(found)}; this result is never reused", file=sys.stderr)
    return {**result, "beyond": found, "peak_mb": _peak_mb()}


def status_of(error: BaseException) -> str:
    """ "invalid" for output that breaks its role's contract, "oom", "unavailable", else "error"."""
    from sonobench import types
    from sonobench.errors import UnavailableError
    from sonobench.pipeline import InvalidOutput

    if isinstance(error, InvalidOutput):
        return "invalid"
    if isinstance(error, MemoryError):
        return "oom"
    if isinstance(error, UnavailableError):
        return "unavailable"
    last = traceback.extract_tb(error.__traceback__)[-1:]
    refused = isinstance(error, ValueError) and any(frame.filename == types.__file__ for frame in last)
    return "invalid" if refused else "error"  # a value that types.py refuses to travel: NaN, a wrong shape


def render(task: Task) -> dict[str, Any]:
    """Scene and seed → a recording in the cache; returns its hashes."""
    from sonobench.log import write_recording
    from sonobench.scene.scene import Scene

    path = Path(task["recording"])
    notes = path.with_suffix(".json")  # only beside what an open scene made
    if path.exists() and (not notes.exists() or Cache.notes(notes, task["session"])):
        with suppress(LogError):  # damaged: render it again
            return _hashes(path)
    scene = Scene.load(task["home"], _registry(task), task["overrides"])
    if scene.digest() != task["sha"]:
        raise InputError(f"scene {task['home']} changed while the study ran; run it again")
    begin = time.perf_counter()
    rendering = scene.simulate(task["seed"])
    if found := _beyond(task, "known"):
        replace_file(notes, json.dumps({"beyond": found, "session": task["session"]}).encode())
    else:
        notes.unlink(missing_ok=True)
    write_recording(path, rendering)
    per_s = (time.perf_counter() - begin) / scene.duration_s
    Cache(Path(task["cache"])).keep_cost(task["sha"], digest(scene.table["simulator"]), per_s)
    return _hashes(path)


def scans(task: Task) -> dict[str, Any]:
    """Recording → the front end's scans in the cache."""
    made = _stored_scans(task) or _make_scans(task, _pipeline(task), _recording(task["recording"]))
    return {"front_end_s": made.front_end_s, "frames": len(made.scans)}


def track(task: Task) -> dict[str, Any]:
    """Recording (and its scans, where they are in the cache) → a file of estimates; returns times and counts."""
    from sonobench.log import write_estimates, write_scans
    from sonobench.pipeline import generator
    from sonobench.pipeline import track as run_tracker

    pipeline, recording, out = _pipeline(task), _recording(task["recording"]), Path(task["output"])
    tracker = pipeline.tracker
    made = _stored_scans(task) or _make_scans(task, pipeline, recording)
    timer = Timer()
    if tracker is None:
        write_scans(out, made.setup, made.scans)
    else:
        _warm("track", task["pipeline"], lambda: run_tracker(tracker, made.setup, made.scans[:_WARM_SCANS], generator("", 0)))
        with timed(timer):
            estimates = run_tracker(tracker, made.setup, made.scans, generator(task["input_sha"], task["run"]))
        meta = {"estimate_key": task["estimate_key"], "input_sha": task["input_sha"], "run": task["run"]}
        write_estimates(out, estimates, tracker.space, meta)
    duration_s = recording.header.duration_s
    return {
        "front_end_s": made.front_end_s,
        "tracker_s": timer.seconds,
        "cpu_s": timer.cpu_s,
        "frames": len(made.scans),
        "beyond": made.beyond,
        "output_sha": hashlib.sha256(out.read_bytes()).hexdigest(),
        "real_time_factor": (made.front_end_s + timer.seconds) / duration_s if duration_s > 0 else float("nan"),
    }


def score(task: Task) -> dict[str, Any]:
    """A trial's output (None: it failed) → rows by score key; a metric that raises gives its message instead."""
    from sonobench.components import build
    from sonobench.scoring import score as evaluate

    truth, registry = _recording(task["recording"]).truth, _registry(task)
    done: dict[str, Any] = {}
    outputs: dict[str, tuple[Sequence[Any], Space | Setup | None]] = {}  # metrics read the same
    for item in task["metrics"]:
        try:
            metric = build("metric", item["table"], registry, item["label"])
            reads = getattr(metric, "reads", "estimates")
            outputs[reads] = outputs.get(reads) or _output(task, reads)
            output, space = list(outputs[reads][0]), outputs[reads][1]
            rows = [row._asdict() for row in evaluate(metric, truth, output, space, item["label"])]
            found = _beyond({**task, **item}, "known")
            done[item["key"]] = {"rows": rows, "beyond": found} if found else {"rows": rows}
        except Exception as error:  # one metric's fault must not cost the others
            traceback.print_exc()
            done[item["key"]] = {"error": f"{type(error).__name__}: {error}"}
    return done


def _hashes(path: Path) -> dict[str, str]:
    recording = _recording(str(path))
    return {"input_sha": recording.input_sha, "truth_sha": recording.truth_sha}


@dataclass(frozen=True, slots=True)
class Made:
    """A front end's output and what it cost."""

    setup: Setup
    scans: Sequence[Scan]
    front_end_s: float
    beyond: Sequence[str]


@dataclass(slots=True)
class Timer:
    """Seconds of a component's own work."""

    seconds: float = 0.0
    cpu_s: float = 0.0


@contextmanager
def timed(timer: Timer) -> Iterator[None]:
    """Measure a block, Numba's compilation left out."""
    with _compilation() as compiled:
        begin, begin_cpu = time.perf_counter(), time.process_time()
        yield
        seconds, cpu_s = time.perf_counter() - begin, time.process_time() - begin_cpu
    spent = sum(compiled)
    timer.seconds, timer.cpu_s = max(seconds - spent, 0.0), max(cpu_s - spent, 0.0)


@contextmanager
def _compilation() -> Iterator[list[float]]:
    spent: list[float] = []
    if "numba" not in sys.modules:
        yield spent
        return
    from numba.core import event

    with event.install_timer("numba:compile", spent.append):
        yield spent


def _make_scans(task: Task, pipeline: Pipeline, recording: Recording) -> Made:
    """Run the front end, and keep its scans where the budget lets them."""
    from sonobench.log import write_scans
    from sonobench.pipeline import scans_of

    _warm("scans", task["pipeline"], lambda: _first_scans(pipeline, recording))
    timer = Timer()
    with timed(timer):
        setup, made = scans_of(pipeline.front_end, recording, pipeline.given)
    found = _beyond(task, "known_front_end")
    cache = Cache(Path(task["cache"]))
    path, notes = cache.scans(task["scans_key"])
    with suppress(ValueError):  # a plugin's own field cannot be stored: its scans are made for each tracker
        write_scans(path, setup, made)
        about = {"front_end_s": timer.seconds, "beyond": found, "session": task["session"]}
        replace_file(notes, json.dumps(about if found else {"front_end_s": timer.seconds}).encode())
        cache.trim_scans(task["scans_budget"])
    return Made(setup, made, timer.seconds, found)


def _stored_scans(task: Task) -> Made | None:
    from sonobench.log import read_scans

    path, notes = Cache(Path(task["cache"])).scans(task["scans_key"])
    about = Cache.notes(notes, task["session"])
    if about is None:
        return None
    try:
        cost = about["front_end_s"]
        setup, stored = read_scans(path)
        os.utime(path)  # used last, thrown away last
    except (OSError, ValueError, KeyError, LogError):  # another run's trimming, or a file that is damaged: make them again
        return None
    return Made(setup, stored, cost, about.get("beyond", ()))


def _first_scans(pipeline: Pipeline, recording: Recording) -> None:
    front_end = pipeline.front_end
    _, state = front_end.open(recording.header.offering(pipeline.given))
    items = recording.scans() if getattr(front_end, "consumes", "samples") == "scans" else recording.blocks()
    for item, _ in zip(items, range(_WARM_BLOCKS), strict=False):
        state, _ready = front_end.step(state, item)


def _output(task: Task, reads: str) -> tuple[Sequence[Any], Space | Setup | None]:
    """What a metric reads of a trial: estimates and their space, or scans and their setup."""
    from sonobench.log import read_estimates, read_scans

    tracker = _pipeline(task).tracker if task["available"] else None
    if task["output"] is None:
        return [], tracker.space if tracker is not None and reads == "estimates" else None
    if reads == "estimates":
        if tracker is None:
            raise SetupError("the metric reads estimates, but this pipeline ends at its scans")
        estimates, space = read_estimates(Path(task["output"]))[:2]
        return estimates, space
    if tracker is None:
        setup, found = read_scans(Path(task["output"]))
        return found, setup
    made = _stored_scans(task) or _make_scans(task, _pipeline(task), _recording(task["recording"]))
    return made.scans, made.setup


def _warm(step: str, pipeline: Mapping[str, Any], first: Callable[[], Any]) -> None:
    """Run a step's beginning once in this process, so that imports and stored machine code are loaded untimed."""
    if (name := f"{step} {canonical_json(pipeline)}") not in _WARMED:
        _WARMED.add(name)
        with suppress(Exception):  # the timed run will raise it again, and be the trial's own fault
            first()


def forget() -> None:
    """Build components anew: in a process that lives on, their modules may be others than before."""
    _loaded.cache_clear()
    _built.cache_clear()


def _registry(task: Task) -> Registry:
    registry = _loaded(tuple(task["plugins"].items()))
    if (found := {str(p.path): p.version for p in registry.plugins if p.path is not None}) != task["plugins"]:
        raise InputError(f"a plugin file changed while the study ran ({task['plugins']} → {found}); run it again")
    return registry


@lru_cache(maxsize=4)
def _loaded(plugins: tuple[tuple[str, str], ...]) -> Registry:
    from sonobench.registry import Registry

    return Registry.load([path for path, _ in plugins])


def _pipeline(task: Task) -> Pipeline:
    return _built(canonical_json(task["pipeline"]), _registry(task))


@lru_cache(maxsize=64)
def _built(table: str, registry: Registry) -> Pipeline:
    from sonobench.components import build

    pipeline: Pipeline = build("pipeline", json.loads(table), registry)
    return pipeline


@lru_cache(maxsize=2)
def _opened(path: str, _mtime_ns: int) -> Recording:
    from sonobench.log import open_recording

    return open_recording(path)


def _recording(path: str) -> Recording:
    return _opened(path, os.stat(path).st_mtime_ns)


def _beyond(task: Task, known: str) -> list[str]:
    """What the components that `known` tells of used beyond their closure."""
    if known not in task:
        return []
    allowed = (task["cache"], task["recording"], task["folder"], *filter(None, [os.environ.get("NUMBA_CACHE_DIR")]))
    return beyond(task[known]["names"], task[known]["sources"], allowed)


def _reset_peak() -> None:
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _peak_mb() -> float:
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM"):
                return int(line.split()[1]) * 1024 / 1e6
    return 0.0
