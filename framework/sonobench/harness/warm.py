"""What a guard makes ready once, so that no worker that it forks has to: modules, and Numba's compiler."""

from __future__ import annotations

import importlib
from collections.abc import Iterable

#: what trials need and is slow to import or to make ready; "module:function" is called
WARM = (
    "numba",
    "scipy.linalg",
    "scipy.optimize",
    "scipy.signal",
    "scipy.special",
    "sonobench.harness.trial",
    "sonobench.log.recording",
    "sonobench.log.estimates",
    "sonobench.log.scans",
    "sonobench.scene.scene",
    "sonobench.scoring",
    "sonobench.harness.warm:compiler",
)


def make_ready(names: Iterable[str]) -> None:
    """Import modules and call functions by name."""
    for name in names:
        module, _, function = name.partition(":")
        found = importlib.import_module(module)
        if function:
            getattr(found, function)()


def compiler() -> None:
    """Compile something: a process's first use of Numba takes a third of a second, also where all its code is stored already."""
    import numba

    numba.njit(_half)(1.0)


def _half(x: float) -> float:
    return x / 2
