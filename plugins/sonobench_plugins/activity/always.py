"""Every frame holds voice: for scenes whose sources never pause."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.protocols import State
from sonobench.types import Bools, Floats


@dataclass(frozen=True)
class Always:
    """Says yes."""

    def start(self, rate_hz: float) -> State:
        """No memory."""
        return None

    def active(self, state: State, frames: Floats) -> tuple[State, Bools]:
        """Frames (f, n, channels) → all True (f,)."""
        return state, np.ones(len(frames), bool)
