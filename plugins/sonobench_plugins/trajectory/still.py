"""A source that stays where it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.types import Array, read_only


@dataclass(frozen=True, eq=False)
class Still:
    """One point."""

    position_m: Array  #: (3,) m in the room

    def __post_init__(self) -> None:
        object.__setattr__(self, "position_m", read_only(self.position_m, shape=(3,), name="position_m"))

    def position(self, time_s: Array) -> Array:
        """(k, 3) m at times (k,)."""
        return np.tile(self.position_m, (len(time_s), 1))
