"""Another sampling rate for what a source emits."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from sonobench.types import Array


def resampled(samples: Array, from_hz: float, to_hz: float) -> Array:
    """Samples (n,) at another rate: (ceil(n to / from),).

    A linear-phase polyphase filter, flat up to 0.9 of the lower half rate, 80 dB down from that half rate on.
    """
    if from_hz == to_hz:
        return samples
    from scipy.signal import firwin, resample_poly

    ratio = Fraction(to_hz).limit_denominator(1000) / Fraction(from_hz).limit_denominator(1000)
    slower = max(ratio.numerator, ratio.denominator)
    taps = firwin(96 * slower + 1, 0.95 / slower, window=("kaiser", 8.0))
    return np.asarray(resample_poly(samples, ratio.numerator, ratio.denominator, window=taps))
