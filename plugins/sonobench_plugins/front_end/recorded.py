"""Passes the scans of a measurement-level recording through."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from sonobench import Header, Scan, Setup, SetupError
from sonobench.protocols import State


@dataclass(frozen=True)
class Recorded:
    """The recording's own scans."""

    consumes: ClassVar[str] = "scans"

    def open(self, header: Header) -> tuple[Setup, State]:
        """The setup of the recorded sensors.

        Raises:
            SetupError: the recording holds samples only.
        """
        if not header.sensors:
            have = f"samples of {[a.name for a in header.arrays]}, which 'gcc-peaks' reads" if header.arrays else "nothing to read"
            raise SetupError(f"recorded reads measurement scans; recording {header.name} has none, it has {have}")
        return Setup.from_header(header, header.sensors, header.period_s), None

    def step(self, state: State, block: Any) -> tuple[State, list[Scan]]:
        """A recorded scan as it is."""
        return state, [block]

    def flush(self, state: State) -> list[Scan]:
        """Nothing waits."""
        return []
