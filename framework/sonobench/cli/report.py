"""`sonobench report`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from sonobench.cli.output import emit, json_option


def _settings(_context: Any, _parameter: Any, words: tuple[str, ...]) -> dict[str, list[str]]:
    """Values by column of "COLUMN=VALUE"s; one column's values are alternatives."""
    found: dict[str, list[str]] = {}
    for word in words:
        column, sign, value = word.partition("=")
        if not (column and sign and value):
            raise click.BadParameter(f"{word!r}: write COLUMN=VALUE, such as snr_db=20")
        found.setdefault(column, []).append(value)
    return found


@click.command()
@click.argument("runs", nargs=-1, required=True, metavar="RUN...")
@click.option(
    "--over",
    metavar="COLUMN|time",
    help="Draw metrics against a swept value (any unique ending of its column), or at every evaluation time; numbers in a CSV beside.",
)
@click.option(
    "--metric",
    "metrics",
    multiple=True,
    help="With --over: a panel each, repeatable; else what best and worst refer to. Default: the study's first metric.",
)
@click.option("--scene", "scenes", multiple=True, metavar="NAME", help="Only this scene (patterns such as 'quick*' too); repeatable.")
@click.option("--at", multiple=True, callback=_settings, metavar="COLUMN=VALUE", help="Only at this swept value; repeatable.")
@click.option(
    "--pipeline", "pipelines", multiple=True, metavar="NAME", help="Only this pipeline (patterns such as '*-phd' too); repeatable."
)
@click.option("--reference", "references", multiple=True, metavar="NAME", help="With --over COLUMN: mark published numbers; repeatable.")
@click.option(
    "--trial",
    "trials",
    multiple=True,
    metavar="KEY",
    help="Pictures of this trial (head of its key); default: each pipeline's best, median and worst.",
)
@click.option(
    "--frame",
    "frames_s",
    type=float,
    multiple=True,
    metavar="SECONDS",
    help="Draw the correlations of the frame nearest to this time, of --trial or of each pipeline's first; repeatable.",
)
@click.option("-o", "--out", type=click.Path(path_type=Path, file_okay=False), help="Folder of the pictures; default: RUN/report.")
@json_option
def report(
    runs: tuple[str, ...],
    scenes: tuple[str, ...],
    at: dict[str, list[str]],
    pipelines: tuple[str, ...],
    metrics: tuple[str, ...],
    as_json: bool,
    **options: Any,
) -> None:
    """Write pictures (PNG) of RUN: of trials (tracks in the room, coordinates and count over time; correlations with --frame), or of metrics --over something."""
    from sonobench.harness import open_run

    run = open_run(*runs)
    if scenes or at or pipelines:
        run = run.where(scenes, at, pipelines)
    written = run.report(metric=metrics, **options)
    emit([str(p) for p in written], "\n".join(map(str, written)), as_json)
