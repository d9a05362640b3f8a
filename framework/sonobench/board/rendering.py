"""A board, or an attribution, as text, Markdown, CSV, JSON or Parquet."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from sonobench.board.printed import COST_PREFIX, PREFIX, in_group
from sonobench.errors import InputError

_NUMBERS = ("mean", "fail", "cover", "ms/frame", "p", "pairs", "effect")
Attrs = Mapping[str, Any]


class _Layout(NamedTuple):
    """Cells in print; the title stands over the first `span` columns in text, and over all in Markdown."""

    title: str
    head: list[str]
    rows: list[list[str]]
    span: int


def render(board: pd.DataFrame | Sequence[pd.DataFrame], format: str = "text") -> str | bytes:
    """Print a board of `leaderboard`, or an `attribution`; or several of one kind.

    Args:
        board: with its `attrs`.
        format: "text", "md", "csv", "json" ({"board": attrs, "rows": [...]}, a list of these for several) or "parquet"
            (bytes). Several are one table with a column `metric` as CSV or Parquet.

    Raises:
        InputError: another format.
    """
    if format == "json":
        data = as_data(board) if isinstance(board, pd.DataFrame) else [as_data(one) for one in board]
        return json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False)
    if format == "csv":
        return _one_table(board).to_csv(index=False).rstrip("\n")
    if format == "parquet":
        buffer = io.BytesIO()
        _one_table(board).to_parquet(buffer, index=False)
        return buffer.getvalue()
    if format not in ("text", "md"):
        raise InputError(f"format {format!r}; text, md, csv, json or parquet is needed")
    boards = [board] if isinstance(board, pd.DataFrame) else board
    return "\n\n".join(_shown(one, _text if format == "text" else _markdown) for one in boards)


def _one_table(board: pd.DataFrame | Sequence[pd.DataFrame]) -> pd.DataFrame:
    if isinstance(board, pd.DataFrame):
        by = board.attrs.get("by")
        mixed = by is not None and len({isinstance(v, str) for v in board[by].dropna()}) > 1
        table = board.assign(**{str(by): board[by].astype("string")}) if mixed else board.copy(deep=False)
        table.attrs = _plain(board.attrs)
        return table
    named = [_one_table(one).assign(metric=_metric(one)) for one in board]
    table = pd.concat(named, ignore_index=True)
    table.attrs = {"boards": [_plain(one.attrs) for one in board]}
    return table[["metric", *(c for c in table.columns if c != "metric")]]


def _metric(board: pd.DataFrame) -> str:
    return str((board.attrs["groups"][0] if "groups" in board.attrs else board.attrs)["metric"])


def _shown(board: pd.DataFrame, one: Callable[[pd.DataFrame, Attrs, str], str]) -> str:
    if "groups" not in board.attrs:
        return one(board, _attrs(board.attrs), "")
    column = board.attrs["by"]
    parts = [
        one(in_group(board, column, group["value"]), group, f"{column.removeprefix('p_')} = {group['value']}: ")
        for group in board.attrs["groups"]
    ]
    return "\n\n".join(parts)


def as_data(board: pd.DataFrame) -> dict[str, Any]:
    """A board as plain data that is valid JSON: {"board": attrs, "rows": [...]}; what is missing or not finite is None."""
    return {"board": _plain(board.attrs), "rows": [_plain(row) for row in board.to_dict("records")]}


def _attrs(attrs: Mapping[Any, Any]) -> Attrs:
    return {str(k): v for k, v in attrs.items()}


def _layout(board: pd.DataFrame, attrs: Attrs) -> _Layout:
    return _swaps(board, attrs) if "role" in attrs else _places(board, attrs)


def _text(board: pd.DataFrame, attrs: Attrs, prefix: str) -> str:
    title, head, rows, span = _layout(board, attrs)
    title = prefix + title
    widths = [max((len(row[i]) for row in rows), default=0) for i in range(len(head))]
    left = max(len(title), sum(widths[:span]) + 2 * (span - 1))
    widths[span - 1] += left - sum(widths[:span]) - 2 * (span - 1)
    widths[span:] = [max(w, len(h)) for w, h in zip(widths[span:], head[span:], strict=True)]
    top = "  ".join([title.ljust(left), *(_aligned(h, w, h) for h, w in zip(head[span:], widths[span:], strict=True))])
    lines = ["  ".join(_aligned(c, w, h) for c, w, h in zip(row, widths, head, strict=True)) for row in rows]
    return "\n".join([top.rstrip(), *(line.rstrip() for line in lines), *attrs["notes"]])


def _markdown(board: pd.DataFrame, attrs: Attrs, prefix: str) -> str:
    title, head, rows, _ = _layout(board, attrs)
    rule = ["---:" if _is_number(h) else "---" for h in head]
    table = ["| " + " | ".join(c.strip().replace("|", "\\|") for c in row) + " |" for row in [head, rule, *rows]]
    return "\n".join([f"**{prefix}{title}**", "", *table, "", *(f"- {note}" for note in attrs["notes"])])


def _is_number(head: str) -> bool:
    return head in _NUMBERS or head.endswith(" printed")


def _aligned(cell: str, width: int, head: str) -> str:
    return cell.rjust(width) if _is_number(head) else cell.ljust(width)


def _title(attrs: Attrs) -> str:
    arrow = "↑" if attrs["better"] == "higher" else "↓"
    unit = f" ({attrs['unit']})" if attrs["unit"] != "1" else ""
    return f"{attrs['metric']} {arrow}{unit}, {_plural(attrs['scenarios'], 'scenario')} × {_plural(attrs['repetitions'], 'rep')}"


def _places(board: pd.DataFrame, attrs: Attrs) -> _Layout:
    """A leaderboard's cells."""
    digits = _digits(board["mean"])
    diff = attrs["vs"] is not None
    printed = [c for c in board.columns if c.startswith(PREFIX)]
    costs = [c for c in board.columns if c.startswith(COST_PREFIX)]
    more = list(board.columns[list(board.columns).index("diff_p" if diff else "given") + 1 :])
    head = ["pipeline", "origin", "mean", *(f"{c.removeprefix(PREFIX)} printed" for c in printed)]
    head += ["95% CI", "rank [95%]", "tie", "fail", "cover", "ms/frame", *(f"{c.removeprefix(COST_PREFIX)} printed" for c in costs)]
    head += ([f"diff to {attrs['vs']}", "p"] if diff else []) + more
    scales = {name: _digits(board[name]) for name in more}
    rows = []
    for position, row in enumerate(board.to_dict("records"), 1):
        place = f"{position:2d}" if row["pipeline"] in attrs["entrants"] else " –"
        cells = [
            f"{place} {row['pipeline']}{'°' if row['given'] else ''}",
            f"({row['origin']})",
            _number(row["mean"], digits),
            *(_number(row[name], digits) for name in printed),
            _range(row["low"], row["high"], digits),
            "–" if pd.isna(row["rank"]) else f"{row['rank']} [{row['rank_low']}–{row['rank_high']}]",
            row["tie"] or "–",
            f"{row['failures']}{'!' if row['failures'] else ''}",
            "–" if pd.isna(row["coverage"]) else f"{100 * row['coverage']:.0f}%",
            *(_number(row[name], 2 if row[name] < 10 else 1) for name in ("ms_per_frame", *costs)),
        ]
        if diff:
            own = f"{_number(row['diff'], digits, '+')} {_range(row['diff_low'], row['diff_high'], digits, '+')}"
            cells += ["–" if pd.isna(row["diff"]) else own, _number(row["diff_p"], 3)]
        rows.append([*cells, *(_number(row[name], scales[name]) for name in more)])
    return _Layout(_title(attrs), head, rows, 2)


def _swaps(board: pd.DataFrame, attrs: Attrs) -> _Layout:
    """An attribution's cells."""
    digits = _digits([*board["low"], *board["high"]])
    rows = [
        [
            f"   {row['swap_from']} → {row['swap_to']}",
            str(row["pairs"]),
            _number(row["effect"], digits, "+"),
            _range(row["low"], row["high"], digits, "+"),
            _number(row["p"], 3),
            row["better"] or "–",
        ]
        for row in board.to_dict("records")
    ]
    return _Layout(f"{attrs['role']}: {_title(attrs)}", ["swap", "pairs", "effect", "95% CI", "p", "better"], rows, 1)


def _digits(values: Sequence[float] | pd.Series[float]) -> int:
    """Decimals that give the middle of the values three significant digits."""
    known = sorted(abs(v) for v in values if pd.notna(v) and v != 0)
    return 2 if not known else min(max(2 - math.floor(math.log10(known[(len(known) - 1) // 2])), 0), 6)


def _number(value: float, digits: int, sign: str = "") -> str:
    return "–" if pd.isna(value) else f"{value:{sign}.{digits}f}"


def _range(low: float, high: float, digits: int, sign: str = "") -> str:
    return "–" if pd.isna(low) else f"[{_number(low, digits, sign)}, {_number(high, digits, sign)}]"


def _plural(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"


def _plain(value: Any) -> Any:
    """What JSON can hold; it has no NaN."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if value is pd.NA or (isinstance(value, float) and not math.isfinite(value)):
        return None
    return value
