"""Published numbers beside the measured ones.

A number is shown only where it is about the same thing: the same metric with the settings that the reference states, the
same unit, and the same swept values as the board (their mean, where the board is over several of them and all are printed).
What publications say of time stands beside the board's own milliseconds a frame.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from sonobench.scene.reference import COST, PrintedTable, Reference

PREFIX = "ref."
COST_PREFIX = "ref_ms_per_frame."
Shown = Mapping[str, tuple[float, PrintedTable]]  # by pipeline: the number, and where it stands


def beside(
    board: pd.DataFrame, references: Sequence[Reference], metrics: Mapping[str, Mapping[str, Any]], lost: Mapping[str, str] | None = None
) -> pd.DataFrame:
    """A board with columns `ref.NAME` after the mean and `ref_ms_per_frame.NAME` after its cost, as references have tables, and notes.

    Args:
        board: of `leaderboard`; stays as it is.
        references: in the order of the columns.
        metrics: full table of each metric by its label.
        lost: why further references cannot be read, by name.
    """
    attrs: dict[str, Any] = {str(k): v for k, v in board.attrs.items()}
    unread = [f"{name} cannot be read here: {why}." for name, why in (lost or {}).items()]
    groups, parts = [], []
    for group in attrs.get("groups", [attrs]):
        mine = in_group(board, attrs["by"], group["value"]) if "groups" in attrs else board
        columns, told = _columns(mine, group, references, metrics)
        parts.append(columns)
        groups.append({**told, "notes": told["notes"] + unread})
    attrs = {**attrs, "groups": groups} if "groups" in attrs else groups[0]
    columns = pd.concat(parts)
    costs = [c for c in columns.columns if c.startswith(COST_PREFIX)]
    after_mean, after_cost = (int(board.columns.get_loc(c)) + 1 for c in ("mean", "ms_per_frame"))  # type: ignore[arg-type]
    between = board.iloc[:, after_mean:after_cost]
    result = pd.concat(
        [board.iloc[:, :after_mean], columns.drop(columns=costs), between, columns[costs], board.iloc[:, after_cost:]], axis=1
    )
    result.attrs.clear()
    result.attrs.update(attrs)
    return result


def in_group(board: pd.DataFrame, column: str, value: Any) -> pd.DataFrame:
    """The rows of one of a board's groups."""
    return board[board[column].isna() if value is None else board[column] == value]


def _columns(
    board: pd.DataFrame, attrs: Mapping[str, Any], references: Sequence[Reference], metrics: Mapping[str, Mapping[str, Any]]
) -> tuple[pd.DataFrame, dict[str, Any]]:
    places = {c.removeprefix("p_"): v for c, v in attrs["settings"].items()} | {"scene": attrs["scene_names"]}
    found, notes, there = {}, list(attrs["notes"]), list(map(str, board["pipeline"]))
    for reference in references:
        costs = [t for t in reference.tables if t.metric == COST]
        if len(costs) < len(reference.tables):
            tables, why = _about(reference, attrs, metrics)
            shown = _shown(tables, places)
            found[PREFIX + reference.name] = _along(there, shown)
            notes.append(_note(reference, shown, there, why or _uncovered(tables, places)))
        if costs:
            shown = _shown(costs, places)
            found[COST_PREFIX + reference.name] = _along(there, shown)
            notes.append(_note(reference, shown, there, _uncovered(costs, places), COST))
    names = [r.name for r in references]
    return pd.DataFrame(found, index=board.index, dtype=float), {**attrs, "references": names, "notes": notes}


def _along(pipelines: Sequence[str], shown: Shown) -> list[float]:
    return [shown[p][0] if p in shown else math.nan for p in pipelines]


def _about(reference: Reference, attrs: Mapping[str, Any], metrics: Mapping[str, Mapping[str, Any]]) -> tuple[list[PrintedTable], str]:
    """The tables about a board's metric, or why there are none."""
    label = next((m for m in metrics if attrs["metric"] == m or attrs["metric"].startswith(f"{m}.")), None)
    if label is None:
        return [], "the run does not say how its metric is set; run it again"
    own = metrics[label]
    name = str(own["use"]).rpartition(":")[2] + attrs["metric"].removeprefix(label)
    about = [t for t in reference.tables if t.metric == name]
    if not about:
        return [], f"it prints {', '.join(sorted({t.metric for t in reference.tables} - {COST}))}, not {name}"
    differing = [(key, v) for t in about for key, v in t.settings.items() if not _same_setting(own.get(key), v)]
    about = [t for t in about if all(_same_setting(own.get(key), v) for key, v in t.settings.items())]
    if not about:
        said = ", ".join(f"{key} = {v} (here {own.get(key)})" for key, v in dict(differing).items())
        return [], f"its {name} has {said}"
    fitting = [t for t in about if t.unit == attrs["unit"]]
    return fitting, "" if fitting else f"its unit is {about[0].unit}, not {attrs['unit']}"


def _shown(tables: Sequence[PrintedTable], places: Mapping[str, Sequence[Any]]) -> Shown:
    values = {name: _value(tables, name, places) for one in tables for name in one.values}
    return {name: value for name, value in values.items() if value is not None}


def _value(tables: Sequence[PrintedTable], pipeline: str, places: Mapping[str, Sequence[Any]]) -> tuple[float, PrintedTable] | None:
    """Mean of the printed values at all settings of the board and where they stand; None where one is not printed."""
    for table in (t for t in tables if pipeline in t.values):
        if not table.at:
            return table.values[pipeline][0], table
        if any(not places.get(path) for path in table.at):
            continue
        rows = list(zip(*table.at.values(), strict=True))
        wanted = itertools.product(*(places[path] for path in table.at))
        at = [next((k for k, row in enumerate(rows) if all(map(_same, row, want))), None) for want in wanted]
        if None not in at:
            return math.fsum(table.values[pipeline][k] for k in at if k is not None) / len(at), table
    return None


def _same(printed: Any, measured: Any) -> bool:
    if isinstance(printed, str) or isinstance(measured, str):
        return str(printed) == str(measured)
    return math.isclose(printed, measured, rel_tol=1e-9)


def _same_setting(own: Any, stated: Any) -> bool:
    if isinstance(own, list) and isinstance(stated, list):
        return sorted(map(str, own)) == sorted(map(str, stated))
    return bool(own == stated)


def _uncovered(tables: Sequence[PrintedTable], places: Mapping[str, Sequence[Any]]) -> str:
    lacking = sorted({path for t in tables for path in t.at if not places.get(path)})
    if lacking:
        return f"it prints over {', '.join(lacking)}, which the study does not sweep"
    paths = sorted({path for t in tables for path in t.at})
    return f"it does not print all of this board's values of {', '.join(paths)} (--by splits them)"


def _note(reference: Reference, shown: Shown, there: Sequence[str], why: str, what: str = "") -> str:
    if not shown:
        return f"{reference.name} prints {f'no {what}' if what else 'nothing'} to stand here: {why}."
    used = list(dict.fromkeys(table.table for _, table in shown.values()))
    remarks = "".join(f" {note}." for note in dict.fromkeys(table.note for _, table in shown.values() if table.note))
    elsewhere = ", ".join(f"{name} {value:g}" for name, (value, _) in sorted(shown.items()) if name not in there)
    more = f" It also prints {elsewhere}." if elsewhere else ""
    where = f"{what} printed in {', '.join(used)} of {reference.citation.rstrip('.')}".lstrip()
    return f"{reference.name}: {where}; neither measured nor ranked here.{remarks}{more}"
