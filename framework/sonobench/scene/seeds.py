"""Random numbers of a rendering: one independent stream for each purpose."""

from __future__ import annotations

import numpy as np

from sonobench.errors import InputError


def generator(seed: int, purpose: str) -> np.random.Generator:
    """The generator of a purpose such as "noise/walls"; what other purposes exist does not change it.

    Raises:
        InputError: the seed is negative.
    """
    if seed < 0:
        raise InputError(f"seed {seed} is negative; 0 or more is needed")
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(purpose.encode())))
