"""What all pictures share: figures of their own (nothing of pyplot, no global setting), colours, names, axes.

Colours are Okabe and Ito's, which readers with any colour vision tell apart; curves differ in marker and line style too, so
that they are told apart in grey.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from sonobench.files import replace_file

COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442")
INK = "#222222"
DPI = 110
#: curves that a picture holds; more are no longer told apart
MOST = 8
_CURVES = (
    ("#0072B2", "o", "-"),
    ("#D55E00", "s", (0, (5, 2))),
    ("#009E73", "^", (0, (1, 1.2))),
    ("#CC79A7", "D", (0, (6, 2, 1, 2))),
    ("#E69F00", "v", (0, (3, 1.5))),
    ("#56B4E9", "P", (0, (8, 2, 1, 1.5, 1, 1.5))),
    ("#222222", "X", (0, (2, 2))),
    ("#8C6BB1", "<", (0, (10, 2))),
)
_UNITS = (
    ("_m_s2", "m/s²"),
    ("_m_s", "m/s"),
    ("_rad_s", "rad/s"),
    ("_rad", "rad"),
    ("_deg", "°"),
    ("_hz", "Hz"),
    ("_db", "dB"),
    ("_m", "m"),
    ("_s", "s"),
)
_SMALL = ((1e-4, 1e6, "µs"), (0.1, 1e3, "ms"))  # the middle value below the first: times the second


class Curve(NamedTuple):
    """How one curve is drawn."""

    colour: str
    marker: str
    line: Any


def curve_style(k: int) -> Curve:
    """The k-th of MOST styles."""
    return Curve(*_CURVES[k])


def figure(width_in: float, height_in: float, equal: bool = False) -> Any:
    """A matplotlib Figure; `equal`: for axes of equal scales, which do not fill their place."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), layout="compressed" if equal else "constrained")


def finish(axes: Any, x: str, y: str, legend: bool = True) -> None:
    """Labels, a faint grid, and the legend beside the axes."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(color="#DDDDDD", lw=0.6)
    axes.set_axisbelow(True)
    if legend:
        add_legend(axes, *axes.get_legend_handles_labels())


def add_legend(axes: Any, handles: Sequence[Any], labels: Sequence[str]) -> None:
    """Right of the axes."""
    axes.legend(handles, labels, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, frameon=False, fontsize=9)


def title(drawn: Any, text: str) -> None:
    """One small line above everything."""
    drawn.suptitle(text, fontsize=10, x=0.01, ha="left")


def write_png(drawn: Any, path: Path) -> Path:
    """Write a figure atomically; equal figures give equal bytes.

    Raises:
        InputError: the folder cannot be written.
    """
    stream = io.BytesIO()
    drawn.savefig(stream, format="png", dpi=DPI, metadata={"Software": None})
    replace_file(path, stream.getvalue())
    return path


def safe_name(text: str) -> str:
    """What a file's name can hold."""
    return re.sub(r"[^0-9A-Za-z._=,+-]+", "_", text).strip("_")


def shown(value: Any) -> str:
    """A swept value in a title or a file's name: 0.000125, true, pink."""
    value = value.item() if hasattr(value, "item") else value
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def named(name: str) -> tuple[str, str]:
    """A parameter's words and unit: "delay_std_s" is ("delay std", "s"); without a known suffix the unit is ""."""
    words, unit = next(((name.removesuffix(end), u) for end, u in _UNITS if name.endswith(end) and name != end[1:]), (name, ""))
    return (words.replace("_", " ") if unit or name.count("_") > 1 else words), unit


def scaled(unit: str, values: Sequence[float]) -> tuple[float, str]:
    """Factor and unit in which values can be read: small times in ms or µs."""
    sizes = sorted(abs(v) for v in values if v)
    if unit != "s" or not sizes:
        return 1.0, unit
    return next(((factor, small) for bound, factor, small in _SMALL if sizes[len(sizes) // 2] < bound * 10), (1.0, unit))


def labelled(words: str, unit: str) -> str:
    """ "delay std (µs)"."""
    return f"{words} ({unit})" if unit else words
