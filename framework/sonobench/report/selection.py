"""Which of a run's trials a picture is about: scenes, swept values, pipelines; and the column that a name means."""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from sonobench.errors import InputError
from sonobench.registry import did_you_mean

if TYPE_CHECKING:
    import pandas as pd

    from sonobench.harness.run import Run

_OWN = "p_pipelines."


def chosen(
    trials: pd.DataFrame, scenes: Sequence[str] = (), at: Mapping[str, Sequence[Any]] | None = None, pipelines: Sequence[str] = ()
) -> pd.DataFrame:
    """The trials of these scenes and pipelines, at these swept values.

    Args:
        trials: rows of trials.parquet.
        scenes, pipelines: names, or patterns such as "*-phd"; () is all.
        at: values by swept column (any unique ending). Entries that a pipeline's sweep does not touch stay.

    Raises:
        InputError: a name, column or value that the run does not have, and what it has.
    """
    for word, column, patterns in (("scene", "scene", scenes), ("pipeline", "pipeline", pipelines)):
        if patterns:
            trials = trials[trials[column].isin(_matching(word, patterns, sorted(set(trials[column]))))]
    for name, values in (at or {}).items():
        column = swept_column(trials, name)
        kept = trials[column].map(lambda v, values=values: any(same(v, w) for w in values)).astype(bool)
        for value in values:
            there = sorted_values(trials[column])
            if not any(same(value, v) for v in there):
                raise InputError(f"{column} is nowhere {value}; there is {there}")
        trials = trials[kept | (trials[column].isna() if column.startswith(_OWN) else False)]
    return trials


def metrics_of(run: Run, asked: Sequence[str]) -> list[str]:
    """Names of metrics: as asked for, patterns ("ospa*p=2.0]") as all that they match; by default the run's first.

    Raises:
        InputError: a pattern that matches nothing, or a run without metrics.
    """
    if not (asked or run.metrics):
        raise InputError(f"{run.path}: the run has no metric")
    there = sorted(set(run.scores["metric"]))
    found: list[str] = []
    for name in asked or run.metrics[:1]:
        mine = [m for m in there if fnmatch.fnmatchcase(m, name.replace("[", "[[]"))] if "*" in name and name not in there else [name]
        if not mine:
            raise InputError(f"no metric of the run matches {name!r}; it has {there}")
        found += mine
    return list(dict.fromkeys(found))


def swept_column(trials: pd.DataFrame, name: str) -> str:
    """The swept column that a name means: the column itself, or any unique ending of it ("p_d", "noise.snr_db").

    Raises:
        InputError: none, or more than one.
    """
    columns = [c for c in trials.columns if c.startswith("p_") and trials[c].notna().any()]
    if not columns:
        raise InputError(f"{name}: this run sweeps nothing; a study's [sweep] names what it varies (of any run: --over time)")
    for wanted in (name, name.removeprefix("p_")):
        found = [c for c in columns if c in (wanted, f"p_{wanted}")] or [c for c in columns if c.endswith(f".{wanted}")]
        if len(found) == 1:
            return found[0]
        if found:
            raise InputError(f"{name}: {found} all end so; write more of the one that is meant")
    endings = {c.rpartition(".")[2]: c for c in columns}
    raise InputError(f"{name}: the run has no such swept column; it has {columns}{did_you_mean(name, [*columns, *endings])}")


def scene_columns(trials: pd.DataFrame) -> list[str]:
    """Columns of what is swept in scenes."""
    return sorted(c for c in trials.columns if c.startswith("p_") and not c.startswith(_OWN) and trials[c].notna().any())


def sorted_values(column: pd.Series) -> list[Any]:
    """Distinct values without missing ones, numbers before strings."""
    from sonobench.board.select import sorted_values as found

    return found(column)


def same(one: Any, other: Any) -> bool:
    """Whether a value of a table is the one that was asked for: numbers to 1e-9, else as text."""
    if isinstance(one, str) or isinstance(other, str):
        try:
            return str(one) == str(other) or math.isclose(float(one), float(other), rel_tol=1e-9)
        except ValueError:
            return False
    return bool(math.isclose(one, other, rel_tol=1e-9))


def _matching(word: str, patterns: Sequence[str], there: Sequence[str]) -> list[str]:
    found = []
    for pattern in patterns:
        mine = [n for n in there if n == pattern or fnmatch.fnmatchcase(n, pattern)]
        if not mine:
            raise InputError(f"there is no {word} {pattern!r}, but {list(there)}{did_you_mean(pattern, there)}")
        found += mine
    return found
