"""`sonobench data`: scenes, recordings and what else is shipped."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from sonobench.cli.output import columns, emit, json_option, plugin_option


@click.group()
def data() -> None:
    """List, make, describe and validate scenes and recordings."""


_KINDS = {
    "scenes": (".toml",),
    "studies": (".toml",),
    "pipelines": (".toml",),
    "reference": (".toml",),
    "clips": (".flac", ".wav"),
    "recordings": (".mcap",),
}


@data.command("list")
@plugin_option
@json_option
def list_(plugins: tuple[str, ...], as_json: bool) -> None:
    """Everything that installed plugins ship, by kind and name."""
    from sonobench.registry import Registry

    registry = Registry.load(plugins)
    rows = [
        {"kind": kind, "name": name, "distribution": plugin.distribution}
        for kind, suffixes in _KINDS.items()
        for suffix in suffixes
        for name, found in sorted(registry.data_files(kind, suffix).items())
        for plugin, _ in found
    ]
    emit(rows, columns(rows, ["kind", "name", "distribution"]), as_json)


@data.command()
@click.argument("scene")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Noise, sounds and measurements are drawn from it.")
@click.option("-o", "--out", type=click.Path(path_type=Path, dir_okay=False), required=True, help="The .mcap file to write.")
@plugin_option
@json_option
def make(scene: str, seed: int, out: Path, plugins: tuple[str, ...], as_json: bool) -> None:
    """Render SCENE (a name or a .toml file) to a recording."""
    from sonobench.cli.output import recording_path
    from sonobench.log import open_recording, write_recording
    from sonobench.registry import Registry
    from sonobench.scene import Scene

    recording_path(out)
    rendering = Scene.load(scene, Registry.load(plugins)).simulate(seed)
    write_recording(out, rendering)
    described = _described(open_recording(out))
    emit(described, _text(described), as_json)


@data.command()
@click.argument("recording", metavar="FILE")
@plugin_option
@json_option
def info(recording: str, plugins: tuple[str, ...], as_json: bool) -> None:
    """Describe a recording (FILE.mcap, or the name of a shipped one); reads no samples."""
    from sonobench.cli.output import open_named
    from sonobench.registry import Registry

    described = _described(open_named(recording, Registry.load(plugins)), hashes=False)
    emit(described, _text(described), as_json)


@data.command()
@click.argument("scene", metavar="SCENE|FILE.mcap")
@click.option("-o", "--out", type=click.Path(path_type=Path, dir_okay=False), required=True, help="The .png file to write.")
@plugin_option
def draw(scene: str, out: Path, plugins: tuple[str, ...]) -> None:
    """Draw a scene (a name or a .toml file) or a recording: room, microphones, true paths; renders nothing."""
    from sonobench.errors import InputError
    from sonobench.log import open_recording
    from sonobench.registry import Registry
    from sonobench.report import draw_scene
    from sonobench.scene import Scene

    if out.suffix != ".png":
        raise InputError(f"{out}: the file's name must end in .png")
    registry = Registry.load(plugins)
    click.echo(draw_scene(open_recording(scene) if scene.endswith(".mcap") else Scene.load(scene, registry), out))


@data.command()
@click.argument("file", type=click.Path(path_type=Path))
@plugin_option
@json_option
def validate(file: Path, plugins: tuple[str, ...], as_json: bool) -> None:
    """Read a recording (.mcap), a scene, a study or a reference (.toml) to its end and report the first fault, or all faults of a table."""
    from sonobench.errors import InputError
    from sonobench.log import open_recording

    if file.suffix == ".toml":
        described = _validated_table(file, plugins)
    elif file.suffix == ".mcap":
        recording = open_recording(file)
        described = _described(recording)
        described["sample_blocks"] = sum(1 for _ in recording.blocks())
        described["scans"] = sum(1 for _ in recording.scans())
    else:
        raise InputError(f"{file}: a recording ends in .mcap, a scene, study or reference in .toml")
    emit({**described, "valid": True}, _text(described) + "\nvalid", as_json)


def _validated_table(file: Path, plugins: tuple[str, ...]) -> dict[str, Any]:
    from sonobench.registry import Registry
    from sonobench.scene import Scene, Study
    from sonobench.scene.reference import Reference
    from sonobench.tables import read_toml

    table = read_toml(file)
    if "citation" in table:
        reference = Reference.load(str(file), Registry.load(plugins))
        return {"reference": reference.name, "citation": reference.citation, "tables": [t.table for t in reference.tables]}
    if "pipelines" in table:
        study = Study.load(str(file), plugins=plugins)
        return {"study": str(file), "trials": len(study.plan())}
    scene = Scene.load(str(file), Registry.load(plugins))
    scene.check_sounds()
    return {"scene": scene.name, "duration_s": scene.duration_s}


def _described(recording: Any, hashes: bool = True) -> dict[str, Any]:
    header, truth = recording.header, recording.truth
    described: dict[str, Any] = {
        "name": header.name,
        "duration_s": header.duration_s,
        "arrays": [f"{a.name}: {len(a.elements)} {a.kind}, {len(a.pairs)} pairs, {a.rate_hz:g} Hz" for a in header.arrays],
        "sensors": [f"{s.name}: {s.kind}, {len(s.space)} components" for s in header.sensors],
        "room_m": None if header.box_m is None else (header.box_m[1] - header.box_m[0]).tolist(),
        "speed_of_sound_m_s": header.c_m_s,
        "nominal": dict(header.nominal),
        "given": sorted(header.given),
        "targets": len(truth.label),
        "evaluation_times": len(truth.time_s),
    }
    if hashes:
        described |= {"input_sha": recording.input_sha, "truth_sha": recording.truth_sha, "content_sha": recording.content_sha}
    return described


def _text(described: dict[str, Any]) -> str:
    width = max(map(len, described))
    return "\n".join(f"{k.ljust(width)}  {_value(v)}" for k, v in described.items() if v not in (None, [], {}))


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k} = {v:g}" for k, v in value.items())
    return "; ".join(map(str, value)) if isinstance(value, list) else str(value)
