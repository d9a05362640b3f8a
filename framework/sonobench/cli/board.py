"""`sonobench board` and `sonobench report`."""

from __future__ import annotations

from pathlib import Path

import click

from sonobench.cli.output import emit, json_option


@click.command()
@click.argument("runs", nargs=-1, required=True, metavar="RUN...")
@click.option("--metric", "metrics", multiple=True, help="Which board; repeatable; default: the study's first metric.")
@click.option("--with", "also", multiple=True, metavar="METRIC", help="Add a column with the mean of another metric; repeatable.")
@click.option("--by", help="One board a value of this column, such as a swept parameter (any unique suffix).")
@click.option("--vs", help="Show differences against this pipeline.")
@click.option("--format", "format_", type=click.Choice(["text", "md", "csv", "json", "parquet"]), default="text", show_default=True)
@click.option(
    "-o", "--out", type=click.Path(path_type=Path, dir_okay=False), help="Write to a file instead of stdout (needed for parquet)."
)
@json_option
def board(
    runs: tuple[str, ...],
    metrics: tuple[str, ...],
    also: tuple[str, ...],
    by: str | None,
    vs: str | None,
    format_: str,
    out: Path | None,
    as_json: bool,
) -> None:
    """Print the leaderboard of RUN (a folder, or a name in runs/)."""
    from sonobench.board import render
    from sonobench.errors import InputError
    from sonobench.harness import open_run

    format_ = "json" if as_json else format_
    opened = open_run(*runs)
    wanted = metrics or opened.metrics[:1]
    if format_ in ("json", "parquet", "csv") and len(wanted) > 1:
        raise InputError(f"--format {format_} holds one board, got {len(wanted)} metrics; call once for each")
    if format_ == "parquet" and out is None:
        raise InputError("--format parquet is binary; name a file with -o")
    rendered = [render(opened.board(m, by=by, vs=vs, also=also), format_) for m in wanted]
    content = rendered[0] if isinstance(rendered[0], bytes) else "\n\n".join(map(str, rendered))
    if out is None:
        click.echo(content)
        return
    from sonobench.files import replace_file

    replace_file(out, content if isinstance(content, bytes) else content.encode() + b"\n")


@click.command()
@click.argument("run")
@click.option(
    "--trial",
    "trials",
    multiple=True,
    metavar="KEY",
    help="Pictures of this trial (head of its key); default: each pipeline's best, median and worst.",
)
@click.option("--metric", help="What best and worst refer to; default: the study's first metric.")
@click.option("-o", "--out", type=click.Path(path_type=Path, file_okay=False), help="Folder of the pictures; default: RUN/report.")
@json_option
def report(run: str, trials: tuple[str, ...], metric: str | None, out: Path | None, as_json: bool) -> None:
    """Write pictures (PNG) of trials of RUN: tracks in the room, coordinates and count over time."""
    from sonobench.harness import open_run

    written = open_run(run).report(trials=trials, metric=metric, out=out)
    emit([str(p) for p in written], "\n".join(map(str, written)), as_json)
