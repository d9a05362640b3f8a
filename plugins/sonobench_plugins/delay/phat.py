"""Generalised cross-correlation with the phase transform.

Source: Knapp & Carter 1976, "The generalized correlation method for estimation of time delay".
Each spectrum is whitened once a microphone, since |S_i conj(S_j)| = |S_i| |S_j|.
"""

from __future__ import annotations

from dataclasses import dataclass

from sonobench.protocols import Complexes
from sonobench.signal import cross_spectra, whitened
from sonobench.types import Floats, Ints


@dataclass(frozen=True)
class Phat:
    """Keeps the phase of the cross-spectrum only."""

    def correlate(self, spectra: Complexes, pairs: Ints) -> Floats:
        """Spectra (…, mic, bin), pairs (P, 2) → circular correlation (…, P, lag), highest at the lag by which i is later than j."""
        from scipy.fft import irfft

        correlation: Floats = irfft(cross_spectra(whitened(spectra), pairs), overwrite_x=True)
        return correlation
