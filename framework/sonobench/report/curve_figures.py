"""Figures of metrics: against a swept value, with intervals and printed values; and over time, with the number of targets."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from sonobench.report.style import MOST, Curve, add_legend, curve_style, figure, finish, labelled, named, scaled, title

if TYPE_CHECKING:
    import pandas as pd

_PRINTED = "ref."
_DECADE = 10.0  # values that span more stand on a logarithmic axis
_NEAR = 0.055  # of the axis: ticks nearer than that are left out
_MARKS = 12  # markers along a curve over time
_NUMBER = "number"


def curve_figure(table: pd.DataFrame, heading: str) -> Any:
    """One panel a metric: mean and 95 % interval of each pipeline at each value.

    Args:
        table: of `curve`.
        heading: the title.
    """
    column, metrics = table.attrs["column"], table.attrs["metrics"]
    styles = _styles(_best(table, metrics[0]))
    drawn = figure(8.6, 1.2 + 2.9 * len(metrics))
    panels = drawn.subplots(len(metrics), 1, sharex=True, squeeze=False)[:, 0]
    values = list(dict.fromkeys(table[column]))
    place, label = _axis(panels[0], column, values)
    printed = [c for c in table.columns if c.startswith(_PRINTED)]
    for axes, metric in zip(panels, metrics, strict=True):
        mine = table[table["metric"] == metric]
        for k, (pipeline, style) in enumerate(styles.items()):
            own = mine[mine["pipeline"] == pipeline]
            x = np.array([place[v] for v in own[column]])
            _with_intervals(axes, x, own, style, pipeline, aside_pt=1.6 * (k - (len(styles) - 1) / 2))
            for name in printed:
                axes.plot(x, own[name], ls="", marker=style.marker, ms=10, mfc="none", mec=style.colour, mew=1.3, zorder=4)
        finish(axes, label if axes is panels[-1] else "", _metric_label(metric, mine), legend=False)
        _from_zero(axes, mine["mean"])
    _legend(panels[0], [name.removeprefix(_PRINTED) for name in printed if table[name].notna().any()])
    title(drawn, heading)
    _caption(drawn, [_intervals_over(table), *_pooled(table), *_remarks(table, printed), *_left_away(table, styles)])
    return drawn


def time_figure(table: pd.DataFrame, metrics: Sequence[str], heading: str, notes: Sequence[str] = ()) -> Any:
    """One panel a metric and one of the number of targets: mean and 95 % band of each pipeline at each evaluation time.

    Args:
        table: rows of one scenario of `over_time`.
        metrics: in the order of the panels.
        heading: the title.
        notes: sentences below.
    """
    styles = _styles(_best(table, metrics[0]))
    drawn = figure(9.6, 1.2 + 2.5 * (len(metrics) + 1))
    panels = drawn.subplots(len(metrics) + 1, 1, sharex=True, squeeze=False)[:, 0]
    for axes, metric in zip(panels, (*metrics, _NUMBER), strict=True):
        mine = table[table["metric"] == metric]
        if metric == _NUMBER:
            first = mine[mine["pipeline"] == mine["pipeline"].iloc[0]]
            axes.step(first["time_s"], first["targets"], where="post", color="#999999", lw=5, alpha=0.6, label="truth")
            axes.yaxis.get_major_locator().set_params(integer=True)
        for k, (pipeline, style) in enumerate(styles.items()):
            own = mine[mine["pipeline"] == pipeline]
            every = max(1, len(own) // _MARKS)
            axes.fill_between(own["time_s"], own["low"], own["high"], color=style.colour, alpha=0.18, lw=0)
            marks = slice(k * every // max(len(styles), 1), None, every)
            axes.plot(
                own["time_s"],
                own["mean"],
                color=style.colour,
                ls=style.line,
                lw=1.4,
                marker=style.marker,
                ms=5,
                markevery=marks,
                label=pipeline,
            )
        label = "number of targets" if metric == _NUMBER else _metric_label(metric, mine)
        finish(axes, "time (s)" if axes is panels[-1] else "", label, legend=metric == _NUMBER)
        _from_zero(axes, mine["mean"])
    panels[-1].set_xlim(table["time_s"].min(), table["time_s"].max())
    title(drawn, heading)
    _caption(drawn, [_over_recordings(table), *notes, *_left_away(table, styles)])
    return drawn


def _legend(axes: Any, printed: Sequence[str]) -> None:
    """Curves, and after them what hollow markers are."""
    from matplotlib.lines import Line2D

    handles, labels = axes.get_legend_handles_labels()
    for name in printed:
        handles.append(Line2D([], [], ls="", marker="o", ms=10, mfc="none", mec="#555555", mew=1.3))
        labels.append(f"hollow: printed ({name})")
    add_legend(axes, handles, labels)


def _best(table: pd.DataFrame, metric: str) -> list[str]:
    """Pipelines, those with the best mean of a metric first, cut to what a picture holds; in the order of their names."""
    mine = table[table["metric"] == metric]
    sign = -1.0 if "better" in mine and (mine["better"] == "higher").any() else 1.0
    means = (sign * mine.groupby("pipeline")["mean"].mean()).sort_values(kind="stable", na_position="last")
    return sorted(means.index[:MOST])


def _styles(pipelines: Sequence[str]) -> dict[str, Curve]:
    return {name: curve_style(k) for k, name in enumerate(pipelines)}


def _axis(axes: Any, column: str, values: Sequence[Any]) -> tuple[dict[Any, float], str]:
    """Where each value stands on x, and the axis's label; sets scale and ticks."""
    words, unit = named(column.rpartition(".")[2])
    if any(isinstance(v, (str, bool)) for v in values):
        axes.set_xticks(range(len(values)), [str(v) for v in values])
        axes.set_xlim(-0.5, len(values) - 0.5)
        return {v: float(k) for k, v in enumerate(values)}, labelled(words, unit)
    factor, unit = scaled(unit, values)
    place = {v: float(v) * factor for v in values}
    numbers = sorted(place.values())
    if numbers[0] > 0 and numbers[-1] / numbers[0] >= _DECADE:
        axes.set_xscale("log")
        axes.minorticks_off()
    at = [math.log(v) for v in numbers] if axes.get_xscale() == "log" else numbers
    ticks: list[int] = []
    for k, v in enumerate(at):
        if not ticks or v - at[ticks[-1]] > _NEAR * (at[-1] - at[0]):
            ticks.append(k)
    axes.set_xticks([numbers[k] for k in ticks], [f"{numbers[k]:.6g}" for k in ticks])
    return place, labelled(words, unit)


def _with_intervals(axes: Any, x: Any, own: pd.DataFrame, style: Curve, label: str, aside_pt: float) -> None:
    """Mean and interval; curves stand some points aside of one another, so that equal ones are all seen."""
    from matplotlib.transforms import ScaledTranslation

    mean = own["mean"].to_numpy(float)
    reach = np.abs(own[["low", "high"]].to_numpy(float).T - mean)
    moved = axes.transData + ScaledTranslation(aside_pt / 72, 0, axes.figure.dpi_scale_trans)
    axes.errorbar(
        x,
        mean,
        yerr=np.where(np.isfinite(reach), reach, 0.0),
        color=style.colour,
        marker=style.marker,
        ls=style.line,
        lw=1.4,
        ms=5,
        elinewidth=1.0,
        capsize=3,
        label=label,
        transform=moved,
    )
    seen = own[["low", "mean", "high"]].to_numpy(float)
    here = np.isfinite(seen)
    axes.update_datalim(np.column_stack([np.repeat(x, 3)[here.ravel()], seen[here]]))  # what stands aside is not counted by itself
    axes.autoscale_view()


def _metric_label(metric: str, mine: pd.DataFrame) -> str:
    unit = mine["unit"].iloc[0] if len(mine) else ""
    arrow = {"lower": " ↓", "higher": " ↑"}.get(str(mine["better"].iloc[0]), "") if "better" in mine and len(mine) else ""
    shown = {"1": "", "mixed": "mixed units"}.get(unit, unit)
    return textwrap.fill(labelled(f"{metric}{arrow}", shown).replace(",", ", "), 34)


def _from_zero(axes: Any, means: pd.Series) -> None:
    """Where no mean is negative, the y axis begins at 0, or above it where 0 is far."""
    low, high = axes.get_ylim()
    if (means.dropna() >= 0).all() and low < 0.4 * high:
        axes.set_ylim(bottom=-0.03 * high)


def _intervals_over(table: pd.DataFrame) -> str:
    told = dict.fromkeys(f"{n} {over}" for n, over in zip(table["n"], table["over"], strict=True) if n > 1)
    if not told:
        return "mean; no interval can be given of one unit"
    shown = list(told)[:3]
    return f"mean and 95 % interval of the board, at each value over {' or '.join(shown)}{' …' if len(told) > 3 else ''}"


def _over_recordings(table: pd.DataFrame) -> str:
    n = table["n"][table["n"] > 0]
    if n.max() == 1:
        return "one recording, so no interval"
    over = f"{n.min()}" if n.min() == n.max() else f"{n.min()} to {n.max()}"
    return f"mean and 95 % interval at each evaluation time, over {over} recordings"


def _pooled(table: pd.DataFrame) -> list[str]:
    others: Mapping[str, Sequence[Any]] = table.attrs["pooled"]
    return [f"mean over {c.removeprefix('p_')} = {', '.join(map(str, v))}" for c, v in others.items() if len(v) > 1]


def _remarks(table: pd.DataFrame, printed: Sequence[str]) -> list[str]:
    failures = table.groupby(["pipeline", table.attrs["column"]])["failures"].max().groupby("pipeline").sum()
    bad = [f"{name} {count}" for name, count in failures.items() if count]
    said = [f"failed trials count as empty output: {', '.join(bad)}"] if bad else []
    shown = any(table[name].notna().any() for name in printed)
    return [*said, *(["the notes of `sonobench board` say what printed values rest on"] if shown else [])]


def _left_away(table: pd.DataFrame, styles: Mapping[str, Curve]) -> list[str]:
    count = table["pipeline"].nunique()
    return [f"the {len(styles)} best of {count} pipelines are drawn; the CSV beside has all"] if count > len(styles) else []


def _caption(drawn: Any, sentences: Sequence[str]) -> None:
    drawn.supxlabel(textwrap.fill("; ".join(sentences) + ".", 130), fontsize=8, color="#555555", x=0.01, ha="left")
