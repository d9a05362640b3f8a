"""A physical set-up as data.

simulator = "image-method"
duration_s = 8.0
rate_hz = 16000.0
[room]
size_m = [5.0, 4.0, 2.7]
t60_s = 0.25
[arrays.walls]
elements_m = [[0.1, 1.8, 1.5], [0.1, 2.2, 1.5]]
pairs = [[0, 1]]
[sources.anna]
sound = { use = "clip", clip = "ru-female-1" }
trajectory = { use = "line", from_m = [1.0, 1.0, 1.5], to_m = [4.0, 3.0, 1.5], speed_m_s = 0.7 }
intervals = [[0.5, 3.5], [4.5, 8.0]]
[noise]
snr_db = 20.0
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sonobench.components import build, digest, overlay, to_table
from sonobench.errors import InputError, TableError
from sonobench.protocols import Rendering, Simulator
from sonobench.registry import Registry
from sonobench.scene.checks import faults
from sonobench.scene.tables import ArrayTable, Noise, Room, Source
from sonobench.tables import read_toml
from sonobench.types import Array

_CLIP_SUFFIXES = (".wav", ".flac")


@dataclass(frozen=True, eq=False)
class Scene:
    """Room, arrays, sources and noise, or targets and clutter; what a simulator renders.

    Raises:
        TableError: all faults of the scene as a whole.
    """

    duration_s: float  #: from time 0
    simulator: Simulator  #: renders it
    sources: Mapping[str, Source]  #: by name, in the order of the truth
    arrays: Mapping[str, ArrayTable]  #: by name
    name: str = ""  #: the file's stem where the table has none
    about: str = ""  #: one line for lists
    rate_hz: float = 16000.0  #: of arrays that have no rate of their own
    c_m_s: float = 343.0  #: speed of sound
    period_s: float = 0.1  #: evaluation period of the truth; a measurement-level scene also scans at it
    evaluate_at: Literal["end", "centre"] = "end"  #: of each period; "centre": where frames of one period have theirs
    room: Room | None = None  #: None: free field
    noise: Noise | None = None  #: of the sensors; None: none
    nominal: Mapping[str, float] = field(default_factory=dict)  #: scalars that a pipeline's unset parameters take
    given: tuple[str, ...] = ()  #: what pipelines may ask for, computed from the truth (`truth.GIVEN` lists it)
    given_arrays: Mapping[str, Array] = field(default_factory=dict)  #: the same, stated
    given_std: Mapping[str, Array] = field(default_factory=dict)  #: standard deviations of Gaussian errors by column of what is given
    table: Mapping[str, Any] = field(default_factory=dict, init=False, repr=False)  #: the whole table, once loaded from one

    def __post_init__(self) -> None:
        found = faults(self)
        if found:
            raise TableError(found)

    @classmethod
    def load(cls, name_or_path: str | Path, registry: Registry, overrides: Mapping[str, Any] | None = None) -> Scene:
        """Read a registered scene, or a file (what ends in .toml).

        Args:
            name_or_path: "quickstart-1", "dist:name", or a path.
            registry: where names are looked up.
            overrides: a nested table laid over the file's, as a sweep writes it; a dotted key stands for nested tables.

        Raises:
            InputError: no such file, or no TOML.
            PluginError: no such registered scene.
            TableError: all faults of the table.
        """
        text = str(name_or_path)
        file = Path(text) if text.endswith(".toml") else registry.find_data("scenes", text, ".toml")
        table = {"name": file.stem, **read_toml(file)}
        for key, value in (overrides or {}).items():
            table = overlay(table, _nested(key, value))
        return cls.from_table(table, registry, file.parent, where=f"{file.name}:")

    @classmethod
    def from_table(cls, table: Mapping[str, Any], registry: Registry, folder: Path | None = None, where: str = "scene:") -> Scene:
        """A scene from its table; clips that are relative paths lie in `folder`.

        Raises:
            TableError: all faults, each headed by `where` and the path of its key.
        """
        scene: Scene = build(cls, _clips_in(table, folder), registry, where)
        object.__setattr__(scene, "table", _clips_as_written(to_table(scene, registry), table))
        return scene

    @property
    def labels(self) -> tuple[int, ...]:
        """The truth's label of each source."""
        return tuple(i if s.label is None else s.label for i, s in enumerate(self.sources.values(), 1))

    def rate_of(self, array: str) -> float:
        """Sampling rate (Hz) of an array."""
        rate = self.arrays[array].rate_hz
        return self.rate_hz if rate is None else float(rate[0] if isinstance(rate, tuple) else rate)

    def digest(self) -> str:
        """SHA-256 of the table and of the content of every file that its sounds read; with the seed it fixes a recording."""
        files = {n: [_sha256(f) for f in getattr(s.sound, "files", ())] for n, s in self.sources.items()}
        return digest({"table": self.table, "files": files})

    def check_sounds(self) -> None:
        """Read every file that a sound names, as rendering will; making a scene only asks whether the files are there.

        Raises:
            TableError: all that cannot be read, or are silent.
        """
        found = []
        for name, source in self.sources.items():
            try:
                if source.sound is not None:
                    source.sound.render(np.random.default_rng(0), self.duration_s, self.rate_hz)
            except InputError as error:
                found.append(f"sources.{name}.sound: {error}")
        if found:
            raise TableError(found)

    def simulate(self, seed: int) -> Rendering:
        """Render it; a pure function of scene and seed."""
        return self.simulator.simulate(self, seed)


def _nested(key: str, value: Any) -> dict[str, Any]:
    for part in reversed(key.split(".")):
        value = {part: value}
    return dict(value)


def _clips_in(table: Mapping[str, Any], folder: Path | None) -> dict[str, Any]:
    copy = deepcopy(dict(table))
    for sound in _sound_tables(copy).values():
        clip = sound.get("clip")
        if folder is not None and isinstance(clip, str) and clip.endswith(_CLIP_SUFFIXES):
            sound["clip"] = str(folder / clip)
    return copy


def _clips_as_written(full: dict[str, Any], table: Mapping[str, Any]) -> dict[str, Any]:
    written = _sound_tables(table)
    for name, sound in _sound_tables(full).items():
        if "clip" in written.get(name, {}):
            sound["clip"] = written[name]["clip"]
    return full


def _sound_tables(table: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    sources = table.get("sources")
    if not isinstance(sources, Mapping):
        return {}
    return {n: s["sound"] for n, s in sources.items() if isinstance(s, Mapping) and isinstance(s.get("sound"), dict)}


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()
