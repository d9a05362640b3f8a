"""Benchmarks run only when asked for: `pytest tests/benchmarks --benchmark-only`."""

from __future__ import annotations

from pathlib import Path

import pytest


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("benchmark_only"):
        return
    here = Path(__file__).parent
    mine = [i for i in items if here in i.path.parents]
    config.hook.pytest_deselected(items=mine)
    items[:] = [i for i in items if here not in i.path.parents]
