"""Where a run took place: what env.json says, and whether versions tell the code."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

from sonobench.registry import Plugin

_TELLING = ("sonobench", "numpy", "scipy", "numba", "llvmlite", "pandas", "pyarrow", "mcap", "cattrs", "soundfile")


@cache
def environment() -> dict[str, Any]:
    """Python, machine and versions: what could make two runs' numbers or times differ."""
    return {
        "python": platform.python_version(),
        "implementation": platform.python_implementation(),
        "system": platform.system(),
        "release": platform.release(),
        "machine": platform.machine(),
        "processor": _processor(),
        "cpus": os.cpu_count(),
        "versions": {name: _version(name) for name in _TELLING},
    }


def environment_id() -> str:
    """Head of the digest of `environment`."""
    from sonobench.components import digest

    return digest(environment())[:16]


def is_dirty(plugin: Plugin) -> bool:
    """Whether a plugin's name and version do not fix its code: a file on its own, or a checkout that differs from its commit."""
    if plugin.path is not None:
        return True
    return _checkout_differs(plugin.distribution)


@cache
def _checkout_differs(distribution: str) -> bool:
    import json

    try:
        origin = importlib.metadata.distribution(distribution).read_text("direct_url.json")
    except importlib.metadata.PackageNotFoundError:
        return True
    about = json.loads(origin) if origin else {}
    if not about.get("dir_info", {}).get("editable"):
        return False
    folder = Path(str(about["url"]).removeprefix("file://"))
    try:
        asked = subprocess.run(
            ["git", "--no-optional-locks", "-C", str(folder), "status", "--porcelain", "--", "."],
            capture_output=True,
            timeout=10,
            check=False,
            text=True,
        )
    except (OSError, subprocess.TimeoutExpired):
        return True
    return asked.returncode != 0 or bool(asked.stdout.strip())


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.processor())


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return ""
