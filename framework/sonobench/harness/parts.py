"""What a plan's trials are made of: the code behind each part, and a record of it all that `why` compares with later.

parts.jsonl in a run's folder holds each part once: {"sha": …, "kind": "scene" | "pipeline" | "metric" | "code", …}. A row
names its scene's and its pipeline's part; these name the code.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sonobench.components import digest
from sonobench.files import replace_file
from sonobench.harness.cache import Cache
from sonobench.harness.code import Closure, closure, numba_digest
from sonobench.harness.keys import Json, Keys, estimate_keys, recording_keys, scans_keys, score_keys
from sonobench.harness.plan import MetricEntry, PipelineEntry, Plan, Source

Part = dict[str, Any]
_EMPTY_OUTPUT = "empty"
_KEPT = 10_000  # scans keys: the pipelines of one recording ask several times


@dataclass(frozen=True, slots=True)
class Codes:
    """The code behind a plan's parts, by name (scenes by `id` of their Source)."""

    front_ends: Mapping[str, Closure]
    trackers: Mapping[str, Closure]
    scenes: Mapping[int, Closure]
    metrics: Mapping[str, Closure]
    _made: dict[tuple[str, ...], Any] = field(default_factory=dict, repr=False, compare=False)  # what many keys share
    _scans: dict[tuple[Keys, str], str] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, plan: Plan) -> Codes:
        """Read the sources that a plan depends on."""
        built = {e.name: e.pipeline for e in plan.entries if e.pipeline is not None}
        return cls(
            {name: closure(p.front_end, "sonobench.pipeline") for name, p in built.items()},
            {name: closure(p.tracker, "sonobench.pipeline") for name, p in built.items()},
            {id(s): closure(s.scene) for s in plan.sources if s.scene is not None},
            {m.label: closure(m.metric, "sonobench.scoring") for m in plan.metrics},
        )

    def recording_key(self, source: Source, seed: int) -> str:
        """Of a scene's rendering."""
        return self._once("scene", str(id(source)), lambda: recording_keys(source.sha, self.scenes[id(source)].digest))(seed)

    def scans_key(self, entry: PipelineEntry, input_sha: str) -> str:
        """Of an entry's front end on a recording; "" where the entry is unavailable."""
        if entry.pipeline is None:
            return ""
        given = entry.pipeline.given
        keys = self._once("front_end", entry.name, lambda: self._scans_keys(entry, given))
        if (found := self._scans.get((keys, input_sha))) is None:
            if len(self._scans) >= _KEPT:
                self._scans.clear()
            found = self._scans[keys, input_sha] = keys(input_sha)
        return found

    def estimate_key(self, entry: PipelineEntry, input_sha: str, run: int) -> str:
        """Of a trial's output."""
        keys = self._once("tracker", entry.name, lambda: estimate_keys(entry.table.get("tracker"), self.trackers[entry.name].digest))
        return keys(run, self.scans_key(entry, input_sha))

    def score_key(self, metric: MetricEntry, entry: PipelineEntry, row: Mapping[str, Any]) -> str:
        """Of a metric's rows for a trial's row; a failed trial counts as empty output."""
        return self.score_keys(metric)(scored_output(entry, row), row["truth_sha"])

    def score_keys(self, metric: MetricEntry) -> Keys:
        """Of a metric's rows, by output and truth_sha."""
        found: Keys = self._once("metric", metric.label, lambda: score_keys(metric.table, self.metrics[metric.label].digest))
        return found

    def _scans_keys(self, entry: PipelineEntry, given: tuple[str, ...]) -> Keys:
        """The same object for all entries that share a front end."""
        table, code = Json.of(entry.table["front_end"]), self.front_ends[entry.name].digest
        found: Keys = self._once("scans", f"{code} {given} {table}", lambda: scans_keys(table, given, code))
        return found

    def _once(self, kind: str, name: str, make: Callable[[], Any]) -> Any:
        if (kind, name) not in self._made:
            self._made[kind, name] = make()
        return self._made[kind, name]


def scored_output(entry: PipelineEntry, row: Mapping[str, Any]) -> str:
    """What a row's scores are of, in their keys."""
    return row["estimate_key"] if row["status"] == "ok" else f"{_EMPTY_OUTPUT} {digest(entry.table)}"


def covered(found: Closure) -> dict[str, Any]:
    """What a worker needs to tell what a component used beyond its closure."""
    return {"names": found.names, "sources": dict(found.sources)}


def numba_cache(plan: Plan, cache: Cache) -> Path:
    """Where a plan's compiled code is kept: by the digest of all sources that it could come from, for Numba itself looks at one file only."""
    parts = (*(e.pipeline for e in plan.entries), *(s.scene for s in plan.sources), *(m.metric for m in plan.metrics))
    return cache.numba(numba_digest({"sonobench", *closure(*parts).modules}))


def scene_part(source: Source, codes: Codes) -> Part:
    """A scene's table and code, or what a recorded file holds."""
    if source.scene is None:
        return {"kind": "scene", "input_sha": source.sha, "truth_sha": source.truth_sha}
    return {"kind": "scene", "table": source.scene.table, "content": source.sha, "code": codes.scenes[id(source)].digest}


def pipeline_part(entry: PipelineEntry, codes: Codes) -> Part:
    """An entry's full table and code."""
    if entry.pipeline is None:
        return {"kind": "pipeline", "table": entry.table}
    about = {"front_end": codes.front_ends[entry.name].digest, "tracker": codes.trackers[entry.name].digest}
    return {"kind": "pipeline", "table": entry.table, "given": list(entry.pipeline.given), **about}


def sha_of(part: Part) -> str:
    """Name of a part in parts.jsonl and in rows."""
    return digest(part)[:16]


def parts_of(plan: Plan, codes: Codes) -> Iterator[tuple[str, Part]]:
    """Every part of a plan under its name."""
    for source in plan.sources:
        yield sha_of(part := scene_part(source, codes)), part
    for entry in plan.entries:
        yield sha_of(part := pipeline_part(entry, codes)), part
    for group in (codes.scenes, codes.front_ends, codes.trackers, codes.metrics):
        for found in group.values():
            yield found.digest, {"kind": "code", **found.to_table()}


def keep_parts(path: Path, plan: Plan, codes: Codes) -> None:
    """Add a plan's parts to a run's parts.jsonl; what is there already is kept."""
    before = read_parts(path)
    merged = {**before, **dict(parts_of(plan, codes))}
    if len(merged) > len(before):
        lines = (json.dumps({"sha": sha, **part}, sort_keys=True, separators=(",", ":"), default=list) for sha, part in merged.items())
        replace_file(path, "".join(f"{line}\n" for line in lines).encode())


def read_parts(path: Path) -> dict[str, Part]:
    """The parts that a run's folder knows, by name; none where the file is missing or damaged."""
    try:
        lines = [json.loads(line) for line in path.read_text("utf-8").splitlines()]
        return {line.pop("sha"): line for line in lines}
    except (OSError, ValueError, KeyError):
        return {}
