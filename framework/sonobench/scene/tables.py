"""The tables of a scene: its room, arrays, sources and noise as frozen dataclasses.

They only hold what the table says; `checks.faults` judges them together, so that all faults come in one message.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from sonobench.protocols import Sound, Trajectory
from sonobench.types import Array, Ints


@dataclass(frozen=True, eq=False)
class Room:
    """A box with one corner at the origin; a scene without a room is in free field."""

    size_m: Array  #: (3,) m along x, y, z
    reflections: Array | None = None  #: (6,) pressure reflection coefficients of the walls x0 x1 y0 y1 z0 z1, in [0, 1)
    t60_s: float | None = None  #: instead of `reflections`: six equal walls with this reverberation time in the image method

    def coefficients(self, c_m_s: float) -> Array:
        """Reflection coefficients (6,) of the walls."""
        if self.reflections is not None:
            return self.reflections
        from sonobench.scene.reverberation import uniform_reflection

        return np.full(6, uniform_reflection(self.size_m, float(self.t60_s or 0.0), c_m_s))


@dataclass(frozen=True, eq=False)
class ArrayTable:
    """Microphones that share a clock and a frame, and where the frame is."""

    elements_m: Array  #: (k, 3) m in the array's frame
    kind: Literal["microphones", "avs"] = "microphones"  #: "avs": vector sensors
    position_m: Array = field(default_factory=lambda: np.zeros(3))  #: (3,) m, the frame's origin in the room
    yaw_deg: float = 0.0  #: turn about z, counter-clockwise, applied last
    pitch_deg: float = 0.0  #: turn about the frame's y
    roll_deg: float = 0.0  #: turn about the frame's x, applied first
    rate_hz: float | tuple[float, ...] | None = None  #: one for the array, or one a microphone (all equal); None: the scene's
    pairs: Ints = field(default_factory=lambda: np.zeros((0, 2), np.int64))  #: (P, 2) indices of `elements_m`

    def __post_init__(self) -> None:
        if not self.pairs.size:  # `pairs = []` in a file has shape (0,)
            object.__setattr__(self, "pairs", np.zeros((0, 2), np.int64))

    @property
    def pose(self) -> Array:
        """(4, 4) room ← array."""
        yaw, pitch, roll = np.deg2rad([self.yaw_deg, self.pitch_deg, self.roll_deg])
        cy, sy, cp, sp, cr, sr = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
        pose = np.eye(4)
        pose[:3, :3] = (
            np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
            @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
            @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
        )
        pose[:3, 3] = self.position_m
        return pose


@dataclass(frozen=True, eq=False)
class Source:
    """Something that moves and, in a scene with audio, sounds."""

    trajectory: Trajectory  #: time 0 is the start of the first interval
    sound: Sound | None = None  #: None only in a scene without audio
    intervals: Array | None = None  #: (k, 2) s, start and end of each stretch in which it sounds; None: the whole scene
    gain_db: float = 0.0  #: on the sound
    label: int | None = None  #: in the truth; None: its place among the sources, from 1

    def spans(self, duration_s: float) -> Array:
        """Activity intervals (k, 2) s."""
        return np.array([[0.0, duration_s]]) if self.intervals is None else self.intervals


@dataclass(frozen=True, eq=False)
class Noise:
    """Gaussian noise of the sensors, independent between elements: equally strong on all microphones, of its own strength on velocity channels.

    Either `snr_db` or `variance` says how strong it is. The signal-to-noise ratio is a noise-free power over the noise's, both of
    pressure: that of the mixture (all sources, direct sound and reverberation), averaged over the array's elements and over the samples
    within any source's activity interval; or, against "source", that of one source alone within its own intervals, averaged over the sources.
    """

    snr_db: float | None = None  #: see above
    variance: float | None = None  #: instead: mean square on a microphone, or on the pressure channel of a vector sensor
    against: Literal["mixture", "source"] = "mixture"  #: what snr_db compares with
    kind: Literal["white", "pink"] = "white"  #: "pink": 1/f from 20 Hz on
    velocity_db: float | tuple[float, ...] | None = (
        None  #: power on a velocity channel over that on the pressure channel: one, or x, y, z; None: 0
    )
    velocity_variance: float | tuple[float, ...] | None = None  #: instead: mean square, one, or x, y, z
    correlation: Array | None = None  #: (4, 4) between the channels p, vx, vy, vz of an element; None: independent
