"""Figures of one trial: tracks in the room, coordinates over time, count over time.

Truth is wide and coloured, estimates are small and dark.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sonobench.geometry import place
from sonobench.report.style import COLOURS, INK, figure, finish, labelled, named, safe_name, title, write_png
from sonobench.scoring import truth_coordinates
from sonobench.types import Array, Estimate, Header, Space, Truth

_MICROPHONE = "#7A4B00"
_SHOWN = ("x_m", "y_m", "z_m", "azimuth_rad", "elevation_rad")


def pictures(out_dir: str | Path, trial_name: str, header: Header, truth: Truth, estimates: Sequence[Estimate], space: Space) -> list[Path]:
    """Write a trial's PNGs: TRIAL-room.png, TRIAL-coordinates.png, TRIAL-count.png.

    Args:
        out_dir: an existing folder.
        trial_name: title, and head of the file names (what a file name cannot hold becomes "_").
        header, truth: of the recording.
        estimates: of the trial, in `space`; [] is an output without anybody.
        space: a tracker's coordinates; the picture of the room is left out where it has no x_m and y_m.

    Returns:
        The paths, in that order.

    Raises:
        InputError: the folder cannot be written.
    """
    kinds: dict[str, Callable[..., Any]] = {"room": _room, "coordinates": _coordinates, "count": _count}
    if not {"x_m", "y_m"} <= set(space.names):
        del kinds["room"]
    written = []
    for kind, draw in kinds.items():
        drawn = draw(header, truth, estimates, space)
        title(drawn, trial_name)
        written.append(write_png(drawn, Path(out_dir) / f"{safe_name(trial_name)}-{kind}.png"))
    return written


def scene_figure(header: Header, truth: Truth) -> Any:
    """The room's plan with microphones and true paths, without anybody's estimates."""
    return _room(header, truth, (), None)


def _room(header: Header, truth: Truth, estimates: Sequence[Estimate], space: Space | None) -> Any:
    """Plan view: walls, microphones, true paths, estimates; without a space no estimates are spoken of."""
    from matplotlib.patches import Rectangle

    microphones = _microphones(header)
    low, high = _ground(header, truth, microphones)
    width, height = high - low
    drawn = figure(9.4, float(np.clip(1.0 + 6.4 * height / width, 3.0, 10.0)), equal=True)
    axes = drawn.add_subplot()
    if header.box_m is not None:
        axes.add_patch(Rectangle(tuple(low), width, height, fill=False, ec=INK, lw=2, label="wall"))
    axes.set_xlim(low[0] - 0.03 * width, high[0] + 0.03 * width)
    axes.set_ylim(low[1] - 0.03 * height, high[1] + 0.03 * height)
    for n in range(len(truth.label)):
        x, y = (np.where(truth.exists[:, n], truth.position[:, n, i], np.nan) for i in (0, 1))
        _two_styles(axes, x, y, truth, n)
        lives = np.flatnonzero(truth.exists[:, n])
        for k, marker in zip(lives[[0, -1]] if len(lives) else (), "os", strict=False):
            axes.plot(x[k], y[k], marker, ms=9, mfc="white", mec=_colour(n), mew=2.5, zorder=5)
    for marker, word in (("o", "begins"), ("s", "ends")):
        axes.plot([], [], marker, ms=9, mfc="white", mec=INK, mew=2.5, label=word)
    if space is not None:
        _add_estimates(axes, _rows(estimates, space, ("x_m", "y_m"))[:, 1:], low, high, "room" if header.box_m is not None else "picture")
    if len(microphones):
        axes.plot(microphones[:, 0], microphones[:, 1], "^", ms=6, color=_MICROPHONE, mec="white", mew=0.5, label=_word(header), zorder=3)
    axes.set_aspect("equal")
    finish(axes, "x (m)", "y (m)")
    return drawn


def _add_estimates(axes: Any, path: Array, low: Array, high: Array, where: str) -> None:
    outside = int(((path < low) | (path > high)).any(axis=1).sum())
    axes.plot(path[:, 0], path[:, 1], ".", ms=4, color=INK, alpha=0.6)
    axes.plot([], [], ".", ms=6, color=INK, label="estimates" + (f" ({outside} outside the {where})" if outside else ""))


def _coordinates(header: Header, truth: Truth, estimates: Sequence[Estimate], space: Space) -> Any:
    """One panel for each coordinate that truth and estimates share."""
    known = truth_coordinates(truth)
    names = [n for n in _SHOWN if n in known and n in space.names] or [n for n in ("x_m", "y_m") if n in known]
    drawn = figure(10.0, 0.8 + 2.3 * len(names))
    panels = drawn.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for axes, name in zip(panels, names, strict=True):
        for n in range(len(truth.label)):
            _two_styles(axes, truth.time_s, np.where(truth.exists[:, n], known[name][:, n], np.nan), truth, n)
        if name in space.names:
            axes.plot(*_rows(estimates, space, (name,)).T, ".", ms=4, color=INK, alpha=0.7)
        axes.plot([], [], ".", ms=6, color=INK, label="estimates")
        finish(axes, "time (s)" if axes is panels[-1] else "", labelled(*named(name)), legend=axes is panels[0])
        _limits(axes, header, name)
    panels[-1].set_xlim(_span(header, truth))
    return drawn


def _count(header: Header, truth: Truth, estimates: Sequence[Estimate], space: Space) -> Any:
    """How many targets exist and sound, and how many are reported."""
    drawn = figure(10.0, 3.2)
    axes = drawn.add_subplot()
    time_s = [e.time_s for e in estimates]
    axes.step(truth.time_s, truth.exists.sum(axis=1), where="post", color=COLOURS[0], lw=4, alpha=0.6, label="exist")
    axes.step(truth.time_s, truth.active.sum(axis=1), where="post", color=COLOURS[1], lw=2, label="sound")
    axes.step(time_s, [len(e.states) for e in estimates], where="post", color=INK, lw=1, label="estimates")
    expected = [(e.time_s, e.count) for e in estimates if e.count is not None]
    if expected:
        axes.plot(*zip(*expected, strict=True), color=COLOURS[2], lw=1, ls="--", label="expected number")
    axes.yaxis.get_major_locator().set_params(integer=True)
    axes.set_ylim(bottom=-0.2)
    axes.set_xlim(_span(header, truth))
    finish(axes, "time (s)", "targets (1)")
    return drawn


def _two_styles(axes: Any, x: Array, y: Array, truth: Truth, n: int) -> None:
    """The true path of target n: dotted throughout, wide where it sounds."""
    active = truth.active[:, n]
    if n == 0:
        axes.plot([], [], ":", lw=1.5, color=INK, label="path; thick: it sounds")
    axes.plot(x, y, ":", lw=1.5, color=_colour(n))
    sounding = (np.where(active, x, np.nan), np.where(active, y, np.nan))
    axes.plot(*sounding, "-", lw=5, alpha=0.55, color=_colour(n), label=f"target {truth.label[n]}")


def _rows(estimates: Sequence[Estimate], space: Space, names: tuple[str, ...]) -> Array:
    """(rows, 1 + names) time and coordinates of every estimated state."""
    columns = space.index(*names)
    rows = [np.column_stack([np.full(len(e.states), e.time_s), e.states[:, columns]]) for e in estimates]
    return np.concatenate([np.zeros((0, 1 + len(names))), *rows])


def _ground(header: Header, truth: Truth, microphones: Array) -> tuple[Array, Array]:
    """Lower and upper corner (2,) of the plan: the room's, else a metre around targets and microphones."""
    if header.box_m is not None:
        return header.box_m[0, :2], header.box_m[1, :2]
    points = np.concatenate([truth.position[truth.exists][:, :2], microphones[:, :2]])
    points = points if len(points) else np.zeros((1, 2))
    return points.min(axis=0) - 1.0, points.max(axis=0) + 1.0


def _word(header: Header) -> str:
    return "vector sensors" if header.arrays and all(a.kind == "avs" for a in header.arrays) else "microphones"


def _microphones(header: Header) -> Array:
    """All elements (m, 3) in the room, of arrays or else of recorded sensors."""
    poses = dict(zip(header.array_names, header.poses, strict=True))
    units = [(a.name, a.elements) for a in header.arrays] or [(s.array, s.elements) for s in header.sensors]
    placed = [place(poses[name], elements) for name, elements in units if name in poses]
    return np.unique(np.concatenate([np.zeros((0, 3)), *placed]), axis=0)


def _limits(axes: Any, header: Header, name: str) -> None:
    """A coordinate's axis spans the room, so that one stray estimate does not flatten the rest."""
    if header.box_m is not None and name in _SHOWN[:3]:
        low, high = header.box_m[:, _SHOWN.index(name)]
        axes.set_ylim(low - 0.03 * (high - low), high + 0.03 * (high - low))


def _span(header: Header, truth: Truth) -> tuple[float, float]:
    end = header.start_s + header.duration_s
    return (header.start_s, end) if header.duration_s > 0 else (float(truth.time_s[0]), float(truth.time_s[-1]))


def _colour(n: int) -> str:
    return COLOURS[n % len(COLOURS)]
