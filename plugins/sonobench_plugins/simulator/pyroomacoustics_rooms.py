"""The image method as pyroomacoustics computes it; needs the extra `rooms`.

Source: Scheibler, Bezzam & Dokmanić 2018, "Pyroomacoustics: a Python package for audio room simulation and array
processing algorithms".
Deviations: its high-pass is off, and its responses get the 1 / (4 pi) and lose the 40 samples of delay that it adds.
Moving sources: positions of the path are sources of one room, and responses are interpolated between them as
`image-method` does it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pyroomacoustics as pra

from sonobench.acoustics.path_render import along_path, path_at
from sonobench.errors import InputError
from sonobench.protocols import Rendering
from sonobench.scene import Scene
from sonobench.scene.render import assemble, box_of
from sonobench.types import Array

_SETTINGS = {"rir_hpf_enable": False, "num_threads": 1}
_WALLS = ("west", "east", "south", "north", "floor", "ceiling")


@dataclass(frozen=True)
class PyroomacousticsRooms:
    """A box of reflecting walls, or free field, by pyroomacoustics."""

    max_order: int = 17  #: most reflections of an image
    path_step_m: float = 0.01  #: way of a moving source between two responses

    def __post_init__(self) -> None:
        if self.max_order < 0:
            raise ValueError(f"max_order is {self.max_order}; 0 (the direct sound alone) is the least")
        if not self.path_step_m > 0:
            raise ValueError(f"path_step_m is {self.path_step_m}; a length above 0 is needed")

    def simulate(self, scene: Scene, seed: int) -> Rendering:
        """Render; a pure function of its arguments.

        Raises:
            InputError: a sampling rate that pyroomacoustics cannot take.
        """
        box_m, reflections = box_of(scene)

        def propagate(array: str, rate_hz: float, mics_m: Array, signal: Array, times_s: Array, positions_m: Array) -> Array:
            if rate_hz != int(rate_hz):
                raise InputError(f"scene {scene.name}: pyroomacoustics takes whole rates only, {array} has {rate_hz} Hz; use image-method")

            def respond(at_m: Array) -> Array:
                return self._responses(_room(box_m, reflections, int(rate_hz), self.max_order), at_m, mics_m, scene.c_m_s)

            path = path_at(times_s, positions_m, len(signal), rate_hz, self.path_step_m)
            return along_path(signal, path, respond, pra.constants.get("frac_delay_length") // 2)

        return assemble(scene, seed, propagate)

    @staticmethod
    def _responses(room: pra.Room, positions_m: Array, mics_m: Array, c_m_s: float) -> Array:
        """(k, M, l) of sources (k, 3), padded to the longest."""
        if not len(positions_m):
            return np.zeros((0, len(mics_m), 0))
        room.set_sound_speed(c_m_s)
        room.add_microphone_array(np.array(mics_m).T)
        for position in positions_m:
            room.add_source(np.array(position))
        with _settings():
            room.compute_rir()
        out = np.zeros((len(positions_m), len(mics_m), max(len(r) for row in room.rir for r in row)))
        for m, row in enumerate(room.rir):
            for k, response in enumerate(row):
                out[k, m, : len(response)] = response / (4 * np.pi)
        return out


def _room(box_m: Array | None, reflections: Array | None, rate_hz: int, max_order: int) -> pra.Room:
    if box_m is None or reflections is None:
        return pra.AnechoicRoom(3, fs=rate_hz)
    walls = {wall: pra.Material(energy_absorption=1 - r * r) for wall, r in zip(_WALLS, reflections, strict=True)}
    return pra.ShoeBox(box_m[1] - box_m[0], fs=rate_hz, materials=walls, max_order=max_order)


@contextmanager
def _settings() -> Iterator[None]:
    """pyroomacoustics keeps its settings in a global object: ours, then what was there before."""
    before = {name: pra.constants.get(name) for name in _SETTINGS}
    try:
        for name, value in _SETTINGS.items():
            pra.constants.set(name, value)
        yield
    finally:
        for name, value in before.items():
            pra.constants.set(name, value)
