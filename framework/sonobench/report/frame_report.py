"""Pictures of single frames: each pair's correlation, the rows that the front end picked, and the delays that the sources have.

The front end runs again on the trial's recording. A tracker's measurement model says which delays a source has (direct and
echoes, its modes); without one they are the direct delays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sonobench.errors import InputError
from sonobench.geometry import sensor_delays
from sonobench.report.recordings import Recordings
from sonobench.report.run_report import asked, made, place_words
from sonobench.report.style import COLOURS, INK, figure, finish, safe_name, title, write_png
from sonobench.types import Array, DelayTable, Scan, Setup, Space, Truth

if TYPE_CHECKING:
    from sonobench.harness.run import Run

Modes = Mapping[int, Array]  # by a source's label: its delays (L,) s, the direct one first


def write_frames(run: Run, times_s: Sequence[float], trials: Sequence[str] = (), out: str | Path | None = None) -> list[Path]:
    """Write a picture of the frame nearest to each time.

    Args:
        run: as far as it came; its trials may end at their scans.
        times_s: of the recording.
        trials: heads of trial keys; by default each pipeline's first trial that went well.
        out: folder of the pictures; by default `report` in the run's folder.

    Returns:
        The pictures' paths.

    Raises:
        InputError: no such trial, its recording or pipeline cannot be had any more, or it has no sensor of a single pair.
    """
    from sonobench.pipeline import scans_of

    rows = run.trials.set_index("trial_key", drop=False)
    done = run.trials[run.trials["status"] == "ok"].drop_duplicates("pipeline")
    keys = list(asked(run, trials)) if trials else [str(k) for k in done["trial_key"]]
    if not keys:
        raise InputError(f"{run.path}: no trial went well; the causes stand in `sonobench run` and in {run.path / 'logs'}")
    folder = made(run.path / "report" if out is None else Path(out))
    written: list[Path] = []
    recordings = Recordings(run)
    for key in keys:
        row = {str(k): v for k, v in rows.loc[key].items()}
        pipeline, recording = recordings.pipeline(row), recordings.of(row)
        setup, scans = scans_of(pipeline.front_end, recording, pipeline.given)
        pairs = [q for q, unit in enumerate(setup.sensors) if unit.kind == "tdoa" and len(unit.space) == 1]
        if not pairs or not scans:
            raise InputError(
                f"trial {key} ({row['pipeline']}): frames are drawn of scans of single pairs, as `gcc-peaks` makes them; it has none"
            )
        for time_s in times_s:
            scan = min(scans, key=lambda s: abs(s.time_s - time_s))
            name = " ".join([str(row["pipeline"]), *place_words(row), f"rep {row['repetition']}", key[:8], f"{scan.time_s:.3f} s"])
            drawn = frame_figure(scan, setup, {q: modes_of(pipeline.tracker, recording.truth, setup, scan, q) for q in pairs})
            title(drawn, name)
            written.append(write_png(drawn, folder / f"{safe_name(name)}-frame.png"))
    return written


def modes_of(tracker: Any, truth: Truth, setup: Setup, scan: Scan, q: int) -> Modes:
    """Delays at a pair, by label, of the sources that sound when a scan was heard."""
    k = int(np.argmin(np.abs(truth.time_s - scan.time_s)))
    who = np.flatnonzero(truth.active[k])
    points = np.array([[np.interp(scan.time_s, truth.time_s, truth.position[:, n, axis]) for axis in range(3)] for n in who]).reshape(-1, 3)
    measurement = getattr(tracker, "measurement", None) or getattr(getattr(tracker, "likelihood", None), "measurement", None)
    delays = sensor_delays(points, setup, q)[..., :1]
    if measurement is not None:
        bound = measurement.bind(tracker.space, setup)
        if q in bound.sensors:
            delays = bound.h(_states(points, tracker.space), q)[..., 0]
    return {int(truth.label[n]): own for n, own in zip(who, delays, strict=True)}


def _states(points: Array, space: Space) -> Array:
    """States (n, d) at places (n, 3), at rest."""
    x = np.zeros((len(points), len(space)))
    for axis, name in enumerate(("x_m", "y_m", "z_m")):
        if name in space.names:
            x[:, space.index(name)[0]] = points[:, axis]
    return x


def frame_figure(scan: Scan, setup: Setup, modes: Mapping[int, Modes]) -> Any:
    """A panel for each pair among `modes`: its correlation, picked rows, and the sources' delays (direct full, echoes dashed)."""
    drawn = figure(10.0, 0.9 + 2.1 * len(modes))
    panels = drawn.subplots(len(modes), 1, squeeze=False)[:, 0]
    table = scan.fields.get("gcc")
    for axes, q in zip(panels, modes, strict=True):
        if isinstance(table, DelayTable):
            delay_s = table.start_s + table.step_s * np.arange(table.values.shape[1])
            axes.plot(1e3 * delay_s, table.values[q], color=INK, lw=0.9, label="correlation")
            axes.set_xlim(1e3 * delay_s[0], 1e3 * delay_s[-1])
        _add_modes(axes, modes[q])
        _add_rows(axes, scan, q, table)
        silent = "" if scan.searched[q] else ", not searched"
        finish(axes, "delay (ms)" if axes is panels[-1] else "", f"{setup.sensors[q].name}{silent}", legend=axes is panels[0])
    return drawn


def _add_modes(axes: Any, modes: Modes) -> None:
    for k, (label, delays) in enumerate(modes.items()):
        colour = COLOURS[k % len(COLOURS)]
        for mode, delay_s in enumerate(delays):
            word = {0: f"target {label}", 1: f"target {label}, echoes"}.get(mode)
            axes.axvline(
                1e3 * delay_s, color=colour, lw=2.5 if mode == 0 else 1.5, ls="--" if mode else "-", alpha=0.75, zorder=1, label=word
            )


def _add_rows(axes: Any, scan: Scan, q: int, table: Any) -> None:
    """Picked rows at their scores; where they have none, on the curve."""
    for group in scan.detections:
        own = np.flatnonzero(group.sensor == q)
        z = group.z[own, 0]
        on_curve = table.at(z[:, None], np.full(len(own), q)) if isinstance(table, DelayTable) else np.zeros(len(own))
        axes.plot(1e3 * z, on_curve if group.score is None else group.score[own], "o", ms=6, mfc="white", mec=INK, mew=1.5, label="picked")
