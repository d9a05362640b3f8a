"""Trials and the scores of one metric, joined, as arrays of codes: what pooling and ranking work on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import pandas as pd

from sonobench.types import Bools, Floats, Ints


@dataclass(frozen=True, slots=True, eq=False)
class Coded:
    """Trials as codes (N,). Codes follow sorted names and values, so that a board does not depend on the order of rows.

    Attributes:
        pipelines: names; `pipeline` counts into them.
        scenario: a scene with its swept values; `scene` (scenarios,) is the scene of each.
        take: a recording: a scenario's repetition (and, where runs of other seeds are put together, its input).
        block: a take's run: what pipelines are paired on.
        ok: status "ok".
    """

    pipelines: tuple[str, ...]
    pipeline: Ints
    scenario: Ints
    scene: Ints
    take: Ints
    block: Ints
    ok: Bools


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """One row (R,) for each trial and slice of one metric; a trial without a score has one, unscored.

    Attributes:
        trials: what `trial` counts into.
        value: NaN where the metric is undefined or there is no score.
        weight, coverage: as scored; 0 and NaN without a score.
    """

    trials: Coded
    trial: Ints
    slice: Ints
    value: Floats
    weight: Floats
    coverage: Floats
    scored: Bools

    def only(self, mask: Bools) -> Rows:
        """The rows of a mask (R,)."""
        return Rows(self.trials, *(getattr(self, f.name)[mask] for f in fields(self)[1:]))

    @property
    def pipeline(self) -> Ints:
        """Code of each row's pipeline."""
        return self.trials.pipeline[self.trial]

    @property
    def block(self) -> Ints:
        """Code of each row's block."""
        return self.trials.block[self.trial]

    @property
    def scenario(self) -> Ints:
        """Code of each row's scenario."""
        return self.trials.scenario[self.trial]


def coded(trials: pd.DataFrame) -> Coded:
    """Codes of a table of trials."""
    names, pipeline = _codes(trials["pipeline"])
    swept = sorted(c for c in trials.columns if c.startswith("p_") and not c.startswith("p_pipelines."))
    scene = _codes(trials["scene"])[1]
    scenario, first = _combined(scene, *(_codes(trials[c])[1] for c in swept))
    repetition = trials["repetition"].to_numpy(np.int64)
    take, _ = _combined(scenario, repetition)
    if "input_sha" in trials:
        take, _ = _combined(take, _inputs(take, _codes(trials["input_sha"])))
    block, _ = _combined(take, trials["run"].to_numpy(np.int64))
    ok = (trials["status"] == "ok").fillna(False).to_numpy(bool)
    return Coded(tuple(map(str, names)), pipeline, scenario, scene[first], take, block, ok)


def joined(trials: Coded, keys: pd.Index, scores: pd.DataFrame) -> Rows:
    """The scores of one metric beside their trials; scores of other trials are left out.

    Args:
        trials: codes of the trials.
        keys: their trial_key, each once.
        scores: rows of one metric.
    """
    at = keys.get_indexer(pd.Index(scores["trial_key"]))
    here = np.flatnonzero(at >= 0)
    bare = np.flatnonzero(np.bincount(at[here], minlength=len(keys)) == 0)
    value, weight, coverage = (scores[c].to_numpy(float)[here] for c in ("value", "weight", "coverage"))
    slices = _codes(scores["slice"])[1][here]
    nothing = np.full(len(bare), np.nan)
    return Rows(
        trials,
        np.concatenate([at[here], bare]).astype(np.int64),
        np.concatenate([slices, np.zeros(len(bare), np.int64)]),
        np.concatenate([np.where(np.isfinite(value), value, np.nan), nothing]),
        np.concatenate([np.where(weight > 0, weight, 0.0), np.zeros(len(bare))]),
        np.concatenate([coverage, nothing]),
        np.arange(len(here) + len(bare)) < len(here),
    )


def _codes(column: pd.Series) -> tuple[list[object], Ints]:
    """Sorted distinct values and the code (N,) of each row; a missing value is code 0 of its own."""
    codes, found = pd.factorize(column)
    values = list(found)
    order = sorted(range(len(values)), key=lambda k: (isinstance(values[k], str), values[k]))
    place = np.empty(len(values) + 1, np.int64)  # the last is for code −1: missing
    missing = bool((codes < 0).any())
    place[order] = np.arange(len(order)) + missing
    place[-1] = 0
    return [*([""] if missing else []), *(values[k] for k in order)], place[codes]


def _combined(*codes: Ints) -> tuple[Ints, Ints]:
    """One code (N,) for each combination that occurs, in lexicographic order, and the first row of each."""
    whole = np.unique(codes[0], return_inverse=True)[1]
    for more in codes[1:]:
        inner = np.unique(more, return_inverse=True)[1]
        whole = np.unique(whole * (inner.max(initial=0) + 1) + inner, return_inverse=True)[1]
    return whole, np.unique(whole, return_index=True)[1]


def _inputs(take: Ints, inputs: tuple[Sequence[object], Ints]) -> Ints:
    """Which of a take's inputs (N,) each trial read; a trial that never read any counts as one that read the first."""
    names, code = inputs
    known = np.array([bool(n) for n in names], bool)[code]
    first = np.full(take.max(initial=-1) + 1, len(names), np.int64)
    np.minimum.at(first, take[known], code[known])
    return np.where(known, code, first[take])
