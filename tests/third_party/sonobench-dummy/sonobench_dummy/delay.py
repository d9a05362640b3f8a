"""Cross-correlation whitened by a power of its magnitude."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class HalfPhat:
    """Between the plain correlation (beta 0) and PHAT (beta 1)."""

    beta: float = 0.5  #: power of the magnitude that is divided out

    def correlate(self, spectra, pairs):
        cross = spectra[..., pairs[:, 0], :] * spectra[..., pairs[:, 1], :].conj()
        return np.fft.irfft(cross / np.maximum(np.abs(cross), 1e-12) ** self.beta)
