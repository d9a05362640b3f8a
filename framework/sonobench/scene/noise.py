"""Gaussian noise of stated spectrum, for sensors and for sounds; of stated covariance between the channels of vector sensors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from sonobench.types import Array

if TYPE_CHECKING:
    from sonobench.scene.tables import ArrayTable, Noise


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
    return shaped(rng, n, amplitude)


def shaped(rng: np.random.Generator, n: int, amplitude: Array) -> Array:
    """Noise (n,) of expected mean square 1 whose spectrum is as `amplitude` (n // 2 + 1,), not all 0, at the bins of its transform."""
    spectrum = amplitude * (rng.standard_normal(len(amplitude)) + 1j * rng.standard_normal(len(amplitude)))
    power = np.full(len(amplitude), 4.0)  # an inner bin is a pair of conjugates, 2 Re(…)
    power[0] = 1.0
    if n % 2 == 0:
        power[-1] = 1.0  # the bin at half the rate is alone, and only its real part counts
    return np.asarray(np.fft.irfft(spectrum, n) * n / np.sqrt(np.sum(power * amplitude**2)))


def channel_variances(noise: Noise, kind: str, power: float) -> Array:
    """Mean squares of the noise on the channels of one element: (1,) of a microphone, (4,) of a vector sensor (p, vx, vy, vz).

    Args:
        power: what noise.snr_db compares with; not read where the noise has a variance.
    """
    pressure = float(noise.variance or 0.0) if noise.snr_db is None else power * 10 ** (-noise.snr_db / 10)
    if kind != "avs":
        return np.array([pressure], float)
    if noise.velocity_variance is not None:
        velocity = np.broadcast_to(np.asarray(noise.velocity_variance, float), 3)
    else:
        velocity = pressure * 10 ** (np.broadcast_to(np.asarray(noise.velocity_db or 0.0, float), 3) / 10)
    return np.append(pressure, velocity)


def channel_noise(rng: np.random.Generator, noise: Noise, variances: Array, shape: tuple[int, int], rate_hz: float) -> Array:
    """Noise (n, channels) of elements whose channels have these variances (1,) or (4,); elements follow one another."""
    n, channels = shape
    if noise.kind == "white":
        unit = rng.standard_normal((n, channels))
    else:
        unit = np.stack([pink(rng, n, rate_hz) for _ in range(channels)], axis=1)
    if len(variances) == 1:
        return np.asarray(unit * np.sqrt(variances[0]))
    mixing = np.diag(np.sqrt(variances))
    if noise.correlation is not None:
        mixing = mixing @ _root(noise.correlation)
    return np.asarray((unit.reshape(n, -1, 4) @ mixing.T).reshape(n, channels))


def noise_faults(noise: Noise, arrays: Mapping[str, ArrayTable]) -> Iterator[str]:
    """What is wrong with a noise, each a sentence that begins with its key."""
    if (noise.snr_db is None) == (noise.variance is None):
        yield "snr_db: either snr_db or variance is needed, not both (leave noise out for none)"
    if noise.snr_db is not None and not np.isfinite(noise.snr_db):
        yield f"snr_db: is {noise.snr_db}; a finite number is needed (leave noise out for none)"
    if noise.variance is not None and not 0 <= noise.variance < np.inf:
        yield f"variance: is {noise.variance}; 0 or more is needed"
    if noise.against == "source" and noise.snr_db is None:
        yield "against: says what snr_db compares with; there is none"
    velocity = {name: getattr(noise, name) for name in ("velocity_db", "velocity_variance", "correlation")}
    stated = {name: value for name, value in velocity.items() if value is not None}
    if stated and not any(array.kind == "avs" for array in arrays.values()):
        yield from (f'{name}: no array is of kind "avs", and only vector sensors have velocity channels' for name in stated)
    if noise.velocity_db is not None and noise.velocity_variance is not None:
        yield "velocity_db: either velocity_db or velocity_variance is needed, not both"
    yield from _velocity_faults(noise)


def _velocity_faults(noise: Noise) -> Iterator[str]:
    for name, least in (("velocity_db", -np.inf), ("velocity_variance", 0.0)):
        value: Any = getattr(noise, name)
        values = np.asarray(0.0 if value is None else value, float)
        if values.shape not in ((), (3,)) or not (np.isfinite(values) & (values >= least)).all():
            yield f"{name}: is {value}; one finite number, or three for x, y, z, are needed" + (", 0 or more" if least == 0 else "")
    if noise.correlation is not None:
        c = noise.correlation
        if c.shape != (4, 4) or not np.array_equal(c, c.T) or not (np.diag(c) == 1).all() or np.linalg.eigvalsh(c)[0] < -_ROUNDING:
            yield f"correlation: is {c.tolist()}; a symmetric (4, 4) matrix with ones on its diagonal and no negative eigenvalue is needed"


_ROUNDING = 1e-12


def _root(correlation: Array) -> Array:
    """M (4, 4) with M Mᵀ = correlation, which may be singular."""
    values, vectors = np.linalg.eigh(correlation)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
