"""Files of metrics against a swept value or time: a PNG and the CSV of its numbers beside it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sonobench.errors import InputError
from sonobench.files import replace_file
from sonobench.report.curve_figures import curve_figure, time_figure
from sonobench.report.style import safe_name, shown, write_png

if TYPE_CHECKING:
    import pandas as pd

    from sonobench.harness.run import Run

TIME = "time"
_SCENARIOS = 12  # pictures that one call makes


def write_curves(
    run: Run, over: str, metrics: Sequence[str] = (), references: Sequence[str] = (), out: str | Path | None = None
) -> list[Path]:
    """Write a picture and its numbers; over time those of every scenario.

    Args:
        run: all of it is drawn; `run.where(...)` narrows it down.
        over: a swept column, any unique ending of it, or "time".
        metrics: one panel each; by default the run's first.
        references: published numbers beside those that the study names; not over time.
        out: folder; by default `report` in the run's folder.

    Returns:
        The paths: PNG, CSV, PNG, CSV, …

    Raises:
        InputError: a name that is not there; more than 12 scenarios over time.
    """
    from sonobench.report.run_report import made

    folder = run.path / "report" if out is None else Path(out)
    if over == TIME:
        if references:
            raise InputError("references print no values over time; leave --reference out")
        return _over_time(run, metrics, folder)
    table = run.curve(over, metrics, references)
    scenes = table.attrs["scenes"]
    heading = f"{run.path.name}: {', '.join(scenes) if len(scenes) <= 4 else f'{len(scenes)} scenes'}"
    name = f"over-{table.attrs['column'].rpartition('.')[2]}-{_words(run, table.attrs['metrics'])}{_narrowed(table)}"
    drawn = curve_figure(table, heading)
    return _written(made(folder), name, drawn, table)


def _over_time(run: Run, metrics: Sequence[str], folder: Path) -> list[Path]:
    from sonobench.report.run_report import made
    from sonobench.report.time_curves import scenarios_of

    scenarios = scenarios_of(run.trials)
    if len(scenarios) > _SCENARIOS:
        some = ", ".join(_called(s) for s in scenarios[:3])
        raise InputError(
            f"the run has {len(scenarios)} scenarios ({some}, …), of which each has a picture over time; choose up to {_SCENARIOS} with "
            "--scene NAME and --at COLUMN=VALUE"
        )
    table = run.curve(TIME, metrics)
    folder, written = made(folder), []
    wanted = table.attrs["metrics"]
    notes = [f"no scores: {', '.join(table.attrs['without'])}"] if table.attrs["without"] else []
    for scenario in scenarios:
        mine = table
        for column, value in scenario.items():
            mine = mine[mine[column].isna() if value is None else mine[column] == value]
        if mine.empty:
            continue
        lost = table.attrs["left_out"].get(tuple(scenario.values()), 0)
        own = [*notes, *([f"{lost} recordings that not every pipeline has a score of are left out"] if lost else [])]
        drawn = time_figure(mine, wanted, f"{run.path.name}: {_called(scenario)}", own)
        written += _written(folder, f"time-{_words(run, wanted)}-{_called(scenario)}", drawn, mine)
    return written


def _words(run: Run, metrics: Sequence[str]) -> str:
    """Metrics in a file's name, without settings: "ospa+cardinality.are"; of several settings "ospa-2", counted as in the study."""
    return "+".join(_word(run, metric) for metric in metrics)


def _word(run: Run, metric: str) -> str:
    label = next((m for m in run.metrics if metric == m or metric.startswith(f"{m}.")), metric)
    name = label.partition("[")[0]
    alike = [m for m in run.metrics if m.partition("[")[0] == name]
    number = f"-{alike.index(label) + 1}" if len(alike) > 1 else ""
    return f"{name}{number}{metric.removeprefix(label)}"


def _called(scenario: dict[str, Any]) -> str:
    """ "chen2012 delay_std_s=0.000125"."""
    scene, *swept = scenario.items()
    return " ".join([str(scene[1]), *(f"{c.rpartition('.')[2]}={shown(v)}" for c, v in swept if v is not None)])


def _narrowed(table: pd.DataFrame) -> str:
    """What tells pictures of several settings of one run apart: values of which only one was chosen."""
    return "".join(f"-{c.rpartition('.')[2]}={shown(v[0])}" for c, v in table.attrs["pooled"].items() if len(v) == 1)


def _written(folder: Path, name: str, drawn: Any, table: pd.DataFrame) -> list[Path]:
    name = safe_name(name)
    csv = folder / f"{name}.csv"
    replace_file(csv, table.to_csv(index=False).encode())
    return [write_png(drawn, folder / f"{name}.png"), csv]
