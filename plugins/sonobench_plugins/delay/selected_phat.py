"""The phase transform of the bins whose signal stands out: frequency selection by an estimated signal-to-noise ratio.

All pairs vote on a bin's power of signal and of noise,

    P_s = mean over pairs of |R_ij|,   sigma² = mean over the pairs' microphones of R_ii − P_s,   bin kept where 10 log10(P_s / sigma²) ≥ eta,

R being averaged spectra: of one periodogram every bin is as good as noise-free.
Source: "Multi-feature adaptive unscented particle filter" (in Chinese; Chinese Journal of Scientific Instrument 43, 2022), eq. 4 to 8.
Deviations: eq. 5 averages complex R_ij, whose phases cancel between pairs of different delays, so that under 1 % of the bins are left;
their magnitudes are averaged here, `average = "complex"` is the printed form. Where no bin is kept, the frame is all zeros: nothing is said.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sonobench.protocols import Complexes
from sonobench.signal import phases, weighed
from sonobench.types import Floats, Ints


@dataclass(frozen=True)
class SelectedPhat:
    """G12 / |G12| where the signal-to-noise ratio is at least eta_db, else 0."""

    eta_db: float = 0.0  #: least signal-to-noise ratio of a bin that is kept
    average: Literal["magnitude", "complex"] = "magnitude"  #: of the pairs' cross-spectra; "complex" is the printed one
    segments: int = 3  #: Welch segments of a frame, half overlapping
    memory_s: float = 0.0  #: time constant of the average of spectra over frames, 0 for none

    def __post_init__(self) -> None:
        if self.average not in ("magnitude", "complex"):
            raise ValueError(f"average is {self.average!r}; 'magnitude' or 'complex' is needed")
        if self.segments < 2 and self.memory_s <= 0:
            raise ValueError("the ratio needs averaged spectra: segments of at least 2, or memory_s above 0")

    def correlate(self, spectra: Complexes, pairs: Ints) -> Floats:
        """Spectra (…, mic, bin), pairs (P, 2) → circular correlation (…, P, lag), highest at the lag by which i is later than j."""
        return weighed(self, spectra, pairs)

    def weigh(self, cross: Complexes, power: Floats, pairs: Ints) -> Complexes:
        """The phases of the bins that are kept, the same ones for every pair."""
        alive = np.asarray(power.any(axis=-1))  # (…, mic): pairs with a dead microphone have no vote
        vote = (alive[..., pairs[:, 0]] & alive[..., pairs[:, 1]])[..., None].astype(np.float32)
        votes = np.maximum(vote.sum(axis=-2), 1.0)
        if self.average == "magnitude":
            signal = (np.abs(cross) * vote).sum(axis=-2) / votes
        else:
            signal = np.abs((cross * vote).sum(axis=-2)) / votes
        both = 0.5 * (power[..., pairs[:, 0], :] + power[..., pairs[:, 1], :])
        noise = np.maximum((both * vote).sum(axis=-2) / votes - signal, 0.0)
        kept = (signal > 0) & (signal >= 10 ** (self.eta_db / 10) * noise)
        return phases(cross) * kept[..., None, :].astype(np.float32)
