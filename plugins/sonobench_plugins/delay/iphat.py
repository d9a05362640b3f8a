"""The improved phase transform (IPHAT) of Liang 2016: 1 / (|G12|^alpha + gamma²).

Source: Liang 2016, eq. 3-8 to 3-10 and table 3-4.
Deviations: eq. 3-10 adds a magnitude with a unit to a coherence without one, so that its result depends on the recording's level;
here |G12| is first divided by its mean over the bins. The coherence is averaged by Welch's method: of one periodogram it is 1
everywhere, and adds a constant. alpha = .75 is the thesis's choice for 10 to 25 dB; `adapt` follows its table 3-4 (see `rho-phat`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.protocols import Complexes
from sonobench.signal import check_exponent, coherence, raised, snr_exponent, weighed
from sonobench.types import Floats, Ints


@dataclass(frozen=True)
class Iphat:
    """G12 / (|G12|^alpha + gamma²)."""

    alpha: float = 0.75  #: 0 is near plain cross-correlation, 1 near the phase transform
    adapt: bool = False  #: alpha from the estimated signal-to-noise ratio, by Liang's table 3-4
    segments: int = 7  #: Welch segments of a frame, half overlapping
    memory_s: float = 0.0  #: time constant of the average of spectra over frames, 0 for none

    def __post_init__(self) -> None:
        check_exponent(self.alpha, self.adapt, self.segments, self.memory_s)

    def correlate(self, spectra: Complexes, pairs: Ints) -> Floats:
        """Spectra (…, mic, bin), pairs (P, 2) → circular correlation (…, P, lag), highest at the lag by which i is later than j."""
        return weighed(self, spectra, pairs)

    def weigh(self, cross: Complexes, power: Floats, pairs: Ints) -> Complexes:
        """cross over the sum of its normalised magnitude to the power of alpha and of the coherence."""
        alpha = snr_exponent(cross, power, pairs) if self.adapt else np.float32(self.alpha)
        below = raised(cross, alpha) + coherence(cross, power, pairs)
        return np.divide(cross, below, out=np.zeros_like(cross), where=below > 0)
