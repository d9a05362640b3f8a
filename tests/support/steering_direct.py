"""Steered response power by steering phases, bin by bin: the definition, slowly."""

from __future__ import annotations

import numpy as np

from sonobench.protocols import Complexes
from sonobench.signal import TablePlan
from sonobench.types import Array, Floats, Ints


def phase_steered(plan: TablePlan, spectra: Complexes, mics_m: Floats, pairs: Ints, points: Floats, c_m_s: float, rate_hz: float) -> Array:
    """Mean over the band of Re Σ_pairs G_ij / |G_ij| exp(j w (tau_i − tau_j)) (n,) of one frame's spectra (mic, bins); DiBiase 2000, eq. 9 to 11."""
    low, high = plan.band
    omega = 2 * np.pi * np.arange(low, high) * rate_hz / plan.fft_length
    unit = spectra[:, low:high] / np.abs(spectra[:, low:high])
    late = np.linalg.norm(points[:, None] - mics_m, axis=-1) / c_m_s  # (n, mic)
    total = np.zeros(len(points))
    for i, j in pairs:
        g = unit[i] * unit[j].conj()
        total += (g * np.exp(1j * omega * (late[:, i] - late[:, j])[:, None])).real.mean(axis=1)
    return total
