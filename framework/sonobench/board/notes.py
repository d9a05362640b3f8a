"""The sentences under a board: what its numbers are over, and what to beware of."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sonobench.board import statistics
from sonobench.board.bootstrap import combined
from sonobench.board.measured import Measured
from sonobench.board.pooling import means, units
from sonobench.types import Floats

#: a standard error that is so many times larger over scenes than over scenarios is worth a sentence
_ALIKE = 1.25


def of(records: Sequence[Mapping[str, Any]], attrs: dict[str, Any], found: Measured) -> list[str]:
    """All notes that apply to a board of these rows with its attrs, in reading order."""
    notes = [interval({r["interval"] for r in records} - {""}, attrs), *_separation(attrs, found)]
    notes += scenarios(attrs, found, _neighbours(list(attrs["entrants"]), found))
    notes += [*_failures(records, found), *_missing(records, found)]
    given = [f"{r['pipeline']}: {r['given']}" for r in records if r["given"]]
    if given:
        notes.append(f"° uses what the scene gives out: {'; '.join(given)}.")
    if attrs["vs"] is not None:
        notes += _against(attrs, found)
    return notes


def interval(methods: set[str], attrs: dict[str, Any]) -> str:
    """What the intervals are, and over what."""
    n, over = attrs["units"], attrs["over"]
    one = over[:-1]
    several = attrs["repetitions"] > 1 and over == "scenarios"
    pooled = f" ({attrs['repetitions']} repetitions of a scenario pooled first)" if several else ""
    if n < 2:
        return f"no interval: only {n} {one}." if n else "no complete block to rank; means and intervals are of what each pipeline covers."
    if methods == {"bootstrap-t"}:
        return f"95% CI: bootstrap-t over {n} {over}{pooled}."
    mixed = "bootstrap-t, and " if "bootstrap-t" in methods else ""
    why = f"fewer than {statistics.MIN_UNITS} {over}" if n < statistics.MIN_UNITS else "too little spread to resample"
    return f"95% CI: {mixed}Student's t over {n} {over}{pooled}; {why}, so it rests on normality."


def too_few(n: int, over: str, comparisons: int) -> list[str]:
    """How many units are needed, where there are not enough."""
    needed = statistics.units_needed(comparisons)
    if not comparisons or n >= needed:
        return []
    if n < statistics.MIN_UNITS:
        more = f" for one comparison, {needed} for these {comparisons}" if comparisons > 1 else ""
        return [f"too few {over} to rank: {n}; {statistics.MIN_UNITS} are needed{more}."]
    return [f"too few {over} to separate anything among {comparisons} comparisons: {n}; {needed} are needed."]


def scenarios(attrs: dict[str, Any], found: Measured, differences: Floats) -> list[str]:
    """What scenarios are, where scenes are swept, and whether those of one scene are alike."""
    swept = {c: v for c, v in attrs["settings"].items() if len(v) > 1}
    if attrs["over"] != "scenarios" or not swept or attrs["scenarios"] == attrs["scenes"]:
        return []
    columns = statistics.joined([c.removeprefix("p_") for c in swept])
    text = f"a scenario is a scene with its swept values ({columns}): {attrs['scenarios']} of {attrs['scenes']} scenes, taken as independent; --by splits them"
    effect = float(statistics.design_effect(differences, found.units.groups).max(initial=1.0)) if len(differences) > 1 else 1.0
    if effect < _ALIKE:
        return [f"{text}."]
    return [f"{text}. Over scenes alone the standard error of a difference is {effect:.1f} times as large: intervals may be too narrow."]


def skew(pairs: list[tuple[str, str]], differences: Floats) -> list[str]:
    """A warning that names the pairs whose differences (n, M) are skewed."""
    bent = [f"{a} and {b}" for (a, b), skewed in zip(pairs, statistics.skewed(differences), strict=True) if skewed]
    return [f"differences are skewed between {statistics.joined(bent)}: interval and letters are optimistic there."] if bent else []


def _neighbours(order: list[str], found: Measured) -> Floats:
    """Differences (n, K − 1) between pipelines that follow each other on the board."""
    columns = [found.names.index(name) for name in order]
    eye = np.eye(len(found.names))
    return combined(found.units.values, eye[:, columns[1:]] - eye[:, columns[:-1]])


def _separation(attrs: dict[str, Any], found: Measured) -> list[str]:
    order = list(attrs["entrants"])
    comparisons = len(order) * (len(order) - 1) // 2
    n, over = attrs["units"], attrs["over"]
    few = too_few(n, over, comparisons)
    if not comparisons or n < statistics.MIN_UNITS:
        return few
    same = "same letter = not separated (paired sign flips, Holm 5%); ranks in brackets hold in 95% of resamples."
    return [same, *few, *skew(list(itertools.pairwise(order)), _neighbours(order, found))]


def _against(attrs: dict[str, Any], found: Measured) -> list[str]:
    vs, names = attrs["vs"], found.names
    if vs not in names:
        return [f"no differences to {vs}: it cannot be ranked."]
    notes = [f"diff: paired, minus {vs}; p by sign flips, Holm over the other pipelines."]
    order = list(attrs["entrants"])
    beside = {order[k] for at in [order.index(vs)] for k in (at - 1, at + 1) if 0 <= k < len(order)}  # named above
    others = [j for j, name in enumerate(names) if name != vs and name not in beside]
    eye = np.eye(len(names))
    differences = combined(found.units.values, eye[:, others] - eye[:, [names.index(vs)]])
    return notes + skew([(names[j], vs) for j in others], differences)


def _failures(records: Sequence[Mapping[str, Any]], found: Measured) -> list[str]:
    if not any(r["failures"] for r in records):
        return []
    trials = found.rows.trials
    ranked = [r["pipeline"] for r in records if not math.isnan(r["mean"])]
    kept = units(found.rows.only(trials.ok[found.rows.trial]), found.pool)
    left = means(kept, trials.pipelines)
    before = [p for p in ranked if p in left]
    after = sorted(before, key=lambda p: (found.sign * left[p], before.index(p)))
    gone = [p for p in ranked if p not in left]
    change = "ranks unchanged if dropped" if before == after else f"order if dropped: {', '.join(after)}"
    never = f" ({statistics.joined(gone)} never succeeded)" if gone else ""
    return [f"! failures scored as empty output; {change}{never}."]


def _missing(records: Sequence[Mapping[str, Any]], found: Measured) -> list[str]:
    notes = []
    rows = found.rows
    total, ranked = len(np.unique(rows.block)), int(found.blocks.sum())
    planned = len(np.unique(found.planned.block))
    if total < planned:
        lost = planned - total
        verbs = ("has", "counts") if lost == 1 else ("have", "count")
        notes.append(f"{lost} of {planned} blocks (scenario and repetition) {verbs[0]} no score at all and {verbs[1]} for nobody.")
    if found.ranked.any() and ranked < total:
        notes.append(f"ranked on {ranked} of {total} blocks (scenario and repetition): the others lack a score of a ranked pipeline.")
    scored = {rows.trials.pipelines[code] for code in np.unique(rows.pipeline[rows.scored])}
    bare = [r["pipeline"] for r in records if r["pipeline"] not in scored]
    if bare:
        notes.append(f"– no scores: {statistics.joined(bare)}.")
    partial = [r["pipeline"] for r in records if r["coverage"] < 1 - 1e-9]
    if partial:
        notes.append(f"– not ranked, the metric covers only a share of the target time: {statistics.joined(partial)}.")
    return notes
