"""Small scenes for the tests of scenes, sounds and simulators."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from sonobench.components import overlay
from sonobench.registry import Registry
from sonobench.scene.scene import Scene

TABLE: dict[str, Any] = {
    "name": "small",
    "simulator": "image-method",
    "duration_s": 2.0,
    "rate_hz": 8000.0,
    "period_s": 0.1,
    "room": {"size_m": [4.0, 3.0, 2.5], "t60_s": 0.15},
    "arrays": {"walls": {"elements_m": [[1.8, 0.1, 1.5], [2.2, 0.1, 1.5]], "pairs": [[0, 1]]}},
    "sources": {
        "anna": {
            "sound": {"use": "white"},
            "trajectory": {"use": "line", "from_m": [1.0, 1.0, 1.5], "to_m": [3.0, 1.0, 1.5], "speed_m_s": 1.0},
            "intervals": [[0.2, 0.8], [1.2, 2.0]],
        },
        "carlo": {"sound": {"use": "pink"}, "trajectory": {"use": "still", "position_m": [2.0, 2.0, 1.5]}},
    },
}

MEASURED: dict[str, Any] = {
    "simulator": {"use": "measurements", "p_d": 0.9, "delay_std_s": 1e-4, "clutter_per_scan": 2.0},
    "arrays": {
        "walls": {"elements_m": [[1.8, 0.1, 1.5], [2.2, 0.1, 1.5], [0.1, 1.3, 1.5], [0.1, 1.7, 1.5]], "pairs": [[0, 1], [2, 3]]},
    },
}


@cache
def registry() -> Registry:
    return Registry.load()


def scene(top: Mapping[str, Any] | None = None, **more: Any) -> Scene:
    return Scene.from_table(overlay(TABLE, {**(top or {}), **more}), registry())


def copies(array: str, rate_hz: float, mics_m: Any, signal: Any, times_s: Any, positions_m: Any) -> Any:
    """A propagation that gives every microphone the signal itself."""
    return np.repeat(np.asarray(signal)[:, None], len(mics_m), axis=1)
