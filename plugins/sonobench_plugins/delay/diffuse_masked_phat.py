"""The phase transform of what is not diffuse: bins count by the share of coherent sound that the pair's coherence implies.

A diffuse field (reverberation) has the coherence Γ_n = sinc(2 f d / c) between omnidirectional microphones d apart, a plane wave one of
magnitude 1 and any phase. From a pair's averaged coherence Γ_x follows the ratio of coherent to diffuse power, whatever the direction,

    CDR = [Γ_n Re Γ_x − |Γ_x|² − √(Γ_n² (Re Γ_x)² − Γ_n² |Γ_x|² + Γ_n² − 2 Γ_n Re Γ_x + |Γ_x|²)] / (|Γ_x|² − 1),

and each phase is weighed by CDR / (1 + CDR), or by 1 where the ratio exceeds a threshold.
Source: Schwarz & Kellermann 2015, "Coherent-to-diffuse power ratio estimation for dereverberation", eq. 25; the mask on correlations for
tracking: the diffuse-masked delays that the multi-feature paper of 2022 compares with.
Deviations: without a front end to say how far apart microphones are, Γ_n is 0, as for microphones far apart.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sonobench.protocols import Complexes
from sonobench.signal import phases, weighed
from sonobench.types import Array, Floats, Ints


@dataclass(frozen=True)
class DiffuseMaskedPhat:
    """G12 / |G12| times the share of coherent sound."""

    threshold_db: float | None = None  #: bins count fully above this ratio and not at all below; None: each by its share
    segments: int = 5  #: Welch segments of a frame, half overlapping
    memory_s: float = 0.0  #: time constant of the average of spectra over frames, 0 for none

    def __post_init__(self) -> None:
        if self.segments < 2 and self.memory_s <= 0:
            raise ValueError("coherence needs averaged spectra: segments of at least 2, or memory_s above 0")

    def bind(self, bin_hz: float, spacing_m: Array, c_m_s: float) -> BoundMask:
        """The estimator of pairs (P,) spacing_m apart, for spectra of bins bin_hz apart."""
        return BoundMask(self, 2.0 * bin_hz * np.asarray(spacing_m) / c_m_s)

    def correlate(self, spectra: Complexes, pairs: Ints) -> Floats:
        """Spectra (…, mic, bin), pairs (P, 2) → circular correlation (…, P, lag), highest at the lag by which i is later than j."""
        return weighed(self, spectra, pairs)

    def weigh(self, cross: Complexes, power: Floats, pairs: Ints) -> Complexes:
        """The masked phases of microphones far apart."""
        return BoundMask(self, np.full(len(pairs), np.inf)).weigh(cross, power, pairs)


@dataclass(frozen=True, eq=False)
class BoundMask:
    """`DiffuseMaskedPhat` that knows its pairs: turns (P,) of sinc's argument from bin to bin, infinite for microphones far apart."""

    own: DiffuseMaskedPhat
    turns: Array = field(repr=False)

    @property
    def segments(self) -> int:
        """Welch segments of a frame."""
        return self.own.segments

    @property
    def memory_s(self) -> float:
        """Time constant of the average of spectra."""
        return self.own.memory_s

    def correlate(self, spectra: Complexes, pairs: Ints) -> Floats:
        """As `DiffuseMaskedPhat.correlate`."""
        return weighed(self, spectra, pairs)

    def weigh(self, cross: Complexes, power: Floats, pairs: Ints) -> Complexes:
        """The masked phases."""
        diffuse = np.zeros((len(self.turns), cross.shape[-1]))
        known = np.isfinite(self.turns)
        diffuse[known] = np.sinc(self.turns[known, None] * np.arange(cross.shape[-1]))
        product = power[..., pairs[:, 0], :] * power[..., pairs[:, 1], :]
        gamma = np.divide(cross, np.sqrt(product), out=np.zeros_like(cross), where=product > 0)
        ratio = coherent_to_diffuse(gamma, diffuse)
        if self.own.threshold_db is None:
            share = ratio / (1.0 + ratio)
        else:
            share = (ratio >= 10 ** (self.own.threshold_db / 10)).astype(float)
        return phases(cross) * share.astype(np.float32)


def coherent_to_diffuse(gamma: Complexes, diffuse: Floats) -> Array:
    """Ratio of coherent to diffuse power (…, P, bin), at least 0, of coherences and those of the diffuse field (P, bin)."""
    squared = np.minimum(gamma.real.astype(float) ** 2 + gamma.imag.astype(float) ** 2, 1.0 - 1e-9)
    along = diffuse * gamma.real
    under = (diffuse * gamma.real) ** 2 - diffuse**2 * squared + diffuse**2 - 2 * along + squared
    return np.maximum((along - squared - np.sqrt(np.maximum(under, 0.0))) / (squared - 1.0), 0.0)
