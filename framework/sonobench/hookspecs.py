"""The three hooks of a plugin: two for discovery, one for observing; none runs per frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pluggy

PROJECT = "sonobench"
hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@hookspec
def sonobench_components() -> Mapping[str, Mapping[str, Any]]:  # type: ignore[empty-body]
    """Return {role: {name: target}}; a target is a class, "package.module:Class", or a table (a preset)."""


@hookspec
def sonobench_data() -> str:  # type: ignore[empty-body]
    """Return the name of a package that holds scenes/, studies/, pipelines/, reference/ or clips/."""


@hookspec
def sonobench_trial_finished(row: Mapping[str, Any]) -> None:
    """Observe one finished trial; an observer that raises is a warning, never a lost row."""
