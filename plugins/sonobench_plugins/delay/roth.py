"""The Roth processor: the cross-spectrum over the power of the pair's first microphone.

Source: Roth 1971; Knapp & Carter 1976, table I; Liang 2016, table 3-1.
Deviations: with one segment and no memory it is the phase transform weighed by |S_j| / |S_i|; averages make it what it is meant to be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.protocols import Complexes
from sonobench.signal import weighed
from sonobench.types import Floats, Ints


@dataclass(frozen=True)
class Roth:
    """G12 / G11."""

    segments: int = 7  #: Welch segments of a frame, half overlapping
    memory_s: float = 0.0  #: time constant of the average of spectra over frames, 0 for none

    def correlate(self, spectra: Complexes, pairs: Ints) -> Floats:
        """Spectra (…, mic, bin), pairs (P, 2) → circular correlation (…, P, lag), highest at the lag by which i is later than j."""
        return weighed(self, spectra, pairs)

    def weigh(self, cross: Complexes, power: Floats, pairs: Ints) -> Complexes:
        """cross / power of microphone i, 0 where it has none."""
        first = power[..., pairs[:, 0], :]
        return np.divide(cross, first, out=np.zeros_like(cross), where=first > 0)
