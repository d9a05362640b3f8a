"""Image-method rooms with moving sources.

Source: Allen & Berkley 1979, "Image method for efficiently simulating small-room acoustics". The images are enumerated
and pruned once for the room; band-limited impulse responses are then evaluated along each source's path and
interpolated between its nodes (`sonobench.acoustics`).
Deviations: fractional delays by windowed sincs instead of rounding to samples, and no high-pass.
Limits: a box with walls that reflect all frequencies alike and specularly, omnidirectional sources and microphones.
Vector sensors receive each image as a plane wave; the near-field term of their velocity is left out (`sonobench.acoustics.vector_responses`).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from sonobench.acoustics.image_sources import Lattice, build_lattice, free_field
from sonobench.acoustics.path_render import path_at, render_path
from sonobench.acoustics.vector_responses import render_vectors
from sonobench.errors import InputError
from sonobench.protocols import Rendering
from sonobench.scene import Scene
from sonobench.scene.render import assemble, box_of
from sonobench.types import Array


@dataclass(frozen=True)
class ImageMethod:
    """A box of reflecting walls, or free field, sources moving."""

    max_order: int | None = None  #: most reflections of an image; None: as many as prune_db leaves
    prune_db: float = -50.0  #: level of all images that are left out against the whole response
    path_step_m: float = 0.01  #: way of a moving source between two responses; a quarter of the shortest wavelength serves
    isolated: bool = False  #: no mixing: each source through its own copy ARRAY/SOURCE of every array, with noise of its own

    def __post_init__(self) -> None:
        if self.max_order is not None and self.max_order < 0:
            raise ValueError(f"max_order is {self.max_order}; 0 (the direct sound alone) is the least")
        if not -200 <= self.prune_db < 0:
            raise ValueError(f"prune_db is {self.prune_db}; a level in [-200, 0) is needed")
        if not self.path_step_m > 0:
            raise ValueError(f"path_step_m is {self.path_step_m}; a length above 0 is needed")

    def simulate(self, scene: Scene, seed: int) -> Rendering:
        """Render; a pure function of its arguments.

        Raises:
            InputError: walls without end, or a source that meets a microphone.
        """
        lattice = self._lattice(scene)

        def propagate(array: str, rate_hz: float, mics_m: Array, signal: Array, times_s: Array, positions_m: Array) -> Array:
            path = path_at(times_s, positions_m, len(signal), rate_hz, self.path_step_m)
            render = render_vectors if scene.arrays[array].kind == "avs" else render_path
            with _blaming(scene):
                return render(lattice, signal, path, mics_m, rate_hz, scene.c_m_s)

        return assemble(scene, seed, propagate, self.isolated, vector_sensors=True)

    def _lattice(self, scene: Scene) -> Lattice:
        box_m, reflections = box_of(scene)
        if box_m is None or reflections is None:
            return free_field()
        with _blaming(scene):
            return build_lattice(box_m[1] - box_m[0], reflections, self.max_order, self.prune_db)


@contextmanager
def _blaming(scene: Scene) -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise InputError(f"scene {scene.name}: {error}") from error
