"""A study: scenes and recordings × swept parameters × pipelines × repetitions × metrics, as a table.

plugins = ["floor_phat.py"]                     # paths relative to this file
scenes = ["quickstart-1", "./lab.toml"]           # and/or recordings = ["locata/*.mcap"]
repetitions = 10
seed = 0
metrics = ["ospa", { use = "gospa", c_m = 1.0 }]
[pipelines]
ck-phd = {}                                     # no `use`: use = the entry's own name
mine = { use = "ck-phd", front_end = { delay = { use = "floor-phat" } } }
[sweep]                                         # a leaf is a list of alternatives; the product is run
scene.noise.snr_db = [10, 20]
pipelines.mine.front_end.delay.floor = [0.05, 0.2]

`reference = ["chen2012"]` puts published numbers beside the measured ones on its boards.

The harness is imported within the methods that call it, because it imports this module: a study is what users hold, so `plan` and
`run` stand here.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sonobench.errors import InputError, PluginError, TableError
from sonobench.registry import Registry, did_you_mean
from sonobench.tables import read_toml

if TYPE_CHECKING:
    from sonobench.harness.plan import Plan
    from sonobench.harness.run import Run

_KEYS = ("plugins", "scenes", "recordings", "repetitions", "seed", "metrics", "pipelines", "sweep", "reference")


@dataclass(frozen=True, slots=True)
class Study:
    """A validated study.

    Attributes:
        name: the file's stem; a run's folder is named after it.
        folder: where relative paths start.
        plugins: files, as paths from anywhere.
        scenes: names, `dist:name`, or paths from anywhere.
        recordings: MCAP files, globs resolved.
        repetitions: renderings per scene, or runs per recording.
        seed: renderings are seeded from it, the scene's name and the repetition.
        metrics: tables with `use`.
        pipelines: tables with `use` by entry name, in order.
        sweep: alternatives by dotted path, each beginning with "scene." or "pipelines.".
        references: names, `dist:name`, or paths from anywhere, of published numbers to stand beside.
        registry: where every name was looked up.
    """

    name: str
    folder: Path
    plugins: tuple[Path, ...]
    scenes: tuple[str, ...]
    recordings: tuple[Path, ...]
    repetitions: int
    seed: int
    metrics: tuple[Mapping[str, Any], ...]
    pipelines: Mapping[str, Mapping[str, Any]]
    sweep: Mapping[tuple[str, ...], tuple[Any, ...]]
    references: tuple[str, ...]
    registry: Registry = field(repr=False, compare=False)

    @classmethod
    def load(
        cls,
        name_or_path: str | Path,
        plugins: Sequence[str | Path] = (),
        also: Sequence[str] = (),
        only: Sequence[str] = (),
        repetitions: int | None = None,
        seed: int | None = None,
    ) -> Study:
        """Read, overlay and check a study; everything that it names is built once.

        Args:
            name_or_path: what ends in .toml is a path; else a registered study.
            plugins: further plugin files.
            also: pipelines to add by name.
            only: keep these entries alone (patterns such as "*-phd" too).
            repetitions, seed: in place of the study's own.

        Raises:
            TableError: all faults.
            PluginError: a plugin file that cannot be loaded, or an unknown study.
            InputError: the file cannot be read.
        """
        path = _find(name_or_path, plugins)
        table = read_toml(path)
        changed = {"repetitions": repetitions, "seed": seed}
        return cls.from_table({**table, **{k: v for k, v in changed.items() if v is not None}}, path, plugins, also, only)

    @classmethod
    def from_table(
        cls, table: Mapping[str, Any], path: Path, plugins: Sequence[str | Path] = (), also: Sequence[str] = (), only: Sequence[str] = ()
    ) -> Study:
        """A study from a table that stands, or could stand, in the file `path`.

        Raises:
            TableError: all faults.
            PluginError: a plugin file that cannot be loaded.
        """
        from sonobench.harness.plan import outline
        from sonobench.scene.reference import reference_faults

        reader = _Reader(table, path)
        files = (*reader.paths("plugins"), *(Path(p).resolve() for p in plugins))
        study = cls(
            name=path.stem,
            folder=path.parent,
            plugins=tuple(dict.fromkeys(files)),
            scenes=tuple(str(reader.resolve(s)) if s.endswith(".toml") else s for s in reader.strings("scenes")),
            recordings=tuple(dict.fromkeys(reader.recordings())),
            repetitions=reader.integer("repetitions", 1, least=1),
            seed=reader.integer("seed", 0, least=0),
            metrics=tuple(reader.metrics()),
            pipelines=(pipelines := reader.pipelines(also, only)),
            sweep=reader.sweep(pipelines),
            references=tuple(str(reader.resolve(r)) if r.endswith(".toml") else r for r in reader.strings("reference")),
            registry=Registry.load(files),
        )
        reader.check_content(study)
        faults = [*reader.faults, *outline(study).faults, *reference_faults(study.references, study.registry, path.name)]
        if faults:
            raise TableError(list(dict.fromkeys(faults)))
        return study

    def plan(self) -> Plan:
        """Every trial of this study, with all that it needs, built."""
        from sonobench.harness.plan import plan

        return plan(self)

    def run(self, out: str | Path | None = None, jobs: int | None = None, **options: Any) -> Run:
        """Execute it, or go on where an earlier run stopped; see `sonobench.harness.run.run_study` for the options."""
        from sonobench.harness.run import run_study

        return run_study(self, out=out, jobs=jobs, **options)

    def to_table(self) -> dict[str, Any]:
        """Plain data that says what was run (study.json); `from_table` reads it again, without `name` and `folder`."""
        return {
            "name": self.name,
            "folder": str(self.folder),
            "plugins": [str(p) for p in self.plugins],
            "scenes": list(self.scenes),
            "recordings": [str(p) for p in self.recordings],
            "repetitions": self.repetitions,
            "seed": self.seed,
            "metrics": [dict(m) for m in self.metrics],
            "pipelines": {k: dict(v) for k, v in self.pipelines.items()},
            "sweep": _nested(self.sweep),
            "reference": list(self.references),
        }


class _Reader:
    """Reads a study's table and collects its faults."""

    def __init__(self, table: Mapping[str, Any], path: Path) -> None:
        self.table, self.where, self.folder = table, path.name, path.parent
        self.faults: list[str] = [f"{self.where}: {k}: a study has no such key{did_you_mean(k, _KEYS)}" for k in table if k not in _KEYS]

    def fault(self, key: str, text: str) -> None:
        self.faults.append(f"{self.where}: {key}: {text}")

    def resolve(self, path: str) -> Path:
        return (self.folder / Path(path).expanduser()).resolve()

    def strings(self, key: str) -> list[str]:
        value = self.table.get(key, [])
        if not isinstance(value, (list, tuple)) or not all(isinstance(v, str) for v in value):
            self.fault(key, f"a list of strings is needed, got {value!r}")
            return []
        return list(dict.fromkeys(value))

    def paths(self, key: str) -> list[Path]:
        return [self.resolve(p) for p in self.strings(key)]

    def recordings(self) -> Iterator[Path]:
        for pattern in self.strings("recordings"):
            if not pattern.endswith(".mcap"):
                self.fault("recordings", f"{pattern!r} does not end in .mcap")
                continue
            whole = self.resolve(pattern)
            found = sorted(Path(whole.anchor).glob(str(whole.relative_to(whole.anchor))))
            if not found:
                self.fault("recordings", f"{pattern!r} matches no file below {self.folder}")
            yield from found

    def integer(self, key: str, default: int, least: int) -> int:
        value = self.table.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            self.fault(key, f"an integer of at least {least} is needed, got {value!r}")
            return default
        return value

    def metrics(self) -> Iterator[Mapping[str, Any]]:
        value = self.table.get("metrics", [])
        if not isinstance(value, (list, tuple)):
            self.fault("metrics", f"a list of names and tables is needed, got {value!r}")
            return
        for index, metric in enumerate(value):
            table = {"use": metric} if isinstance(metric, str) else metric
            if isinstance(table, Mapping) and isinstance(table.get("use"), str):
                yield table
            else:
                self.fault(f"metrics[{index}]", f"a name or a table with `use` is needed, got {metric!r}")

    def pipelines(self, also: Iterable[str], only: Sequence[str]) -> dict[str, Mapping[str, Any]]:
        value = self.table.get("pipelines", {})
        if not isinstance(value, Mapping):
            self.fault("pipelines", f"a table is needed, got {value!r}")
            value = {}
        found: dict[str, Mapping[str, Any]] = {}
        for name, own in {**value, **{n: {} for n in also if n not in value}}.items():
            table = {"use": own} if isinstance(own, str) else own
            if isinstance(table, Mapping):
                found[name] = {"use": name, **table}
            else:
                self.fault(f"pipelines.{name}", f"a table is needed, got {table!r}")
        for pattern in only:
            if not fnmatch.filter(found, pattern):
                self.fault("pipelines", f"--only {pattern} matches none of {list(found)}{did_you_mean(pattern, found)}")
        return {n: t for n, t in found.items() if not only or any(fnmatch.fnmatchcase(n, p) for p in only)}

    def sweep(self, kept: Mapping[str, Any]) -> dict[tuple[str, ...], tuple[Any, ...]]:
        value = self.table.get("sweep", {})
        if not isinstance(value, Mapping):
            self.fault("sweep", f"a table is needed, got {value!r}")
            return {}
        found: dict[tuple[str, ...], tuple[Any, ...]] = {}
        for path, alternatives in _leaves(value, ()):
            dotted = "sweep." + ".".join(path)
            if path[0] not in ("scene", "pipelines"):
                self.fault(dotted, f"begins with neither scene nor pipelines{did_you_mean(path[0], ['scene', 'pipelines'])}")
            elif len(path) < (2 if path[0] == "scene" else 3):
                self.fault(dotted, "names no parameter; write scene.PARAMETER or pipelines.ENTRY.PARAMETER")
            elif not isinstance(alternatives, list) or not alternatives:
                self.fault(dotted, f"a list of alternatives is needed, got {alternatives!r}")
            elif path[0] == "pipelines" and path[1] not in self.table.get("pipelines", {}):
                self.fault(dotted, f"no entry is named {path[1]!r}{did_you_mean(path[1], kept) or f'; [pipelines] has {list(kept)}'}")
            elif path[0] == "scene" or path[1] in kept:
                found[path] = tuple(alternatives)
        return found

    def check_content(self, study: Study) -> None:
        """What a study must not lack; said only of keys that have no other fault."""
        faulty = " ".join(self.faults)
        if not study.pipelines and " pipelines" not in faulty:
            self.fault("pipelines", "the study names no pipeline; add [pipelines] with NAME = {}")
        if not study.scenes and not study.recordings and " scenes" not in faulty and " recordings" not in faulty:
            self.fault("scenes", "the study names neither scenes nor recordings; add scenes = [NAME]")
        if not study.metrics and " metrics" not in faulty:
            self.fault("metrics", "the study names no metric; add metrics = [NAME]")
        if not study.scenes and any(p[0] == "scene" for p in study.sweep):
            self.fault("sweep.scene", "sweeps scenes, but the study has only recordings")


def _nested(sweep: Mapping[tuple[str, ...], Sequence[Any]]) -> dict[str, Any]:
    table: dict[str, Any] = {}
    for path, alternatives in sweep.items():
        leaf = table
        for name in path[:-1]:
            leaf = leaf.setdefault(name, {})
        leaf[path[-1]] = list(alternatives)
    return table


def _leaves(table: Mapping[str, Any], path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, (*path, key))
        else:
            yield (*path, key), value


def _find(name_or_path: str | Path, plugins: Sequence[str | Path]) -> Path:
    if str(name_or_path).endswith(".toml"):
        return Path(name_or_path).resolve()
    if Path(name_or_path).exists():
        raise InputError(f"{name_or_path}: a study's file ends in .toml")
    try:
        return Registry.load(plugins).find_data("studies", str(name_or_path), ".toml")
    except PluginError as error:
        if not Path(f"{name_or_path}.toml").is_file():
            raise
        raise PluginError(f"{error}; the file that is here goes by its whole name, {name_or_path}.toml") from None
