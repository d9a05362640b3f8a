"""What vector sensors receive from image sources: pressure and, scaled by −ρ0 c, the velocity along the three axes.

Each image contributes (p, u p), with u the unit vector from the element to the image and p its pressure: every image is taken for a plane wave
where it arrives. The near-field term of a spherical wave, which raises the velocity by the factor 1 + 1 / (i k r) of wave number k at the
distance r, is left out: 1.1 dB and 29° of phase at 100 Hz and 1 m, 0.1 dB and 8° at 100 Hz and 4 m, or at 400 Hz and 1 m.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonobench.acoustics.fractional_delay import LEAD, TAPS, pulse_table
from sonobench.acoustics.image_sources import Lattice
from sonobench.acoustics.path_render import Path, along_path, response_length
from sonobench.types import Array, read_only


def vector_responses(
    lattice: Lattice, positions_m: Array, elements_m: Array, rate_hz: float, c_m_s: float, length: int
) -> NDArray[np.float32]:
    """Pressure and velocities of a unit pulse, Σ a (1, u) / (4 pi d) δ(t − d / c) over the images, limited to half the sampling rate.

    Args:
        positions_m: (k, 3) of the source.
        elements_m: (M, 3).
        length: samples to keep.

    Returns:
        (k, 4 M, length), element by element p, vx, vy, vz along the axes of the room; time zero is sample `LEAD`.

    Raises:
        ValueError: an element lies on the source.
    """
    positions = read_only(positions_m, shape=(None, 3), name="positions_m")
    elements = read_only(elements_m, shape=(None, 3), name="elements_m")
    if positions.size and elements.size and (positions[:, None] == elements).all(axis=-1).any():
        raise ValueError("a vector sensor lies on the source, where its pressure is infinite; move one of them")
    out = np.zeros((len(positions), len(elements), 4, length + TAPS), np.float32)
    _responses(lattice.sign, lattice.offset_m, lattice.amplitude, lattice.runs, positions, elements, rate_hz / c_m_s, pulse_table(), out)
    return out.reshape(len(positions), 4 * len(elements), length + TAPS)[..., :length]


def render_vectors(lattice: Lattice, signal: Array, path: Path, elements_m: Array, rate_hz: float, c_m_s: float) -> Array:
    """What vector sensors (M, 3) receive of a source that emits `signal` (n,) along a path in the lattice's box.

    Returns:
        (n, 4 M) as in `vector_responses`, from the signal's first sample on; what arrives after its last is cut.

    Raises:
        ValueError: a vector sensor lies on the path.
    """
    elements = read_only(elements_m, shape=(None, 3), name="elements_m")
    length = response_length(lattice, path.positions_m, elements, rate_hz, c_m_s)
    return along_path(signal, path, lambda at: vector_responses(lattice, at, elements, rate_hz, c_m_s, length), LEAD)


@njit(cache=True)
def _responses(sign, offset, amplitude, runs, positions, elements, samples_per_m, table, out):  # type: ignore[no-untyped-def]
    away = np.empty((3, sign.shape[1]))
    end = out.shape[3] - table.shape[1]
    scale = samples_per_m / (4.0 * math.pi)
    for k in range(positions.shape[0]):
        for m in range(elements.shape[0]):
            response = out[k, m]
            for axis in range(3):
                for n in range(sign.shape[1]):
                    away[axis, n] = (sign[axis, n] * positions[k, axis] + offset[axis, n] - elements[m, axis]) * samples_per_m
            for r in range(runs.shape[0]):
                ix, iy, first, last = runs[r]
                x, y = away[0, ix], away[1, iy]
                a = amplitude[0, ix] * amplitude[1, iy] * scale
                for iz in range(first, last):
                    z = away[2, iz]
                    d = math.sqrt(x * x + y * y + z * z)
                    if d < end:
                        _add_pulse(response, d, a * amplitude[2, iz] / d, x / d, y / d, z / d, table)


@njit(cache=True, inline="always")
def _add_pulse(response, delay, gain, ux, uy, uz, table):  # type: ignore[no-untyped-def]
    phase = (delay - int(delay)) * (table.shape[0] - 1)
    whole, row = np.uintp(delay), np.uintp(phase)  # unsigned, as in path_render
    following = row + np.uintp(1)
    later = np.float32(gain * (phase - row))
    sooner = np.float32(gain) - later
    fx, fy, fz = np.float32(ux), np.float32(uy), np.float32(uz)
    for i in range(table.shape[1]):
        tap = np.uintp(i)
        p = sooner * table[row, tap] + later * table[following, tap]
        response[0, whole + tap] += p
        response[1, whole + tap] += fx * p
        response[2, whole + tap] += fy * p
        response[3, whole + tap] += fz * p
