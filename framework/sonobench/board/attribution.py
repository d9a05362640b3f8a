"""What swapping one component is worth: over pairs of entries whose tables differ in that component alone.

Each pair gives one paired difference a scenario; the effect of a swap is the mean of its pairs' differences, so that the
scenario stays the unit however many pairs there are. Swaps are compared with Holm's correction.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from sonobench.board import notes, select, statistics
from sonobench.board.bootstrap import bootstrap, combined
from sonobench.board.measured import Measured, measured
from sonobench.board.table import about, grouped
from sonobench.components import canonical_json
from sonobench.errors import InputError
from sonobench.protocols import ROLES
from sonobench.registry import did_you_mean

_COLUMNS = ("swap_from", "swap_to", "pairs", "effect", "low", "high", "interval", "p", "better")


class Pair(NamedTuple):
    """Two entries that differ in one component: their names, and what stands there as canonical JSON."""

    first: str
    second: str
    before: str
    after: str


def attribution(
    trials: pd.DataFrame,
    scores: pd.DataFrame,
    metric: str,
    role: str,
    entries: Mapping[str, Any],
    by: str | None = None,
    vs: str | None = None,
) -> pd.DataFrame:
    """The effect of swapping a component.

    Args:
        trials, scores: the run's tables.
        metric: which one.
        role: of the component, such as "delay" or "tracker".
        entries: {name: {"table": full table, "roles": {path: role}}} of every entry, as study.json has them.
        by: one table for each value of this column.
        vs: only swaps of this pipeline's component for another.

    Returns:
        One row a swap: swap_from, swap_to, pairs (how many), effect (mean of to − from), low, high (95 %), interval (its
        method), p (sign flips, Holm over the swaps), better (the component, where p < .05; else ""). attrs as a
        leaderboard's, with role and swaps (the pairs of entries).

    Raises:
        InputError: no such role, metric, column or pipeline; no two entries differ in that component alone.
    """
    if vs is not None:
        select.known_pipeline(trials, vs)
    if role not in ROLES:
        raise InputError(f"--attribute {role}: no such role{did_you_mean(role, ROLES) or f'; there are {sorted(ROLES)}'}")
    rows = select.of_metric(scores, metric)
    there = {name: entries[name] for name in sorted(set(trials["pipeline"].unique()) & set(entries))}
    if not there:
        raise InputError("--attribute: the run does not say what its entries are made of; run it again (finished trials are kept)")
    pairs = list(pairs_of(there, role))
    if vs is not None:
        pairs = [pair if pair.first == vs else Pair(pair.second, pair.first, pair.after, pair.before) for pair in pairs if vs in pair[:2]]
    if not pairs:
        raise InputError(_no_pair(there, role, vs))
    return grouped(trials, by, lambda part: _table(part, metric, rows, role, pairs))


def pairs_of(entries: Mapping[str, Any], role: str) -> Iterator[Pair]:
    """All pairs of entries whose tables are equal but for one component of the role; before < after.

    Components of the same `use` differ in parameters of their own: where what they hold differs, that is swapped, not they.
    """
    alike: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for name, entry in entries.items():
        for path in (p for p, own in entry["roles"].items() if own == role):
            rest, component = _without(entry["table"], path)
            alike.setdefault((path, canonical_json(rest)), []).append((canonical_json(component), name))
    for group in alike.values():
        for (before, first), (after, second) in itertools.combinations(sorted(group), 2):
            if before != after and _is_swap(entries[first], entries[second], path):
                yield Pair(first, second, before, after)


def _is_swap(first: Mapping[str, Any], second: Mapping[str, Any], path: str) -> bool:
    """Whether the components at the path are of another `use`, or hold the same components."""
    held = [{p: _at(entry["table"], p) for p in entry["roles"] if p.startswith(f"{path}.")} for entry in (first, second)]
    return bool(_at(first["table"], path)["use"] != _at(second["table"], path)["use"] or held[0] == held[1])


def _at(table: Mapping[str, Any], path: str) -> Any:
    place: Any = table
    for step in path.split("."):
        place = place[int(step) if step.isdecimal() else step]
    return place


def _without(table: Mapping[str, Any], path: str) -> tuple[dict[str, Any], Any]:
    """The table with a hole at the path, and what stood there."""
    rest = deepcopy(dict(table))
    *way, last = [int(step) if step.isdecimal() else step for step in path.split(".")]
    place: Any = rest
    for step in way:
        place = place[step]
    component, place[last] = place[last], None
    return rest, component


def _table(trials: pd.DataFrame, metric: str, scores: pd.DataFrame, role: str, pairs: Sequence[Pair]) -> pd.DataFrame:
    involved = {name for pair in pairs for name in (pair.first, pair.second)}
    found = measured(trials, metric, scores, involved)
    labels = _labels({text for pair in pairs for text in (pair.before, pair.after)})
    swaps: dict[tuple[str, str], list[Pair]] = {}
    for pair in pairs:
        if pair.first in found.names and pair.second in found.names:
            swaps.setdefault((labels[pair.before], labels[pair.after]), []).append(pair)
    contrasts = _contrasts(found, list(swaps.values()))
    draws = bootstrap(found.units, contrasts)
    differences = combined(found.units.values, contrasts)
    enough = draws.n >= statistics.MIN_UNITS
    p = statistics.holm(statistics.sign_flip(differences)) if enough else np.full(len(swaps), np.nan)
    rows = []
    for m, ((before, after), span) in enumerate(zip(swaps, statistics.intervals(draws), strict=True)):
        effect = float(draws.value[m])
        better = "" if not p[m] < 1 - statistics.LEVEL else before if found.sign * effect > 0 else after
        rows.append((before, after, len(swaps[before, after]), effect, *span, float(p[m]), better))
    table = pd.DataFrame(rows, columns=list(_COLUMNS)).astype(dict.fromkeys(("effect", "low", "high", "p"), float))
    table.attrs.update(about(trials, found))
    table.attrs |= {"role": role, "swaps": [[[pair.first, pair.second] for pair in own] for own in swaps.values()]}
    table.attrs["notes"] = _notes(table, found, differences, involved - set(found.names))
    return table


def _contrasts(found: Measured, swaps: Sequence[Sequence[Pair]]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(K, swaps) weights that average each swap's pairs."""
    weights = np.zeros((len(found.names), len(swaps)))
    for m, pairs in enumerate(swaps):
        for pair in pairs:
            weights[found.names.index(pair.second), m] += 1 / len(pairs)
            weights[found.names.index(pair.first), m] -= 1 / len(pairs)
    return weights


def _notes(table: pd.DataFrame, found: Measured, differences: np.ndarray[Any, np.dtype[np.floating[Any]]], lost: set[str]) -> list[str]:
    attrs = {str(k): v for k, v in table.attrs.items()}
    told = [notes.interval(set(table["interval"]) - {""}, attrs)] if len(table) else []
    told.append(
        "effect: mean over pairs of entries that differ in this component alone, second minus first; p by sign flips, Holm over the swaps."
    )
    told += notes.too_few(attrs["units"], attrs["over"], len(table)) if len(table) else []
    told += notes.scenarios(attrs, found, differences)
    told += notes.skew([(a, b) for a, b in zip(table["swap_from"], table["swap_to"], strict=True)], differences)
    if lost:
        told.append(f"left out, since they cannot be ranked: {statistics.joined(sorted(lost))}.")
    return told


def _labels(components: set[str]) -> dict[str, str]:
    """Short names: `use`, and in brackets what tells components of the same `use` apart."""
    import json

    tables = {text: dict(_flat(json.loads(text))) for text in components}
    labels = {}
    for text, table in tables.items():
        twins = [other for other in tables.values() if other.get("use") == table.get("use")]
        keys = sorted(k for k in {k for t in twins for k in t} if len({canonical_json(t.get(k)) for t in twins}) > 1)
        inner = ",".join(f"{k}={_shown(table.get(k))}" for k in keys)
        labels[text] = f"{table.get('use')}[{inner}]" if inner else str(table.get("use"))
    return labels


def _flat(table: Mapping[str, Any], head: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{head}{key}.")
        else:
            yield f"{head}{key}", value


def _shown(value: Any) -> str:
    return value if isinstance(value, str) else canonical_json(value)


def _no_pair(entries: Mapping[str, Any], role: str, vs: str | None) -> str:
    used = {name: [p for p, own in entry["roles"].items() if own == role] for name, entry in entries.items()}
    having = [name for name, paths in used.items() if paths]
    if not having:
        return f"--attribute {role}: no entry has a component of this role"
    which = "no two entries differ" if vs is None else f"no entry differs from {vs}"
    return f"--attribute {role}: {which} in {'their' if vs is None else 'its'} {role} alone ({statistics.joined(having)} have one); add one that does"
