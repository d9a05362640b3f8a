"""Gaussian noise of stated spectrum, for sensors and for sounds."""

from __future__ import annotations

import numpy as np

from sonobench.types import Array


def pink(rng: np.random.Generator, n: int, rate_hz: float, low_hz: float = 20.0) -> Array:
    """Noise (n,) of expected mean square 1 whose power falls exactly as 1/f at the bins of its transform, from `low_hz` on.

    Raises:
        ValueError: n samples hold no frequency above `low_hz`.
    """
    if n == 0:
        return np.zeros(0)
    frequency = np.fft.rfftfreq(n, 1 / rate_hz)
    inside = frequency >= low_hz
    if not inside.any():
        raise ValueError(f"{n} samples at {rate_hz:g} Hz hold no frequency of {low_hz:g} Hz or more")
    amplitude = np.zeros(len(frequency))
    amplitude[inside] = frequency[inside] ** -0.5
    spectrum = amplitude * (rng.standard_normal(len(frequency)) + 1j * rng.standard_normal(len(frequency)))
    power = np.full(len(frequency), 4.0)  # an inner bin is a pair of conjugates, 2 Re(…)
    power[0] = 1.0
    if n % 2 == 0:
        power[-1] = 1.0  # the bin at half the rate is alone, and only its real part counts
    return np.asarray(np.fft.irfft(spectrum, n) * n / np.sqrt(np.sum(power * amplitude**2)))
