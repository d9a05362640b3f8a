"""Sonobench: evaluation of acoustic multi-target localisation and tracking.

The façade is lazy: `import sonobench` costs nothing, each name pays for itself when it is first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

_HOME = {
    "hookimpl": "hookspecs",
    **dict.fromkeys(
        [
            "Block",
            "DelayTable",
            "Detections",
            "DirectionSpectrum",
            "Estimate",
            "Field",
            "Header",
            "MicArray",
            "Scan",
            "Sensor",
            "Setup",
            "Space",
            "Truth",
            "identical",
        ],
        "types",
    ),
    "steered_power": "signal",
    **dict.fromkeys(["Mixture", "Rendering", "Series", "SoundSignal"], "protocols"),
    **dict.fromkeys(["InputError", "LogError", "PluginError", "SetupError", "SonobenchError", "TableError"], "errors"),
    **dict.fromkeys(["Pipeline", "replay"], "pipeline"),
    "Registry": "registry",
    **dict.fromkeys(["Scene", "Study"], "scene"),
    **dict.fromkeys(["Recording", "open_recording"], "log"),
    **dict.fromkeys(["Run", "open_run"], "harness"),
}

__all__ = [
    "Block",
    "DelayTable",
    "Detections",
    "DirectionSpectrum",
    "Estimate",
    "Field",
    "Header",
    "InputError",
    "LogError",
    "MicArray",
    "Mixture",
    "Pipeline",
    "PluginError",
    "Recording",
    "Registry",
    "Rendering",
    "Run",
    "Scan",
    "Scene",
    "Sensor",
    "Series",
    "Setup",
    "SetupError",
    "SonobenchError",
    "SoundSignal",
    "Space",
    "Study",
    "TableError",
    "Truth",
    "hookimpl",
    "identical",
    "open_recording",
    "open_run",
    "replay",
    "steered_power",
]

if TYPE_CHECKING:
    from sonobench.errors import InputError, LogError, PluginError, SetupError, SonobenchError, TableError
    from sonobench.harness import Run, open_run
    from sonobench.hookspecs import hookimpl
    from sonobench.log import Recording, open_recording
    from sonobench.pipeline import Pipeline, replay
    from sonobench.protocols import Mixture, Rendering, Series, SoundSignal
    from sonobench.registry import Registry
    from sonobench.scene import Scene, Study
    from sonobench.signal import steered_power
    from sonobench.types import (
        Block,
        DelayTable,
        Detections,
        DirectionSpectrum,
        Estimate,
        Field,
        Header,
        MicArray,
        Scan,
        Sensor,
        Setup,
        Space,
        Truth,
        identical,
    )


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'sonobench' has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(f"sonobench.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
