"""Pictures of trials, of scenes, and of metrics against a swept value or time; and the numbers behind them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

_HOME = {
    "choose": "choice",
    "chosen": "selection",
    "curve": "curves",
    "draw_scene": "scene_report",
    "over_time": "time_curves",
    "pictures": "figures",
    "write_curves": "metric_report",
    "write_frames": "frame_report",
    "write_report": "run_report",
}

__all__ = ["choose", "chosen", "curve", "draw_scene", "over_time", "pictures", "write_curves", "write_frames", "write_report"]

if TYPE_CHECKING:
    from sonobench.report.choice import choose
    from sonobench.report.curves import curve
    from sonobench.report.figures import pictures
    from sonobench.report.frame_report import write_frames
    from sonobench.report.metric_report import write_curves
    from sonobench.report.run_report import write_report
    from sonobench.report.scene_report import draw_scene
    from sonobench.report.selection import chosen
    from sonobench.report.time_curves import over_time


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'sonobench.report' has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(f"sonobench.report.{_HOME[name]}"), name)
    globals()[name] = value
    return value
