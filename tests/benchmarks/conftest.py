"""Benchmarks run only when asked for: `pytest tests/benchmarks --benchmark-only`; what they measured is printed at the end."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

_FIGURES = pytest.StashKey[list[tuple[str, dict[str, Any]]]]()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("benchmark_only"):
        return
    here = Path(__file__).parent
    mine = [i for i in items if here in i.path.parents]
    config.hook.pytest_deselected(items=mine)
    items[:] = [i for i in items if here not in i.path.parents]


@pytest.fixture(autouse=True)
def figures(request: pytest.FixtureRequest) -> Iterator[None]:
    """Keep each benchmark's `extra_info` for the summary."""
    benchmark = request.getfixturevalue("benchmark") if "benchmark" in request.fixturenames else None
    yield
    if benchmark is not None:
        request.config.stash.setdefault(_FIGURES, []).append((request.node.name, dict(benchmark.extra_info)))


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    for name, info in config.stash.get(_FIGURES, []):
        if info:
            terminalreporter.write_line(name)
        for key, value in info.items():
            terminalreporter.write_line(f"    {key}: {f'{value:.4g}' if isinstance(value, float) else value}")
    if config.getoption("benchmark_only"):
        terminalreporter.write_line(f"load of the last minute when done: {os.getloadavg()[0]:.2f} on {os.cpu_count()} cores")
