"""What verbs share: options, tables of text, JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])


def json_option(verb: F) -> F:
    """`--json`: the same content as machine-readable JSON on stdout."""
    return click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")(verb)


def plugin_option(verb: F) -> F:
    """`--plugin FILE`, repeatable."""
    return click.option("--plugin", "plugins", multiple=True, type=click.Path(), metavar="FILE", help="Load a plugin file; repeatable.")(
        verb
    )


def emit(content: Any, text: str, as_json: bool) -> None:
    """Print the content as JSON, or the text."""
    click.echo(json.dumps(content, indent=2, default=_plain) if as_json else text)


def columns(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> str:
    """Rows as aligned text under their column names."""
    cells = [list(names), *[["" if row.get(n) is None else str(row[n]) for n in names] for row in rows]]
    widths = [max(len(r[i]) for r in cells) for i in range(len(names))]
    return "\n".join("  ".join(c.ljust(w) for c, w in zip(r, widths, strict=True)).rstrip() for r in cells)


def open_named(recording: str, registry: Any) -> Any:
    """The recording of a path that ends in .mcap, or a shipped one by name."""
    from sonobench.errors import InputError
    from sonobench.log import open_recording

    if recording.endswith(".mcap"):
        return open_recording(recording)
    if Path(recording).exists():
        raise InputError(f"{recording}: a recording's file ends in .mcap")
    return open_recording(registry.find_data("recordings", recording, ".mcap"))


def recording_path(out: Path) -> Path:
    """Where a recording or estimates shall be written, judged before the work is done.

    Raises:
        InputError: it does not end in .mcap (no verb would read it again), or its folder is missing.
    """
    from sonobench.errors import InputError

    if out.suffix != ".mcap":
        raise InputError(f"{out}: the file's name must end in .mcap")
    if not out.absolute().parent.is_dir():
        raise InputError(f"{out}: the folder {out.parent} is missing; make it first")
    return out


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return dict(value)
    return value.tolist() if hasattr(value, "tolist") else str(value)


class _Share(click.ParamType):
    name = "share"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """ "2%" or "0.02"."""
        text = str(value).strip()
        try:
            share = float(text.removesuffix("%")) / (100 if text.endswith("%") else 1)
        except ValueError:
            share = 0.0
        if not 0 < share <= 1:
            self.fail(f"{value!r} is no share of the trials; write 2% or 0.02", param, ctx)
        return share


SHARE = _Share()  #: a share of something: "2%" or "0.02"


def emit_verified(verified: Any) -> None:
    """What a verification found, on stderr."""
    if verified.findings:
        click.echo(columns(verified.findings, ["trial_key", "pipeline", "scene", "repetition", "fault"]), err=True)
    click.echo(str(verified), err=True)
