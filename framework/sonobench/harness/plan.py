"""From a study to its trials: sweeps multiplied out, every component built, every fault collected."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sonobench.components import build, canonical_json, digest, overlay, to_table
from sonobench.errors import InputError, PluginError, SonobenchError, TableError, UnavailableError
from sonobench.harness.environment import is_dirty
from sonobench.harness.keys import seed_of, trial_keys

if TYPE_CHECKING:
    from sonobench.pipeline import Pipeline
    from sonobench.registry import Registry
    from sonobench.scene.study import Study

Path_ = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class PipelineEntry:
    """One line of a board.

    Attributes:
        name: such as "mine[floor=0.05]".
        table: full table, defaults included; as the user wrote it where the pipeline is unavailable.
        swept: value by column (`p_*`).
        distribution, version: who ships the pipeline that `use` names.
        pipeline: built, or None.
        reason: why it is unavailable, "" when it is not.
        dirty: the distribution's name and version do not fix its code (a plugin file, or a checkout with changes).
    """

    name: str
    table: Mapping[str, Any]
    swept: Mapping[str, Any]
    distribution: str
    version: str
    pipeline: Pipeline | None
    reason: str = ""
    dirty: bool = False


@dataclass(frozen=True, slots=True)
class Source:
    """What recordings come from: a scene to render, or a file.

    Attributes:
        name: the board's `scene` column.
        swept: value by column (`p_*`).
        scene: a Scene, or None for a file.
        sha: digest of the scene's table and data files, or a file's input_sha.
        home: the scene's name or path, or the file's path.
        overrides: laid over the scene's table.
        truth_sha: of a file; "" for a scene.
    """

    name: str
    swept: Mapping[str, Any]
    scene: Any
    sha: str
    home: str
    overrides: Mapping[str, Any] = field(default_factory=dict)
    truth_sha: str = ""


@dataclass(frozen=True, slots=True)
class MetricEntry:
    """A metric of the study: label (its columns' head), full table, built object."""

    label: str
    table: Mapping[str, Any]
    metric: Any

    @property
    def sha(self) -> str:
        """Identity of its table."""
        return digest(self.table)


@dataclass(frozen=True, slots=True)
class PlannedTrial:
    """One pipeline on one recording with one run number.

    Attributes:
        trial_key: known before anything ran.
        study: the study's name.
        source, entry: what it puts together.
        repetition: which rendering of a scene, or which run on a file.
        run: the tracker's run number.
        seed: the rendering's, None for a file.
    """

    trial_key: str
    study: str
    source: Source
    entry: PipelineEntry
    repetition: int
    run: int
    seed: int | None

    @property
    def pipeline(self) -> str:
        """The entry's name."""
        return self.entry.name

    @property
    def scene(self) -> str:
        """The source's name."""
        return self.source.name


@dataclass(frozen=True, slots=True)
class Plan:
    """What a study comes to; `faults` is empty in a plan that may be run."""

    entries: tuple[PipelineEntry, ...]
    sources: tuple[Source, ...]
    metrics: tuple[MetricEntry, ...]
    trials: tuple[PlannedTrial, ...]
    columns: tuple[str, ...]
    faults: tuple[str, ...] = field(default=())

    def only(self, keys: Sequence[str]) -> Plan:
        """The trials whose keys begin so, one each, with what they need; all where no key is named.

        Raises:
            InputError: a head that no trial, or more than one, has.
        """
        if not keys:
            return self
        whole = set(keys)
        heads = tuple(whole.difference(t.trial_key for t in self.trials))
        kept = [t for t in self.trials if t.trial_key in whole or (heads and t.trial_key.startswith(heads))]
        for key in heads:
            if (count := sum(t.trial_key.startswith(key) for t in kept)) != 1:
                raise InputError(
                    f"--trial {key}: {count} of the {len(self)} planned trials have a key that begins so; `--dry-run` lists them"
                )
        needed = {id(part) for t in kept for part in (t.entry, t.source)}
        entries = tuple(e for e in self.entries if id(e) in needed)
        sources = tuple(s for s in self.sources if id(s) in needed)
        return replace(self, entries=entries, sources=sources, trials=tuple(kept))

    def shard(self, index: int, count: int) -> Plan:
        """The index-th (from 1) of `count` parts, recording by recording in turn: all trials on a recording are in one part.

        Raises:
            InputError: there is no such part, or nothing in it.
        """
        if not 1 <= index <= count:
            raise InputError(f"shard {index}/{count}: a number from 1 to {count} is needed before the stroke")
        numbers: dict[tuple[int, int | None], int] = {}
        kept = [t for t in self.trials if numbers.setdefault((id(t.source), t.seed), len(numbers)) % count == index - 1]
        if not kept:
            raise InputError(f"shard {index}/{count}: nothing is in it; the plan has {len(numbers)} recordings")
        used = {id(t.source) for t in kept}
        return replace(self, sources=tuple(s for s in self.sources if id(s) in used), trials=tuple(kept))

    @property
    def swept(self) -> dict[str, list[Any]]:
        """The values of each swept column; None among them where a trial has none."""
        found: dict[str, list[Any]] = {}
        for name in self.columns:
            parts: Sequence[Source] | Sequence[PipelineEntry] = self.entries if name.startswith("p_pipelines.") else self.sources
            found[name] = list(dict.fromkeys(part.swept.get(name) for part in parts))
        return found

    def __len__(self) -> int:
        return len(self.trials)

    def __iter__(self) -> Iterator[PlannedTrial]:
        return iter(self.trials)


def plan(study: Study) -> Plan:
    """Every trial, in the order source, repetition, entry."""
    whole = outline(study)
    named = [(entry, trial_keys({"name": entry.name, **entry.table})) for entry in whole.entries]
    trials = [
        PlannedTrial(keys(run, seed, source.sha), study.name, source, entry, repetition, run, seed)
        for source in whole.sources
        for repetition, run, seed in _repetitions(study, source)
        for entry, keys in named
    ]
    return replace(whole, trials=tuple(trials))


def outline(study: Study) -> Plan:
    """A plan without its trials: what they are made of, and the faults."""
    where = f"{study.name}.toml:"
    faults: list[str] = []
    entries = tuple(_entries(study, where, faults))
    sources = (*_scenes(study, where, faults), *_files(study, where, faults))
    faults += [f"{where} {fault}" for fault in _twins(sources)]
    metrics = tuple(_metrics(study, where, faults))
    columns = tuple(f"p_{'.'.join(path)}" for path in study.sweep)
    return Plan(entries, sources, metrics, (), columns, tuple(dict.fromkeys(faults)))


def _repetitions(study: Study, source: Source) -> Iterator[tuple[int, int, int | None]]:
    for repetition in range(study.repetitions):
        if source.scene is not None:
            yield repetition, 0, seed_of(study.seed, source.name, repetition)
        else:
            yield repetition, repetition, None


def _entries(study: Study, where: str, faults: list[str]) -> Iterator[PipelineEntry]:
    seen: set[str] = set()
    for name, table in study.pipelines.items():
        paths = {p: v for p, v in study.sweep.items() if p[:2] == ("pipelines", name)}
        for swept in _products(paths):
            changed = table
            for path, value in swept.items():
                changed = overlay(changed, _nested(path[2:], value))
            full_name = name + _suffix(swept)
            if full_name in seen:
                faults.append(f"{where} pipelines.{name}: two swept values give the same entry {full_name}")
            seen.add(full_name)
            entry = _entry(full_name, name, changed, _columns(swept), study.registry, where, faults)
            if entry is not None:
                yield entry


def _entry(
    full_name: str, name: str, table: Mapping[str, Any], swept: Mapping[str, Any], registry: Registry, where: str, faults: list[str]
) -> PipelineEntry | None:
    try:
        plugin = registry.entry("pipeline", str(table["use"])).plugin
    except PluginError as error:
        faults.append(f"{where} pipelines.{name}: {error}")
        return None
    try:
        built = build("pipeline", table, registry, f"{where} pipelines.{name}")
        full = to_table(built, registry, "pipeline")
    except UnavailableError as error:
        return PipelineEntry(full_name, dict(table), swept, plugin.distribution, plugin.version, None, str(error), is_dirty(plugin))
    except TableError as error:
        faults += error.faults
        return None
    return PipelineEntry(full_name, full, swept, plugin.distribution, plugin.version, built, dirty=is_dirty(plugin))


def _scenes(study: Study, where: str, faults: list[str]) -> Iterator[Source]:
    from sonobench.scene.scene import Scene

    homes: dict[str, str] = {}
    for home in study.scenes:
        for swept in _products({p: v for p, v in study.sweep.items() if p[0] == "scene"}):
            overrides: dict[str, Any] = {}
            for path, value in swept.items():
                overrides = overlay(overrides, _nested(path[1:], value))
            try:
                scene = Scene.load(home, study.registry, overrides)
            except TableError as error:
                faults += error.faults
                continue
            except SonobenchError as error:
                faults.append(f"{where} scenes: {error}")
                continue
            if homes.setdefault(scene.name, home) != home:
                faults.append(f"{where} scenes: {home} and {homes[scene.name]} are both named {scene.name!r}")
            yield Source(scene.name, _columns(swept), scene, scene.digest(), home, overrides)


def _files(study: Study, where: str, faults: list[str]) -> Iterator[Source]:
    from sonobench.log import open_recording

    names: dict[str, Path] = {}
    for path in study.recordings:
        if names.setdefault(path.stem, path) != path:
            faults.append(f"{where} recordings: {path} and {names[path.stem]} are both named {path.stem!r}")
        try:
            recording = open_recording(path)
            yield Source(path.stem, {}, None, recording.input_sha, str(path), truth_sha=recording.truth_sha)
        except SonobenchError as error:
            faults.append(f"{where} recordings: {error}")


def _twins(sources: Sequence[Source]) -> Iterator[str]:
    """Sources that would be the same trials: a board that counted them twice would claim more than was measured."""
    first: dict[str, Source] = {}
    for source in sources:
        other = first.setdefault(source.sha, source)
        if other is source:
            continue
        if source.scene is None:
            yield f"recordings: {source.home} and {other.home} hold the same input; name one of them"
        elif source.home == other.home:
            yield f"sweep: two swept values give the same scene {source.name}"
        else:
            yield f"scenes: {source.home} and {other.home} are the same scene; name one of them"
    scenes = {s.name for s in sources if s.scene is not None}
    yield from (f"recordings: {s.home} has the name of a scene of the study" for s in sources if s.scene is None and s.name in scenes)


def _metrics(study: Study, where: str, faults: list[str]) -> Iterator[MetricEntry]:
    built: list[tuple[str, Mapping[str, Any], Mapping[str, Any], Any]] = []
    for index, table in enumerate(study.metrics):
        try:
            metric = build("metric", table, study.registry, f"{where} metrics[{index}]")
            built.append((str(table["use"]), table, to_table(metric, study.registry, "metric"), metric))
        except TableError as error:
            faults += error.faults
        except PluginError as error:
            faults.append(f"{where} metrics[{index}]: {error}")
    uses = [use for use, *_ in built]
    for use, own, full, metric in built:
        settings = ",".join(f"{k}={_shown(v)}" for k, v in sorted(own.items()) if k != "use")
        label = use if uses.count(use) == 1 or not settings else f"{use}[{settings}]"
        yield MetricEntry(label, full, metric)
    if len({canonical_json(full) for _, _, full, _ in built}) < len(built):
        faults.append(f"{where} metrics: the same metric stands there twice")


def _products(alternatives: Mapping[Path_, Sequence[Any]]) -> Iterator[dict[Path_, Any]]:
    for values in itertools.product(*alternatives.values()):
        yield dict(zip(alternatives, values, strict=True))


def _nested(path: Path_, value: Any) -> dict[str, Any]:
    for name in reversed(path):
        value = {name: value}
    return dict(value)


def _columns(swept: Mapping[Path_, Any]) -> dict[str, Any]:
    return {f"p_{'.'.join(path)}": value if isinstance(value, (int, float, str)) else _shown(value) for path, value in swept.items()}


def _suffix(swept: Mapping[Path_, Any]) -> str:
    """ "[floor=0.05]": each path by as few of its last names as tell it from the others."""
    if not swept:
        return ""
    parts = []
    for path, value in swept.items():
        tail = next(n for n in range(1, len(path) + 1) if sum(p[-n:] == path[-n:] for p in swept) == 1)
        parts.append(f"{'.'.join(path[-tail:])}={_shown(value)}")
    return f"[{','.join(parts)}]"


def _shown(value: Any) -> str:
    if isinstance(value, Mapping) and isinstance(value.get("use"), str):
        rest = ",".join(f"{k}={_shown(v)}" for k, v in value.items() if k != "use")
        return f"{value['use']}({rest})" if rest else value["use"]
    return value if isinstance(value, str) else canonical_json(value)
