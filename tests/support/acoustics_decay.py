"""Reverberation time of an impulse response."""

from __future__ import annotations

import numpy as np

from sonobench.types import Array, Floats


def energy_decay_db(response: Floats) -> Array:
    """Energy still to come at each sample of a response (n,) against all of it, dB (Schroeder's integral)."""
    energy = np.cumsum(np.square(response[::-1], dtype=float))[::-1]
    with np.errstate(divide="ignore"):
        return np.asarray(10 * np.log10(energy / energy[0]))


def reverberation_time(response: Floats, rate_hz: float) -> float:
    """T60 (s) of a response (n,): six times the 10 dB decay time of a line through its decay from −5 to −35 dB.

    Source: ISO 3382-1 (T30), Schroeder 1965.

    Raises:
        ValueError: silence, or a response that is cut before it has decayed by 45 dB.
    """
    if not np.any(response):
        raise ValueError("a silent response has no reverberation time; the source is nowhere near")
    decay = energy_decay_db(response)
    cut = decay[-max(1, len(decay) // 100)]
    if cut > -45:
        raise ValueError(f"the response is cut at {cut:.0f} dB of its energy; −45 dB is needed (prune less, or allow higher orders)")
    span = np.flatnonzero((decay <= -5) & (decay >= -35))
    if len(span) < 2:
        raise ValueError("the response falls from −5 to −35 dB within a sample: there is no reverberation to measure")
    slope = np.polyfit(span / rate_hz, decay[span], 1)[0]
    return float(-60 / slope)
