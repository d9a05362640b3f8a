"""The smoothed coherence transform (SCOT).

Source: Carter, Nuttall & Cable 1973; Knapp & Carter 1976, table I; Liang 2016, table 3-1.
With one segment and no memory |G12|² = G11 G22, and it is the phase transform.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.protocols import Complexes
from sonobench.signal import weighed
from sonobench.types import Floats, Ints


@dataclass(frozen=True)
class Scot:
    """G12 / √(G11 G22), the complex coherence."""

    segments: int = 7  #: Welch segments of a frame, half overlapping
    memory_s: float = 0.0  #: time constant of the average of spectra over frames, 0 for none

    def correlate(self, spectra: Complexes, pairs: Ints) -> Floats:
        """Spectra (…, mic, bin), pairs (P, 2) → circular correlation (…, P, lag), highest at the lag by which i is later than j."""
        return weighed(self, spectra, pairs)

    def weigh(self, cross: Complexes, power: Floats, pairs: Ints) -> Complexes:
        """cross over the geometric mean of the powers, 0 where one has none."""
        mean = np.sqrt(power[..., pairs[:, 0], :] * power[..., pairs[:, 1], :])
        return np.divide(cross, mean, out=np.zeros_like(cross), where=mean > 0)
