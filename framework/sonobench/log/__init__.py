"""Recordings, scans and estimates on disk: the only importer of mcap."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

_HOME = {
    **dict.fromkeys(["Recording", "open_recording", "write_recording"], "recording"),
    **dict.fromkeys(["estimates_sha", "read_estimates", "write_estimates"], "estimates"),
    **dict.fromkeys(["read_scans", "write_scans"], "scans"),
}

__all__ = [
    "Recording",
    "estimates_sha",
    "open_recording",
    "read_estimates",
    "read_scans",
    "write_estimates",
    "write_recording",
    "write_scans",
]

if TYPE_CHECKING:
    from sonobench.log.estimates import estimates_sha, read_estimates, write_estimates
    from sonobench.log.recording import Recording, open_recording, write_recording
    from sonobench.log.scans import read_scans, write_scans


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'sonobench.log' has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(f"sonobench.log.{_HOME[name]}"), name)
    globals()[name] = value
    return value
