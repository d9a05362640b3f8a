"""Published numbers as a table, so that a board can stand beside them; docs/boards.md says what the keys mean.

citation = "Chen, Chen, Yin & Hou 2012, …"
[[tables]]
table = "Table 2"
metric = "ospa"                                          # a metric, and after a dot its column; or "ms/frame", what a board's pipelines cost
settings = { p = 2.0, c_m = 1.5 }                        # of the metric; others may be anything
unit = "m"
at.scene.simulator.delay_std_s = [3.9e-3, 1.25e-3]       # lists side by side: swept values, or "scene" for names of scenes
values = { ek-phd = [1.4349, 1.4346], ck-phd = [1.4351, 1.4345] }
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sonobench.components import build
from sonobench.errors import PluginError, SonobenchError, TableError, UnavailableError
from sonobench.registry import Registry, did_you_mean
from sonobench.tables import read_toml

_KEYS = ("citation", "about", "tables")
_TABLE_KEYS = ("table", "metric", "settings", "unit", "scale", "at", "values", "note")
COST = "ms/frame"  # the boards' column of cost: no metric, since scores do not depend on the machine


@dataclass(frozen=True, slots=True)
class PrintedTable:
    """Numbers of one metric.

    Attributes:
        table: where they are printed, such as "Table 2".
        metric: use and column, such as "cardinality.are"; or COST.
        settings: the metric's parameters that they hold for.
        unit: theirs.
        at: aligned values by swept path ("scene.noise.snr_db"; "scene" is the scene's name); empty: one value a pipeline.
        values: by pipeline, as many as `at` has, in `unit`.
        note: what a reader must know to compare them.
    """

    table: str
    metric: str
    settings: Mapping[str, Any]
    unit: str
    at: Mapping[str, tuple[Any, ...]]
    values: Mapping[str, tuple[float, ...]]
    note: str = ""


@dataclass(frozen=True, slots=True)
class Reference:
    """A publication's numbers: name (the file's stem), citation, tables."""

    name: str
    citation: str
    tables: tuple[PrintedTable, ...]

    @classmethod
    def load(cls, name_or_path: str, registry: Registry) -> Reference:
        """A registered reference, or a file where it ends in .toml.

        Raises:
            TableError: all faults.
            PluginError: an unknown name.
            InputError: the file cannot be read.
        """
        path = Path(name_or_path) if name_or_path.endswith(".toml") else registry.find_data("reference", name_or_path, ".toml")
        return cls.from_table(read_toml(path), path.stem, registry)

    @classmethod
    def from_table(cls, table: Mapping[str, Any], name: str, registry: Registry) -> Reference:
        """Check a table.

        Raises:
            TableError: all faults.
        """
        faults = [f"{name}.toml: {key}: a reference has no such key{did_you_mean(key, _KEYS)}" for key in table if key not in _KEYS]
        faults += [f"{name}.toml: {fault}" for fault in _texts(table, ("citation",))]
        printed = table.get("tables")
        if not isinstance(printed, list) or not printed or not all(isinstance(t, Mapping) for t in printed):
            raise TableError([*faults, f"{name}.toml: tables: at least one [[tables]] is needed, got {printed!r}"])
        for index, one in enumerate(printed):
            faults += [f"{name}.toml: tables[{index}].{fault}" for fault in _faults(one, registry)]
        if faults:
            raise TableError(faults)
        tables = tuple(_printed(one) for one in printed)
        faults = [f"{name}.toml: {fault}" for fault in _contradictions(tables)]
        if faults:
            raise TableError(faults)
        return cls(name, table["citation"], tables)


def reference_faults(names: Iterable[str], registry: Registry, where: str) -> Iterator[str]:
    """What is wrong with the references that a study names."""
    for name in names:
        try:
            Reference.load(name, registry)
        except TableError as error:
            yield from error.faults
        except SonobenchError as error:
            yield f"{where}: reference: {error}"


def _printed(table: Mapping[str, Any]) -> PrintedTable:
    at = {path: tuple(values) for path, values in _leaves(table.get("at", {}))}
    scale = table.get("scale", 1.0)
    values = {p: tuple(scale * float(v) for v in (v if isinstance(v, list) else [v])) for p, v in table["values"].items()}
    return PrintedTable(table["table"], table["metric"], table.get("settings", {}), table["unit"], at, values, table.get("note", ""))


def _faults(table: Mapping[str, Any], registry: Registry) -> Iterator[str]:
    yield from (f"{key}: no such key{did_you_mean(key, _TABLE_KEYS)}" for key in table if key not in _TABLE_KEYS)
    yield from _texts(table, ("table", "metric", "unit"))
    if table.get("metric") == COST:
        if table.get("settings") or table.get("unit") != "ms":
            yield f"metric: {COST} has no settings and the unit ms, got {table.get('settings', {})!r} and {table.get('unit')!r}"
    elif isinstance(table.get("metric"), str):
        yield from _metric_faults(table["metric"].partition(".")[0], table.get("settings", {}), registry)
    scale = table.get("scale", 1.0)
    if not isinstance(scale, (int, float)) or isinstance(scale, bool) or not 0 < scale < math.inf:
        yield f"scale: a number above 0 is needed, got {scale!r}"
    at = table.get("at", {})
    if not isinstance(at, Mapping):
        yield f"at: lists by swept path are needed, got {at!r}"
        at = {}
    leaves = dict(_leaves(at))
    for path, values in leaves.items():
        if not isinstance(values, list) or not values or not all(isinstance(v, (int, float, str)) for v in values):
            yield f"at.{path}: a list of numbers or strings is needed, got {values!r}"
        elif path.split(".")[0] not in ("scene", "pipelines"):
            yield f"at.{path}: begins with neither scene nor pipelines{did_you_mean(path.split('.')[0], ['scene', 'pipelines'])}"
    sizes = {path: len(values) for path, values in leaves.items() if isinstance(values, list)}
    if len(set(sizes.values())) > 1:
        yield f"at: lists side by side are needed, got lengths {sizes}"
    yield from _value_faults(table.get("values"), max(sizes.values()) if sizes else None)


def _metric_faults(use: str, settings: Any, registry: Registry) -> Iterator[str]:
    if not isinstance(settings, Mapping):
        yield f"settings: a table is needed, got {settings!r}"
        return
    try:
        build("metric", {"use": use, **settings}, registry, "settings")
    except UnavailableError:
        return  # right, but not installed here
    except PluginError as error:
        yield f"metric: {error}"
    except TableError as error:
        yield from error.faults


def _value_faults(values: Any, needed: int | None) -> Iterator[str]:
    if not isinstance(values, Mapping) or not values:
        yield f"values: numbers by pipeline are needed, got {values!r}"
        return
    for pipeline, own in values.items():
        numbers = own if isinstance(own, list) else [own]
        if not all(isinstance(v, (int, float)) and not isinstance(v, bool) and math.isfinite(v) for v in numbers):
            yield f"values.{pipeline}: finite numbers are needed, got {own!r}"
        elif isinstance(own, list) != (needed is not None) or (needed is not None and len(numbers) != needed):
            yield f"values.{pipeline}: {'one number' if needed is None else f'a list of {needed} numbers, as `at` has,'} is needed, got {own!r}"


def _texts(table: Mapping[str, Any], names: tuple[str, ...]) -> Iterator[str]:
    yield from (f"{n}: a text is needed, got {table.get(n)!r}" for n in names if not (isinstance(table.get(n), str) and table[n].strip()))


def _contradictions(tables: tuple[PrintedTable, ...]) -> Iterator[str]:
    """Two tables may print the same number, but not two numbers for one thing."""
    seen: dict[tuple[Any, ...], tuple[float, str]] = {}
    for one in tables:
        for pipeline, values in one.values.items():
            for index, value in enumerate(values):
                place = tuple(sorted((path, float(v[index]) if not isinstance(v[index], str) else v[index]) for path, v in one.at.items()))
                key = one.metric, repr(sorted(one.settings.items())), pipeline, place
                other, table = seen.setdefault(key, (value, one.table))
                if other != value:
                    yield f"tables: {one.table} prints {value} for {pipeline} at {dict(place)}, {table} prints {other}"


def _leaves(table: Mapping[str, Any], head: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{head}{key}.")
        else:
            yield f"{head}{key}", value
