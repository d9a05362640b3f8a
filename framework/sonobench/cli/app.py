"""The verbs, put together; only click is imported before a verb runs."""

from __future__ import annotations

import click

from sonobench.cli.board import board
from sonobench.cli.data import data
from sonobench.cli.plugins import plugins
from sonobench.cli.report import report
from sonobench.cli.run import replay, run
from sonobench.cli.why import why


class _InOrder(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)


@click.group(cls=_InOrder, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="sonobench")
def app() -> None:
    """Evaluate acoustic tracking algorithms: recordings in, a leaderboard out.

    Start with `sonobench run quickstart`.
    """


for _verb in (run, board, report, why, replay, data, plugins):
    app.add_command(_verb)
