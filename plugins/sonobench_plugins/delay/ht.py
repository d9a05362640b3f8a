"""The maximum-likelihood processor of Hannan & Thomson: phases weighed by what their coherence says of their variance.

psi |G12| = gamma² / (1 − gamma²), gamma² the magnitude-squared coherence.
Source: Hannan & Thomson 1973; Knapp & Carter 1976, eq. 29; Liang 2016, table 3-1 (which prints gamma for gamma²).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.protocols import Complexes
from sonobench.signal import coherence, phases, weighed
from sonobench.types import Floats, Ints


@dataclass(frozen=True)
class Ht:
    """gamma² / (1 − gamma²) times the phase."""

    segments: int = 7  #: Welch segments of a frame, half overlapping; at least 2, or a memory, or every coherence is 1
    memory_s: float = 0.0  #: time constant of the average of spectra over frames, 0 for none
    most: float = 0.99  #: coherences above count as this: of few averages 1 is no certainty

    def __post_init__(self) -> None:
        if not 0 < self.most < 1:
            raise ValueError(f"most is {self.most}; above 0 and below 1 is needed")

    def correlate(self, spectra: Complexes, pairs: Ints) -> Floats:
        """Spectra (…, mic, bin), pairs (P, 2) → circular correlation (…, P, lag), highest at the lag by which i is later than j."""
        return weighed(self, spectra, pairs)

    def weigh(self, cross: Complexes, power: Floats, pairs: Ints) -> Complexes:
        """The phases of cross times gamma² / (1 − gamma²)."""
        squared = np.minimum(coherence(cross, power, pairs), self.most)
        return phases(cross) * (squared / (1 - squared))
