"""`sonobench board`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from sonobench.cli.output import emit_verified, json_option

if TYPE_CHECKING:
    from sonobench.harness import Run


@click.command()
@click.argument("runs", nargs=-1, required=True, metavar="RUN...")
@click.option("--metric", "metrics", multiple=True, help="Which board; repeatable; default: the study's first metric.")
@click.option(
    "--with",
    "also",
    multiple=True,
    metavar="METRIC",
    help="Add a column with the mean of another metric; with median:METRIC, the median over trials; repeatable.",
)
@click.option("--by", help="One board a value of this column, such as a swept parameter (any unique suffix).")
@click.option("--vs", help="Show differences against this pipeline; with --attribute, only swaps of its component.")
@click.option(
    "--reference", "references", multiple=True, metavar="NAME", help="Put published numbers beside the measured ones; repeatable."
)
@click.option(
    "--attribute", "role", metavar="ROLE", help="What swapping this component (delay, tracker, ...) is worth, instead of a board."
)
@click.option("--verify", is_flag=True, help="First compute every score again from the stored estimates; exit code 3 if one differs.")
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
    references: tuple[str, ...],
    role: str | None,
    format_: str,
    out: Path | None,
    as_json: bool,
    verify: bool,
) -> int:
    """Print the leaderboard of RUN (a folder, or a name in runs/); of several RUNs as one, such as shards of a study.

    With several metrics JSON is a list of boards, and CSV and Parquet have a column `metric`.
    """
    from sonobench.board import render
    from sonobench.errors import InputError
    from sonobench.harness import open_run

    format_ = "json" if as_json else format_
    if role is not None and (also or references):
        raise InputError("--attribute prints swaps of components; --with and --reference belong to a leaderboard")
    if format_ == "parquet" and out is None:
        raise InputError("--format parquet is binary; name a file with -o")
    opened = open_run(*runs)
    code = _verified(opened) if verify else 0
    wanted = metrics or opened.metrics[:1] or (None,)
    if role is not None:
        boards = [opened.attribution(role, m, by, vs) for m in wanted]
    else:
        boards = [opened.board(m, by=by, vs=vs, also=also, references=references) for m in wanted]
    content = render(boards[0] if len(boards) == 1 else boards, format_)
    if out is None:
        click.echo(content)
        return code
    from sonobench.files import replace_file

    replace_file(out, content if isinstance(content, bytes) else content.encode() + b"\n")
    return code


def _verified(opened: Run) -> int:
    from sonobench.harness.verify import verify_scores

    found = [verify_scores(path) for path in opened.paths]
    for each in found:
        emit_verified(each)
    return 3 if any(each.findings for each in found) else 0
