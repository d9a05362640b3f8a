"""Samples through a preprocessor, cut as asked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

RATE_HZ = 8000.0


def run(component: Any, samples: np.ndarray, cuts: Sequence[int] = ()) -> np.ndarray:
    """All that comes out of read-only samples (n, channels), cut at `cuts`."""
    state, out = component.start(RATE_HZ, samples.shape[1]), [np.zeros((0, samples.shape[1]))]
    for piece in np.split(samples, sorted(cuts)):
        if len(piece):
            block = np.ascontiguousarray(piece)
            block.flags.writeable = False
            state, ready = component.process(state, block)
            out.append(ready)
    return np.concatenate([*out, component.finish(state)])


def response(component: Any, n: int = 1 << 15) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies and complex gains (bin,) from the answer to one impulse."""
    impulse = np.zeros((n, 1))
    impulse[0] = 1.0
    return np.fft.rfftfreq(n, 1 / RATE_HZ), np.fft.rfft(run(component, impulse)[:, 0])
