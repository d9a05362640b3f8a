"""Plain cross-correlation.

Source: Knapp & Carter 1976, table I; Liang 2016, eq. 3-4.
"""

from __future__ import annotations

from dataclasses import dataclass

from sonobench.protocols import Complexes
from sonobench.signal import weighed
from sonobench.types import Floats, Ints


@dataclass(frozen=True)
class Cc:
    """Keeps the cross-spectrum as it is."""

    segments: int = 1  #: Welch segments of a frame, half overlapping; 1 is the whole frame
    memory_s: float = 0.0  #: time constant of the average of cross-spectra over frames, 0 for none

    def correlate(self, spectra: Complexes, pairs: Ints) -> Floats:
        """Spectra (…, mic, bin), pairs (P, 2) → circular correlation (…, P, lag), highest at the lag by which i is later than j."""
        return weighed(self, spectra, pairs)

    def weigh(self, cross: Complexes, power: Floats, pairs: Ints) -> Complexes:
        """cross."""
        return cross
