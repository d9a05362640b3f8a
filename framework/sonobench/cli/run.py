"""`sonobench run` and `sonobench replay`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from sonobench.cli.output import SHARE, columns, emit, emit_verified, json_option, plugin_option


def _shard(_context: Any, _parameter: Any, value: str | None) -> tuple[int, int] | None:
    if value is None:
        return None
    parts = value.split("/")
    if len(parts) != 2 or not all(p.isdecimal() for p in parts):
        raise click.BadParameter(f"{value!r}: write 1/4 for the first of four parts")
    return int(parts[0]), int(parts[1])


@click.command()
@click.argument("study")
@click.option("--also", multiple=True, metavar="PIPELINE", help="Add a pipeline by name; repeatable.")
@click.option("--only", multiple=True, metavar="PIPELINE", help="Run only this pipeline; repeatable.")
@click.option("--trial", "trials", multiple=True, metavar="KEY", help="Run only this trial (head of its key); repeatable.")
@click.option(
    "--shard", callback=_shard, metavar="K/N", help="Run the K-th of N parts, by recording, into a folder of its own (STUDY-KofN)."
)
@click.option("--repetitions", type=click.IntRange(min=1), help="Renderings a scene.")
@click.option("--seed", type=click.IntRange(min=0), help="The study's seed.")
@click.option("--jobs", type=click.IntRange(min=1), envvar="SONOBENCH_JOBS", help="Worker processes; default: the processors.")
@click.option(
    "--timeout", "timeout_s", type=click.FloatRange(min=0, min_open=True), envvar="SONOBENCH_TIMEOUT", help="Seconds a trial may take."
)
@click.option(
    "--memory", "memory_mb", type=click.FloatRange(min=0, min_open=True), envvar="SONOBENCH_MEMORY", help="MB that a trial may hold."
)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="The run's folder; default: runs/STUDY.")
@click.option("--fresh", is_flag=True, help="Repeat what is already there.")
@click.option("--retry", type=click.Choice(["failed"]), help="Run failed trials again, though their code is unchanged.")
@click.option("--in-process", is_flag=True, help="No worker processes: for debuggers; no isolation and no limits.")
@click.option(
    "--engine", type=click.Choice(["local", "dask"]), default="local", show_default=True, help="dask: a cluster of --jobs workers."
)
@click.option("--scheduler", metavar="ADDRESS", help="Join this Dask scheduler (tcp://host:8786); implies --engine dask.")
@click.option(
    "--verify",
    "share",
    type=SHARE,
    metavar="SHARE",
    help="Afterwards repeat this share of the trials (2%) from nothing and compare; 3 if they differ.",
)
@click.option("--dry-run", is_flag=True, help="Print the planned trials, what of them is there, and a guess of the time; run nothing.")
@plugin_option
@json_option
def run(study: str, plugins: tuple[str, ...], as_json: bool, dry_run: bool, share: float | None, **options: Any) -> int:
    """Execute STUDY (a name or a .toml file) and print its board."""
    from sonobench.scene import Study

    selection = {k: options.pop(k) for k in ("also", "only", "repetitions", "seed")}
    loaded = Study.load(study, plugins=plugins, **selection)
    if dry_run:
        _print_plan(loaded, options, as_json)
        return 0
    finished = loaded.run(**options)
    if share is None:
        _print_boards(finished, as_json)
        return 3 if finished.failed else 0
    from sonobench.harness.verify import verify_trials

    verified = verify_trials(loaded, finished.path, share, options["jobs"])
    _print_boards(finished, as_json, verified.to_table())
    emit_verified(verified)
    return 3 if finished.failed or verified.findings else 0


def _print_plan(study: Any, options: dict[str, Any], as_json: bool) -> None:
    from dataclasses import asdict

    from sonobench.harness.cell import Limits
    from sonobench.harness.forecast import forecast
    from sonobench.harness.local import processors
    from sonobench.harness.run import chosen, folder_of

    plan = chosen(study, options["trials"], options["shard"])
    folder = folder_of(study, plan if options["trials"] else None, options["shard"], options["out"])
    limits = Limits(options["timeout_s"], options["memory_mb"])
    told = forecast(plan, folder, options["jobs"] or processors(), limits, options["retry"] == "failed", options["fresh"])
    rows = [{"pipeline": t.pipeline, "scene": t.scene, "repetition": t.repetition, "run": t.run, "trial_key": t.trial_key} for t in plan]
    table = columns(rows, ["pipeline", "scene", "repetition", "run", "trial_key"])
    emit({"run": str(folder), "trials": rows, "forecast": asdict(told)}, f"{table}\n\n{told}\nrun folder: {folder}", as_json)


def _print_boards(finished: Any, as_json: bool, verified: dict[str, Any] | None = None) -> None:
    from sonobench.board import render

    scored = [m for m in finished.metrics if (finished.scores["metric"] == m).any()]
    if as_json:
        import json

        boards = {m: json.loads(render(finished.board(m), "json")) for m in scored}
        content = {"run": str(finished.path), "failed": finished.failed, "boards": boards, "failures": _failures(finished)}
        emit(content | ({} if verified is None else {"verified": verified}), "", True)
        return
    click.echo(
        render(finished.board(scored[0], also=scored[1:]), "text")
        if scored
        else f"no board: none of {len(finished.trials)} trials has a score."
    )
    more = f"   (sonobench board {finished.path} --metric NAME, with NAME one of {', '.join(scored)})" if scored else ""
    click.echo(f"\nrun folder: {finished.path}{more}")
    failures = _failures(finished)
    if failures:
        click.echo(columns(failures, ["pipeline", "status", "trials", "such as", "message"]), err=True)
        click.echo(f"what they printed: {finished.path / 'logs'}", err=True)


def _failures(finished: Any) -> list[dict[str, Any]]:
    """One row for each way in which a pipeline's trials failed, with how many and the first of them."""
    found: dict[tuple[str, str, str], dict[str, Any]] = {}
    for row in finished.trials[finished.trials["status"] != "ok"].itertuples():
        message = " ".join(str(row.exc_message or "").split())[:200]
        first = {
            "pipeline": row.pipeline,
            "status": row.status,
            "trials": 0,
            "such as": f"{row.scene} rep {row.repetition}",
            "message": message,
        }
        found.setdefault((row.pipeline, row.status, message), first)["trials"] += 1
    return list(found.values())


@click.command()
@click.argument("recording", metavar="FILE")
@click.option("--pipeline", required=True, help="A registered pipeline.")
@click.option("--run", "run_number", type=click.IntRange(min=0), default=0, show_default=True, help="Which random numbers a tracker draws.")
@click.option("-o", "--out", type=click.Path(path_type=Path, dir_okay=False), help="Write the estimates to this .mcap file.")
@plugin_option
@json_option
def replay(recording: str, pipeline: str, run_number: int, out: Path | None, plugins: tuple[str, ...], as_json: bool) -> int:
    """Replay a recording (FILE.mcap, or the name of a shipped one) through a pipeline; the same estimates, bit for bit, everywhere."""
    import time
    import traceback

    from sonobench.cli.output import open_named, recording_path
    from sonobench.components import build, identity
    from sonobench.errors import SonobenchError
    from sonobench.log import estimates_sha, write_estimates
    from sonobench.pipeline import replay as replay_recording
    from sonobench.registry import Registry

    if out is not None:
        recording_path(out)
    registry = Registry.load(plugins)
    built = build("pipeline", pipeline, registry, "--pipeline")
    opened = open_named(recording, registry)
    begin = time.perf_counter()
    try:
        estimates = replay_recording(built, opened, run_number)
    except SonobenchError:
        raise
    except Exception as error:  # the pipeline's own code may raise anything: a failed trial, as in a run
        click.echo(f"{traceback.format_exc()}\nerror: pipeline {pipeline} failed on {recording}: {type(error).__name__}: {error}", err=True)
        return 3
    elapsed_s = time.perf_counter() - begin
    meta = {
        "pipeline": pipeline,
        "pipeline_sha": identity(built, registry, "pipeline"),
        "input_sha": opened.input_sha,
        "run": run_number,
    }
    if out is not None:
        write_estimates(out, estimates, built.tracker.space, meta)
    counts = [len(e.states) for e in estimates]
    content = {
        **meta,
        "estimates": len(estimates),
        "mean_count": sum(counts) / max(len(counts), 1),
        "estimates_sha": estimates_sha(estimates, built.tracker.space),
        "seconds": round(elapsed_s, 3),
        "times_real_time": round(opened.header.duration_s / elapsed_s, 1),
        "out": None if out is None else str(out),
    }
    emit(content, "\n".join(f"{k.ljust(16)} {v}" for k, v in content.items() if v is not None), as_json)
    return 0
