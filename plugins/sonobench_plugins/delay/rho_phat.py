"""The phase transform with an exponent (rho-PHAT): 1 / |G12|^alpha.

Source: Liang 2016, eq. 3-8 and table 3-4; Shen & Liu 2009, "A modified cross power-spectrum phase method based on microphone array".
alpha = 0 is plain cross-correlation, 1 the phase transform (the thesis's table 3-3 says so; the sentence above it has the names
the other way round). With `adapt` alpha follows the signal-to-noise ratio by table 3-4 (.5 to 10 dB, .75 to 25 dB, .85 above),
which is estimated from the coherence: sum |G12| / sum √(G11 G22) = S / (S + N) of equally noisy microphones. That overestimates it where
few segments are averaged. Who knows the ratio sets `alpha`: an estimator is told nothing of the scene.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.protocols import Complexes
from sonobench.signal import check_exponent, raised, snr_exponent, weighed
from sonobench.types import Floats, Ints


@dataclass(frozen=True)
class RhoPhat:
    """G12 / |G12|^alpha."""

    alpha: float = 0.75  #: 0 is plain cross-correlation, 1 the phase transform
    adapt: bool = False  #: alpha from the estimated signal-to-noise ratio, by Liang's table 3-4
    segments: int = 1  #: Welch segments of a frame, half overlapping; 1 is the whole frame
    memory_s: float = 0.0  #: time constant of the average of spectra over frames, 0 for none

    def __post_init__(self) -> None:
        check_exponent(self.alpha, self.adapt, self.segments, self.memory_s)

    def correlate(self, spectra: Complexes, pairs: Ints) -> Floats:
        """Spectra (…, mic, bin), pairs (P, 2) → circular correlation (…, P, lag), highest at the lag by which i is later than j."""
        return weighed(self, spectra, pairs)

    def weigh(self, cross: Complexes, power: Floats, pairs: Ints) -> Complexes:
        """cross over its magnitude to the power of alpha."""
        alpha = snr_exponent(cross, power, pairs) if self.adapt else np.float32(self.alpha)
        magnitude = raised(cross, alpha)
        return np.divide(cross, magnitude, out=np.zeros_like(cross), where=magnitude > 0)
