"""The picture of a scene, or of a recording, without any run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sonobench.report.figures import scene_figure
from sonobench.report.style import title, write_png
from sonobench.types import Header, MicArray, Truth

if TYPE_CHECKING:
    from sonobench.log import Recording
    from sonobench.scene import Scene


def draw_scene(what: Scene | Recording, out: str | Path) -> Path:
    """Write a PNG of room, microphones and true paths.

    Args:
        what: a scene, of which nothing is rendered (so its talkers sound throughout their intervals), or a recording.
        out: the file.

    Raises:
        InputError: the folder is missing or cannot be written.
    """
    from sonobench.log import Recording

    header, truth = (what.header, what.truth) if isinstance(what, Recording) else _laid_out(what)
    drawn = scene_figure(header, truth)
    title(drawn, header.name)
    return write_png(drawn, Path(out))


def _laid_out(scene: Scene) -> tuple[Header, Truth]:
    from sonobench.scene.render import box_of
    from sonobench.scene.truth import truth_of

    header = Header(
        name=scene.name or "scene",
        arrays=tuple(MicArray(n, a.kind, a.elements_m, scene.rate_of(n), a.pairs) for n, a in scene.arrays.items()),
        poses=np.stack([a.pose for a in scene.arrays.values()]),
        duration_s=scene.duration_s,
        c_m_s=scene.c_m_s,
        box_m=box_of(scene)[0],
    )
    return header, truth_of(scene)
