"""The command line: thin verbs that parse, call and print.

Exit codes: 0 done, 1 internal error, 2 usage or input error, 3 done with failed or unavailable trials, 130 interrupted.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of `sonobench`; always ends in SystemExit."""
    import click

    from sonobench.cli.app import app
    from sonobench.errors import SonobenchError

    try:
        code = app.main(args=None if arguments is None else list(arguments), prog_name="sonobench", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        code = 2
    except SonobenchError as error:
        click.echo(f"error: {error}", err=True)
        code = 2
    except (KeyboardInterrupt, click.Abort):
        click.echo("interrupted; what was finished is kept", err=True)
        code = 130
    except BrokenPipeError:
        sys.stderr.close()
        code = 0
    except Exception as error:
        import traceback

        from sonobench.files import no_room

        if no_room(error):
            click.echo(f"error: {error}; what was finished is kept: make room and start again", err=True)
            code = 2
        else:
            click.echo(f"internal error (please report it):\n{traceback.format_exc()}", err=True)
            code = 1
    raise SystemExit(code if isinstance(code, int) else 0)
