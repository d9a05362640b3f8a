"""A board as text, Markdown, CSV, JSON or Parquet."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from sonobench.errors import InputError

_NUMBERS = ("mean", "fail", "cover", "ms/frame", "p")


def render(board: pd.DataFrame, format: str = "text") -> str | bytes:
    """Print a board of `leaderboard`.

    Args:
        board: with its `attrs`.
        format: "text", "md", "csv", "json" ({"board": attrs, "rows": [...]}) or "parquet" (bytes).

    Raises:
        InputError: another format.
    """
    if format == "csv":
        return board.to_csv(index=False).rstrip("\n")
    if format == "json":
        rows = json.loads(board.to_json(orient="records", double_precision=15))
        return json.dumps({"board": _finite(board.attrs), "rows": rows}, indent=2, ensure_ascii=False)
    if format == "parquet":
        buffer = io.BytesIO()
        board.to_parquet(buffer, index=False)
        return buffer.getvalue()
    if format not in ("text", "md"):
        raise InputError(f"format {format!r}; text, md, csv, json or parquet is needed")
    one = _text if format == "text" else _markdown
    if "groups" not in board.attrs:
        return one(board, {str(k): v for k, v in board.attrs.items()}, "")
    column = board.attrs["by"]
    parts = []
    for group in board.attrs["groups"]:
        mine = board[column].isna() if group["value"] is None else board[column] == group["value"]
        parts.append(one(board[mine], group, f"{column.removeprefix('p_')} = {group['value']}: "))
    return "\n\n".join(parts)


def _text(board: pd.DataFrame, attrs: Mapping[str, Any], prefix: str) -> str:
    head, cells = _cells(board, attrs)
    widths = [max(len(row[i]) for row in cells) for i in range(len(head))]
    left = max(len(prefix + _title(attrs)), widths[0] + 2 + widths[1])
    widths[1] = left - widths[0] - 2
    widths[2:] = [max(w, len(h)) for w, h in zip(widths[2:], head[2:], strict=True)]
    top = "  ".join([(prefix + _title(attrs)).ljust(left), *(h.ljust(w) for h, w in zip(head[2:], widths[2:], strict=True))])
    lines = ["  ".join(_aligned(c, w, h) for c, w, h in zip(row, widths, head, strict=True)) for row in cells]
    return "\n".join([top.rstrip(), *(line.rstrip() for line in lines), *attrs["notes"]])


def _markdown(board: pd.DataFrame, attrs: Mapping[str, Any], prefix: str) -> str:
    head, cells = _cells(board, attrs)
    rule = ["---:" if h in _NUMBERS else "---" for h in head]
    table = ["| " + " | ".join(c.strip().replace("|", "\\|") for c in row) + " |" for row in [head, rule, *cells]]
    return "\n".join([f"**{prefix}{_title(attrs)}**", "", *table, "", *(f"- {note}" for note in attrs["notes"])])


def _aligned(cell: str, width: int, name: str) -> str:
    return cell.rjust(width) if name in _NUMBERS else cell.ljust(width)


def _title(attrs: Mapping[str, Any]) -> str:
    arrow = "↑" if attrs["better"] == "higher" else "↓"
    unit = f" ({attrs['unit']})" if attrs["unit"] != "1" else ""
    return f"{attrs['metric']} {arrow}{unit}, {_plural(attrs['scenarios'], 'scenario')} × {_plural(attrs['repetitions'], 'rep')}"


def _cells(board: pd.DataFrame, attrs: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    digits = _digits(board["mean"])
    diff = "diff" in board
    more = list(board.columns[board.columns.get_loc("diff_p" if diff else "given") + 1 :])  # type: ignore[operator]
    head = ["pipeline", "origin", "mean", "95% CI", "rank [95%]", "tie", "fail", "cover", "ms/frame"]
    head += ([f"diff to {attrs['vs']}", "p"] if diff else []) + more
    scales = {name: _digits(board[name]) for name in more}
    rows = []
    for position, row in enumerate(board.to_dict("records"), 1):
        place = f"{position:2d}" if row["pipeline"] in attrs["entrants"] else " –"
        cells = [
            f"{place} {row['pipeline']}{'°' if row['given'] else ''}",
            f"({row['origin']})",
            _number(row["mean"], digits),
            _range(row["low"], row["high"], digits),
            "–" if pd.isna(row["rank"]) else f"{row['rank']} [{row['rank_low']}–{row['rank_high']}]",
            row["tie"] or "–",
            f"{row['failures']}{'!' if row['failures'] else ''}",
            "–" if pd.isna(row["coverage"]) else f"{100 * row['coverage']:.0f}%",
            _number(row["ms_per_frame"], 2 if pd.notna(row["ms_per_frame"]) and row["ms_per_frame"] < 10 else 1),
        ]
        if diff:
            own = f"{_number(row['diff'], digits, '+')} {_range(row['diff_low'], row['diff_high'], digits, '+')}"
            cells += ["–" if pd.isna(row["diff"]) else own, _number(row["diff_p"], 3)]
        rows.append([*cells, *(_number(row[name], scales[name]) for name in more)])
    return head, rows


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


def _finite(value: Any) -> Any:
    """JSON has no NaN."""
    if isinstance(value, Mapping):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
