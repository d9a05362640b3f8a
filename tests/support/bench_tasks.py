"""What a cell is told to do in the benchmarks: nothing, or to end its own worker."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any


def perform(task: Mapping[str, Any]) -> dict[str, Any]:
    """Answer at once, or die as told."""
    if task["do"] == "exit":
        os._exit(0)
    return {"status": "ok", "value": os.getpid(), "peak_mb": 0.0}


def empty(task: Mapping[str, Any]) -> dict[str, Any]:
    """Answer a trial's step at once, with what the session expects of it."""
    if task["step"] == "score":
        row = {"metric": "", "slice": "", "value": 1.0, "weight": 1.0, "unit": "m", "better": "lower", "pool": "mean", "coverage": 1.0}
        value: dict[str, Any] = {item["key"]: {"rows": [row | {"metric": item["label"]}]} for item in task["metrics"]}
    elif task["step"] == "track":
        value = {"front_end_s": 0.0, "tracker_s": 0.0, "cpu_s": 0.0, "frames": 10, "real_time_factor": 0.0}
    else:
        value = {"front_end_s": 0.0, "frames": 10}
    return {"status": "ok", "value": value, "peak_mb": 0.0}
