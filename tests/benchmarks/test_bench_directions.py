"""A direction from 8000 snapshots of one vector sensor; Hu, Li & Jin 2014 print 64 ms (WPF-MP), 15 ms (MP) and 12.5 s (Capon on a grid)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from vector_snapshots import snapshots

from sonobench.components import build
from sonobench.registry import Registry

TABLES: list[dict[str, Any]] = [
    {"use": "intensity"},
    {"use": "maximum-power"},
    {"use": "maximum-power-exact"},
    {"use": "maximum-power-exact", "noise": "diagonal"},
    {"use": "wpf-mp"},
    {"use": "wpf-mp", "noise": "diagonal"},
    {"use": "capon"},
    {"use": "music"},
    {"use": "music", "sources": 2},
]


@pytest.mark.parametrize("frames", [1, 8], ids=["one", "eight"])
@pytest.mark.parametrize("table", TABLES, ids=["-".join(str(v) for v in t.values()) for t in TABLES])
def test_directions_of_8000_snapshots(benchmark: Any, table: dict[str, Any], frames: int) -> None:
    """Frames as the front end hands them over: float64, contiguous; the covariance R included."""
    estimator = build("direction", table, Registry.load())
    x = snapshots(np.random.default_rng(0), frames, 8000)
    found = benchmark(estimator.directions, x)
    assert found.valid[:, 0].all()
