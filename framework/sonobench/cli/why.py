"""`sonobench why`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import click

from sonobench.cli.output import emit, json_option


@click.command()
@click.argument("trial")
@click.argument("run", required=False)
@json_option
def why(trial: str, run: str | None, as_json: bool) -> None:
    """Say what made TRIAL's key, what changed since, how it ended, and how to repeat it.

    TRIAL is the head of a trial_key, or PIPELINE/SCENE/REPETITION; RUN a folder or a name in runs/ (it may be left out
    where runs/ holds one run).
    """
    from sonobench.harness.run import open_run
    from sonobench.harness.why import explain

    found = explain(open_run(run or _only_run()).path, trial)
    emit(found, "\n".join(_text(found)), as_json)


def _only_run() -> str:
    from pathlib import Path

    from sonobench.errors import InputError
    from sonobench.harness.run import RUNS

    names = sorted(p.parent.name for p in Path(RUNS).glob("*/study.json"))
    if len(names) != 1:
        raise InputError(f"name a run; {RUNS}/ holds {', '.join(names) or 'none'}")
    return names[0]


def _text(found: Mapping[str, Any]) -> Iterator[str]:
    row, made_of = found["trial"], found["made_of"]
    yield f"trial {row['trial_key']}: {row['pipeline']} on {row['scene']}, repetition {row['repetition']}, run {row['run']}"
    limits = [f"{row[k]:g} {unit}" for k, unit in (("timeout_s", "s"), ("memory_mb", "MB")) if row.get(k)]
    yield f"  status     {row['status']}, attempt {row['attempts']}, limits {' and '.join(limits) or 'none'}"
    if found["failure"]:
        yield f"  exception  {row['exc_type']}: {row['exc_message']}"
    yield f"  verdict    {found['verdict']}"
    yield from _listed("  open       ", found["open_because"])
    yield "made of"
    yield f"  scene      {row['scene']}" + (f", seed {made_of['seed']}" if made_of["seed"] is not None else " (a file)")
    yield f"  recording  {row['recording_key']}, input_sha {row['input_sha'] or '(not rendered)'}"
    yield f"  pipeline   {row['pipeline']} ({row['distribution']} {row['version']}), table {row['pipeline_sha']}"
    for part, code in made_of["code"].items():
        versions = ", ".join([*(f"{k} {v}" for k, v in code.get("distributions", {}).items()), f"Python {code.get('python')}"])
        files = "".join(f", file {name}" for name, _ in code.get("files", ()))
        yield f"  {part.replace('_', ' ').ljust(10)} {len(code.get('modules', ()))} modules{files}; {versions}"
    yield f"  output     {row['estimate_key'] or '(none)'}"
    yield from _listed("  scores     ", [f"{label}: {state}" for label, state in found["scores"].items()])
    yield "changed since"
    yield from _listed("  ", found["changed"] or ["nothing"])
    if found["failure"] and found["failure"]["traceback"]:
        yield f"end of {found['failure']['log']}"
        yield from _listed("  ", found["failure"]["traceback"])
    if found["command"]:
        yield "repeat it alone, under a debugger if you like"
        yield f"  {found['command']}"


def _listed(head: str, lines: list[str]) -> Iterator[str]:
    for number, line in enumerate(lines):
        yield (head if number == 0 else " " * len(head)) + line
