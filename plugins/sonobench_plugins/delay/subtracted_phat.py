"""The phase transform of what stands out of a noise floor: each phase counts by the share of its magnitude above the floor.

The floor is a quantile of the cross-spectrum's magnitude over the band, frame by frame: speech has few strong bins and many weak
ones that hold noise alone, whose phases the plain transform counts as fully.
Source: Boll 1979, "Suppression of acoustic noise in speech using spectral subtraction", on the cross-spectrum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.protocols import Complexes
from sonobench.signal import phases, weighed
from sonobench.types import Floats, Ints


@dataclass(frozen=True)
class SubtractedPhat:
    """max(1 − floor / |G12|, 0) times the phase."""

    quantile: float = 0.5  #: of the magnitudes over the band, that is the floor
    over: float = 1.0  #: the floor is multiplied by this
    segments: int = 1  #: Welch segments of a frame, half overlapping; 1 is the whole frame
    memory_s: float = 0.0  #: time constant of the average of spectra over frames, 0 for none

    def __post_init__(self) -> None:
        if not (0 <= self.quantile < 1 and self.over >= 0):
            raise ValueError(f"quantile is {self.quantile} and over {self.over}; 0 up to 1, and at least 0, are needed")

    def correlate(self, spectra: Complexes, pairs: Ints) -> Floats:
        """Spectra (…, mic, bin), pairs (P, 2) → circular correlation (…, P, lag), highest at the lag by which i is later than j."""
        return weighed(self, spectra, pairs)

    def weigh(self, cross: Complexes, power: Floats, pairs: Ints) -> Complexes:
        """The phases of cross times what is left of their magnitudes."""
        magnitude = np.abs(cross)
        heard = np.where(magnitude > 0, magnitude, np.nan)
        with np.errstate(all="ignore"):
            floor = self.over * np.nan_to_num(np.nanquantile(heard, self.quantile, axis=-1, keepdims=True))
        left = np.maximum(1 - np.divide(floor, magnitude, out=np.ones_like(magnitude), where=magnitude > 0), 0)
        return phases(cross) * left.astype(np.float32)
