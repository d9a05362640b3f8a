"""What a run measured of one metric: which pipelines can be compared, on what, and their unit values."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from sonobench.board.pooling import Units, units
from sonobench.board.rows import Coded, Rows, coded, joined
from sonobench.board.select import trial_keys
from sonobench.types import Bools

_FULL = 1 - 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """One metric of a run.

    Attributes:
        metric, unit, better, pool: as its scores say; better is "lower" or "higher".
        planned: all rows.
        rows: those of blocks in which anything can be scored (all, where there is no such block).
        ranked: (P,) which pipelines can be ranked.
        blocks: (blocks,) which ones all of these have a score of.
        units: of the ranked pipelines over these blocks.
    """

    metric: str
    unit: str
    better: str
    pool: str
    planned: Rows
    rows: Rows
    ranked: Bools
    blocks: Bools
    units: Units

    @property
    def sign(self) -> float:
        """−1 where higher is better."""
        return -1.0 if self.better == "higher" else 1.0

    @property
    def names(self) -> list[str]:
        """Pipelines of the units' columns."""
        return [self.planned.trials.pipelines[k] for k in self.units.pipelines]


def measured(trials: pd.DataFrame, metric: str, scores: pd.DataFrame, among: Collection[str] | None = None) -> Measured:
    """Join, decide what is comparable, pool.

    Args:
        trials: rows of trials.parquet.
        metric: its name.
        scores: its rows of scores.parquet.
        among: compare these pipelines alone.

    Raises:
        InputError: a trial stands there twice.
    """
    planned = joined(coded(trials), trial_keys(trials), scores)
    unit, better, pool = (str(scores[c].iloc[0]) for c in ("unit", "better", "pool"))
    known = np.zeros(_blocks(planned.trials), bool)
    known[planned.block[np.isfinite(planned.value)]] = True
    rows = planned.only(known[planned.block]) if known.any() else planned
    wanted = np.array([among is None or name in among for name in planned.trials.pipelines], bool)
    ranked, blocks = _comparable(rows, wanted)
    compared = _complete(units(rows.only(ranked[rows.pipeline] & blocks[rows.block]), pool))
    return Measured(metric, unit, better, pool, planned, rows, ranked, blocks, compared)


def _complete(compared: Units) -> Units:
    """Without units in which a pipeline has a score of no weight, hence no value."""
    whole = np.isfinite(compared.values).all(axis=1)
    return compared if whole.all() else replace(compared, values=compared.values[whole], groups=compared.groups[whole])


def _blocks(trials: Coded) -> int:
    return int(trials.block.max(initial=-1)) + 1


def _comparable(rows: Rows, wanted: Bools) -> tuple[Bools, Bools]:
    """Pipelines (P,) whose metric is defined and covers all in every trial that has scores, and the blocks that all of them have."""
    shape = len(wanted), _blocks(rows.trials)
    at = rows.pipeline * shape[1] + rows.block
    size = shape[0] * shape[1]

    def any_of(mask: Bools) -> Bools:
        return (np.bincount(at[mask], minlength=size) > 0).reshape(shape)

    planned, unscored = any_of(np.ones(len(at), bool)), any_of(~rows.scored)
    known, short = any_of(np.isfinite(rows.value)), any_of(rows.scored & ~(rows.coverage >= _FULL))
    scored = planned & ~unscored
    faulty = scored & (~known | short)
    ranked = wanted & scored.any(axis=1) & ~faulty.any(axis=1)
    blocks = np.logical_and.reduce(scored[ranked], axis=0) if ranked.any() else np.zeros(shape[1], bool)
    return ranked, np.asarray(blocks, bool)
