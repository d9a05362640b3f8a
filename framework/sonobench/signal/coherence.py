"""What averaged cross-spectra say: phases, coherence, and the signal-to-noise ratio that follows from it."""

from __future__ import annotations

from typing import Any

import numpy as np

from sonobench.protocols import Complexes
from sonobench.types import Floats, Ints

_STEPS_DB = (10.0, 25.0)
_EXPONENTS = (0.5, 0.75, 0.85)


def phases(cross: Complexes) -> Complexes:
    """cross / |cross|, 0 where it is 0."""
    magnitude = np.abs(cross)
    return np.divide(cross, magnitude, out=np.zeros_like(cross), where=magnitude > 0)


def coherence(cross: Complexes, power: Floats, pairs: Ints) -> Floats:
    """Magnitude-squared coherence |G12|² / (G11 G22) (…, P, bin) in [0, 1], 0 where a microphone has no power.

    Args:
        cross: (…, P, bin) averaged cross-spectra.
        power: (…, mic, bin) averaged over the same.
        pairs: (P, 2).
    """
    product = power[..., pairs[:, 0], :] * power[..., pairs[:, 1], :]
    squared = cross.real**2 + cross.imag**2
    return np.minimum(np.divide(squared, product, out=np.zeros_like(squared), where=product > 0), 1.0)


def raised(cross: Complexes, alpha: Any) -> Floats:
    """(|cross| / its mean over the bins that are not 0)^alpha (…, P, bin); 0 where cross is 0."""
    magnitude = np.abs(cross)
    mean = magnitude.sum(axis=-1, keepdims=True) / np.maximum(np.count_nonzero(magnitude, axis=-1)[..., None], 1)
    share = np.divide(magnitude, mean, out=np.zeros_like(magnitude), where=mean > 0)
    return np.where(share > 0, share**alpha, 0.0).astype(magnitude.dtype)


def check_exponent(alpha: float, adapt: bool, segments: int, memory_s: float) -> None:
    """Refuse an exponent of the magnitude outside 0 to 1, and `snr_exponent` of spectra that are no averages.

    Raises:
        ValueError: says which.
    """
    if not 0 <= alpha <= 1:
        raise ValueError(f"alpha is {alpha}; 0 to 1 is needed")
    if adapt and segments < 2 and memory_s <= 0:
        raise ValueError(
            "adapt estimates the signal-to-noise ratio from the coherence: segments of at least 2, or memory_s above 0, is needed"
        )


def snr_exponent(cross: Complexes, power: Floats, pairs: Ints) -> Floats:
    """Liang 2016, table 3-4: .5 up to 10 dB, .75 up to 25 dB, .85 above, (…, P, 1), of the ratio that the coherence implies.

    What both microphones share, sum |G12|, is the signal's power over all bins, and sum √(G11 G22) its sum with the noise's. (The
    mean of the coherences would weigh every bin alike: of speech most hold noise, and it stays below 10 dB whatever the ratio.)
    """
    shared = np.abs(cross).sum(axis=-1, keepdims=True)
    whole = np.sqrt(power[..., pairs[:, 0], :] * power[..., pairs[:, 1], :]).sum(axis=-1, keepdims=True)
    share = np.clip(np.divide(shared, whole, out=np.zeros_like(shared), where=whole > 0), 1e-6, 1 - 1e-6)
    snr_db = 10 * np.log10(share / (1 - share))
    return np.asarray(_EXPONENTS, np.float32)[np.searchsorted(_STEPS_DB, snr_db)]
