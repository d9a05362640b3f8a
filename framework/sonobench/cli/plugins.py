"""`sonobench plugins`: what is registered, and whether it is fit."""

from __future__ import annotations

from pathlib import Path

import click

from sonobench.cli.output import columns, emit, json_option, plugin_option


@click.group()
def plugins() -> None:
    """List, show and check plugins."""


@plugins.command("list")
@click.option("--role", help="Only this role.")
@plugin_option
@json_option
def list_(role: str | None, plugins: tuple[str, ...], as_json: bool) -> None:
    """Every component with its role, distribution, version and status."""
    from sonobench.registry import Registry

    _known(role)
    registry = Registry.load(plugins, strict=False)
    rows = [
        {"role": e.role, "name": e.name, "distribution": e.plugin.distribution, "version": e.plugin.version, "status": registry.status(e)}
        for e in registry.entries(role)
    ]
    rows += [
        {"role": "-", "name": p.name, "distribution": p.distribution, "version": p.version, "status": f"unavailable: {p.reason}"}
        for p in registry.plugins
        if p.reason
    ]
    emit(rows, columns(rows, ["role", "name", "distribution", "version", "status"]), as_json)


@plugins.command()
@click.argument("name")
@click.option("--role", help="Where several roles use the name.")
@plugin_option
@json_option
def show(name: str, role: str | None, plugins: tuple[str, ...], as_json: bool) -> None:
    """Parameters of NAME with types, units and defaults, and the paper it comes from."""
    from sonobench.describe import describe, describe_text
    from sonobench.errors import PluginError
    from sonobench.protocols import ROLES
    from sonobench.registry import Registry, did_you_mean

    _known(role)
    registry = Registry.load(plugins)
    bare = name.rpartition(":")[2]
    roles = [r for r in ROLES if role in (None, r) and any(e.name == bare for e in registry.entries(r))]
    if not roles:
        names = {e.name for e in registry.entries(role)}
        where = "nothing" if role is None else f"no {role}"
        raise PluginError(f"{where} is registered as {name!r}{did_you_mean(bare, names) or '; `sonobench plugins list` shows what is'}")
    found = [describe(registry.entry(r, name), registry) for r in roles]
    emit(found, "\n\n".join(map(describe_text, found)), as_json)


@plugins.command()
@click.argument("file", type=click.Path(path_type=Path))
@json_option
def check(file: Path, as_json: bool) -> int:
    """Put every component of a plugin FILE through the conformance kit."""
    rows = _findings(file)
    emit(rows, columns(rows, ["component", "check", "result", "sentence"]), as_json)
    return 3 if any(row["result"] == "failed" for row in rows) else 0


def _findings(file: Path) -> list[dict[str, str]]:
    """The kit's findings, from a process of its own: a plugin may end the one that it runs in."""
    import json
    import subprocess
    import sys

    from sonobench.errors import PluginError

    done = subprocess.run([sys.executable, "-m", "sonobench.testing", str(file)], stdout=subprocess.PIPE, text=True, check=False)
    try:
        answer = json.loads(done.stdout.rstrip().rpartition("\n")[2])
    except ValueError:
        answer = None
    if not isinstance(answer, dict) or not answer.keys() & {"error", "findings"}:
        sentence = f"it ended the process before all checks were done, exit code {done.returncode}"
        return [{"component": str(file), "check": "survives", "result": "failed", "sentence": sentence}]
    if "error" in answer:
        raise PluginError(answer["error"])
    found: list[dict[str, str]] = answer["findings"]
    return found


def _known(role: str | None) -> None:
    from sonobench.errors import InputError
    from sonobench.protocols import ROLES
    from sonobench.registry import did_you_mean

    if role is not None and role not in ROLES:
        raise InputError(f"--role {role}: no such role{did_you_mean(role, ROLES)}; there are {sorted(ROLES)}")
