"""Voice activity by short-time energy above a noise floor that follows the quietest frames.

The floor falls at once to a quieter frame and rises by `rise_db` a frame, so that it needs a pause now and then: a
sound that keeps its level is taken for noise after the first few frames (use `always` there). The floor starts
`threshold_db` below the first frame, which therefore counts as voice.
Source: Rabiner & Sambur 1975, energy against a noise level; the floor is a one-frame form of Martin 2001 (minimum statistics).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sonobench.protocols import State
from sonobench.signal import mean_square
from sonobench.types import Bools, Floats


class _Floor(NamedTuple):
    level_db: float | None
    hold: int


@dataclass(frozen=True)
class Energy:
    """Mean energy of all channels against an adaptive floor."""

    threshold_db: float = 6.0  #: energy above the floor that counts as voice
    rise_db: float = 0.05  #: rise of the floor a frame
    hangover_frames: int = 0  #: frames that stay active after the last loud one
    silence_db: float = -100.0  #: level re full scale below which nothing is voice

    def start(self, rate_hz: float) -> State:
        """No frame heard yet."""
        return _Floor(None, 0)

    def active(self, state: State, frames: Floats) -> tuple[State, Bools]:
        """Frames (f, n, channels) in order → (state, (f,) bool)."""
        floor, hold = state
        level = 10.0 * np.log10(np.maximum(mean_square(frames).mean(axis=1), 1e-30))
        out = np.zeros(len(level), bool)
        for k, now in enumerate(level.tolist()):
            if now > self.silence_db:  # digital silence says nothing about the room's noise
                floor = now - self.threshold_db if floor is None else min(now, floor + self.rise_db)
            loud = floor is not None and now > self.silence_db and now >= floor + self.threshold_db
            out[k] = loud or hold > 0
            hold = self.hangover_frames if loud else max(hold - 1, 0)
        return _Floor(floor, hold), out
