"""A metric against a swept value: one row for each pipeline and value, with the board's own mean and interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from sonobench.board.measured import measured
from sonobench.board.pooling import units
from sonobench.board.printed import PREFIX, in_group
from sonobench.board.select import of_metric, parts
from sonobench.report.selection import metrics_of, scene_columns, sorted_values, swept_column
from sonobench.report.style import shown

if TYPE_CHECKING:
    import pandas as pd

    from sonobench.harness.run import Run

_Counts = dict[tuple[Any, str], tuple[int, str]]  # n and "repetitions", by value and pipeline
_TAKEN = ("mean", "low", "high", "interval", "failures", "trials", "coverage")


def curve(run: Run, over: str, metrics: Sequence[str] = (), references: Sequence[str] = ()) -> pd.DataFrame:
    """What the board says at each value of a swept column.

    Args:
        run: all of it is used; `run.where(...)` narrows it down.
        over: a swept column, or any unique ending of it.
        metrics: names, or patterns such as "ospa*"; by default the run's first.
        references: published numbers beside those that the study names.

    Returns:
        Columns: metric, unit, better, the swept one, pipeline (without the swept value in its name), entry (as the board
        calls it), n (units that the interval is over), over (what they are), mean, low, high (95 %), interval (its method),
        failures, trials, coverage, and ref.NAME for each reference. `attrs`: column, metrics, scenes, pooled (values of the
        other swept columns that each mean is over, by column), notes (of the boards, by metric).

    Raises:
        InputError: a column or metric that is not there, and what is.
    """
    import pandas as pd

    column = swept_column(run.trials, over)
    tables: list[pd.DataFrame] = []
    notes: dict[str, list[str]] = {}
    for metric in metrics_of(run, metrics):
        board = run.board(metric, by=column, references=references)
        groups = [g for g in board.attrs["groups"] if g["value"] is not None]
        counted = _counts(run, metric, column)
        tables += [_rows(in_group(board, column, group["value"]), group, column, counted) for group in groups]
        notes[metric] = list(dict.fromkeys(note for group in groups for note in group["notes"]))
    table = pd.concat(tables, ignore_index=True)
    table.insert(4, "pipeline", _without(run.trials, column, table["entry"].tolist()))
    here = run.trials[run.trials[column].notna()]
    table.attrs = {
        "column": column,
        "metrics": list(notes),
        "scenes": sorted_values(here["scene"]),
        "pooled": {c: sorted_values(here[c]) for c in scene_columns(here) if c != column},
        "notes": notes,
    }
    return table


def _rows(board: pd.DataFrame, group: dict[str, Any], column: str, counted: _Counts) -> pd.DataFrame:
    import pandas as pd

    printed = [c for c in board.columns if c.startswith(PREFIX)]
    return pd.DataFrame(
        {
            "metric": group["metric"],
            "unit": group["unit"],
            "better": group["better"],
            column: group["value"],
            "entry": board["pipeline"],
            "n": [counted[group["value"], str(name)][0] for name in board["pipeline"]],
            "over": [counted[group["value"], str(name)][1] for name in board["pipeline"]],
            **{name: board[name] for name in (*_TAKEN, *printed)},
        }
    )


def _counts(run: Run, metric: str, column: str) -> _Counts:
    """How many units each pipeline's interval is over, by value and pipeline: the common ones of those that can be ranked."""
    scores = of_metric(run.scores, metric)
    counts: _Counts = {}
    for value, trials in parts(run.trials, column):
        found = measured(trials, metric, scores)
        for code, name in enumerate(found.planned.trials.pipelines):
            mine = found.units if found.ranked[code] else units(found.rows.only(found.rows.pipeline == code), found.pool)
            counts[value, name] = len(mine.values), mine.over if len(mine.values) else ""
    return counts


def _without(trials: pd.DataFrame, column: str, entries: Sequence[str]) -> list[str]:
    """Names of curves: of entries that the column itself makes different, what they have in common."""
    if not column.startswith("p_pipelines."):
        return list(entries)
    touched = trials[trials[column].notna()].drop_duplicates("pipeline")
    rows = {row["pipeline"]: {str(c): v for c, v in row.items()} for row in touched.to_dict("records")}
    return [_bare(entry, rows[entry], column) if entry in rows else entry for entry in entries]


def _bare(entry: str, row: Mapping[str, Any], column: str) -> str:
    """ "mine[floor=0.05,gate=2]" over its floor is "mine[gate=2]"."""
    import pandas as pd

    name = entry.partition("[")[0]
    rest = [c for c in row if c.startswith(f"p_pipelines.{name}.") and c != column and not pd.isna(row[c])]
    words = ",".join(f"{c.rpartition('.')[2]}={shown(row[c])}" for c in rest)
    return f"{name}[{words}]" if words else name
