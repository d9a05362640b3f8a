"""Fractional delays by a windowed sinc, tabulated.

A pulse delayed by d samples is sinc(n − d) (1 + cos(pi (n − d) / 40)) / 2: band-limited to half the sampling rate and 80
samples long. The window moves with the delay, so that the pulse of a moving source changes without steps. Rows of the
table hold it for fractions of a sample; between rows it is interpolated linearly.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sonobench.types import Array, read_only

HALF_WIDTH = 40
#: samples between the first tap of a row and the whole part of its delay: the pulse begins before it arrives
LEAD = HALF_WIDTH - 1
TAPS = 2 * HALF_WIDTH
#: rows for fractions 0 to 1; linear interpolation between them errs by (pi / PHASES)² / 8, −94 dB
PHASES = 256


def windowed_sinc(offset: ArrayLike) -> Array:
    """The band-limited pulse at `offset` samples from its centre, any shape."""
    offset = np.asarray(offset, float)
    window = np.where(np.abs(offset) < HALF_WIDTH, 0.5 + 0.5 * np.cos(np.pi * offset / HALF_WIDTH), 0.0)
    return np.sinc(offset) * window


@cache
def pulse_table() -> NDArray[np.float32]:
    """Row p (of PHASES + 1) holds a pulse at LEAD + p / PHASES samples after its first tap; (PHASES + 1, TAPS)."""
    fraction = np.arange(PHASES + 1)[:, None] / PHASES
    return read_only(windowed_sinc(np.arange(TAPS) - LEAD - fraction), np.float32)
