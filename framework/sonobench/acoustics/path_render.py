"""What microphones receive from a source that stands still or moves, by image sources with fractional delays."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonobench.acoustics.fractional_delay import LEAD, TAPS, pulse_table
from sonobench.acoustics.image_sources import Lattice
from sonobench.types import Array, Floats, read_only

#: nodes of the path that weigh in at each sample
POINTS = 6
_BATCH = 8


class Path(NamedTuple):
    """Where a source is: positions_m (k, 3), row j at sample j `hop` of its signal; it stays at the last."""

    positions_m: Array
    hop: int


def path_at(times_s: Array, positions_m: Array, samples: int, rate_hz: float, step_m: float) -> Path:
    """The path through positions (t, 3) at times (t,), straight between them and still outside, in steps of `step_m`.

    Times count from the first of `samples` samples; steps are equal in time, `step_m` long where the source is
    fastest. A source that never moves has a path of one node.

    Raises:
        ValueError: no positions, or times that do not increase.
    """
    positions = read_only(positions_m, shape=(len(times_s), 3), name="positions_m")
    if not (len(positions) and np.isfinite(positions).all() and (np.diff(times_s) > 0).all()):
        raise ValueError(f"a path of {len(positions)} positions at times {times_s}; finite positions at increasing times are needed")
    if len(positions) == 1 or (positions == positions[0]).all():
        return Path(positions[:1], samples)
    fastest = (np.linalg.norm(np.diff(positions, axis=0), axis=-1) / np.diff(times_s)).max()
    hop = round(min(max(step_m / fastest * rate_hz, 1), max(samples, 1)))
    at = np.arange(0, samples + hop, hop) / rate_hz
    return Path(np.stack([np.interp(at, times_s, axis) for axis in positions.T], axis=-1), hop)


def response_length(lattice: Lattice, positions_m: Array, mics_m: Array, rate_hz: float, c_m_s: float) -> int:
    """Samples that hold the responses of these positions (k, 3) and microphones (M, 3) whole."""
    apart = np.linalg.norm(positions_m[:, None] - mics_m, axis=-1).max()
    reach = apart if math.isinf(lattice.reach_m) else max(lattice.reach_m, apart)
    return math.ceil(reach / c_m_s * rate_hz) + TAPS


def impulse_responses(
    lattice: Lattice, positions_m: Array, mics_m: Array, rate_hz: float, c_m_s: float, length: int
) -> NDArray[np.float32]:
    """Pressure of a unit pulse, Σ a / (4 pi d) δ(t − d / c) over the images, limited to half the sampling rate.

    Args:
        positions_m: (k, 3) of the source.
        mics_m: (M, 3).
        length: samples to keep.

    Returns:
        (k, M, length); time zero is sample `LEAD`, since band-limited pulses begin before they arrive.

    Raises:
        ValueError: a microphone lies on the source.
    """
    positions = read_only(positions_m, shape=(None, 3), name="positions_m")
    mics = read_only(mics_m, shape=(None, 3), name="mics_m")
    if positions.size and mics.size and (positions[:, None] == mics).all(axis=-1).any():
        raise ValueError("a microphone lies on the source, where its pressure is infinite; move one of them")
    out = np.zeros((len(positions), len(mics), length + TAPS), np.float32)
    _responses(lattice.sign, lattice.offset_m, lattice.amplitude, lattice.runs, positions, mics, rate_hz / c_m_s, pulse_table(), out)
    return out[..., :length]


@njit(cache=True)
def _responses(sign, offset, amplitude, runs, positions, mics, samples_per_m, table, out):  # type: ignore[no-untyped-def]
    width = sign.shape[1]
    square = np.empty((3, width))
    delay = np.empty(width)
    gain = np.empty(width)
    end = out.shape[2] - table.shape[1]
    scale = samples_per_m / (4.0 * math.pi)
    for k in range(positions.shape[0]):
        for m in range(mics.shape[0]):
            response = out[k, m]
            for axis in range(3):
                for n in range(width):
                    square[axis, n] = ((sign[axis, n] * positions[k, axis] + offset[axis, n] - mics[m, axis]) * samples_per_m) ** 2
            for r in range(runs.shape[0]):
                ix, iy, first, last = runs[r]
                plane = square[0, ix] + square[1, iy]
                a = amplitude[0, ix] * amplitude[1, iy] * scale
                for iz in range(first, last):
                    d = math.sqrt(plane + square[2, iz])
                    delay[iz] = d
                    gain[iz] = a * amplitude[2, iz] / d
                for iz in range(first, last):
                    if delay[iz] < end:
                        _add_pulse(response, delay[iz], gain[iz], table)


@njit(cache=True, inline="always")
def _add_pulse(response, delay, gain, table):  # type: ignore[no-untyped-def]
    # sizes come from the table, since Numba's cache would not see a constant of another module change;
    # indices are unsigned, since looking out for negative ones would keep the loop from being vectorised
    phase = (delay - int(delay)) * (table.shape[0] - 1)
    whole, row = np.uintp(delay), np.uintp(phase)
    following = row + np.uintp(1)
    later = np.float32(gain * (phase - row))
    sooner = np.float32(gain) - later
    for i in range(table.shape[1]):
        tap = np.uintp(i)
        response[whole + tap] += sooner * table[row, tap] + later * table[following, tap]


def render_path(lattice: Lattice, signal: Array, path: Path, mics_m: Array, rate_hz: float, c_m_s: float) -> Array:
    """What microphones (M, 3) receive of a source that emits `signal` (n,) along a path in the lattice's box.

    Returns:
        (n, M), from the signal's first sample on; what arrives after its last is cut.

    Raises:
        ValueError: a microphone lies on the path.
    """
    mics = read_only(mics_m, shape=(None, 3), name="mics_m")
    length = response_length(lattice, path.positions_m, mics, rate_hz, c_m_s)
    return along_path(signal, path, lambda at: impulse_responses(lattice, at, mics, rate_hz, c_m_s, length), LEAD)


def along_path(signal: Array, path: Path, respond: Callable[[Array], Floats], lead: int) -> Array:
    """A signal through responses that change along a path, whoever computes them.

    The response of each node acts on what the source emits around that node. Between nodes, responses are interpolated
    by Lagrange's polynomial through the nearest `POINTS` nodes: without steps, with the Doppler shift of a moving
    source, and exact where it stands still. Silent stretches cost nothing.

    Args:
        signal: (n,).
        path: nodes are every `hop` samples.
        respond: positions (k, 3) → responses (k, M, l).
        lead: sample of a response that is its time zero.

    Returns:
        (n, M).
    """
    signal = np.asarray(signal, np.float32)
    nodes = list(_windowed(signal, path))
    out = np.zeros((len(signal), respond(path.positions_m[:0]).shape[1]))
    for i in range(0, len(nodes), _BATCH):
        batch = nodes[i : i + _BATCH]
        responses = respond(path.positions_m[[j for j, _, _ in batch]])
        for response, (_, start, piece) in zip(responses, batch, strict=True):
            _overlap_add(out, _convolve(piece, response), start - lead)
    return out


def lagrange_window(hop: int, points: int = POINTS) -> Array:
    """Weight of a node over the `points` `hop` samples around it: Lagrange's basis through the nearest nodes.

    The windows of all nodes, each shifted by `hop` from the last, add up to 1. `points` is even.
    """
    half = points // 2
    window = np.empty((points, hop))
    for i in range(points):
        u = i - half + np.arange(hop) / hop  # hops after the node, in one gap between nodes
        others = [j for j in range(i - points + 1, i + 1) if j != 0]
        window[i] = np.prod([(j - u) / j for j in others], axis=0)
    return window.reshape(-1)


def _windowed(signal: Array, path: Path) -> Iterator[tuple[int, int, Array]]:
    """(node, first sample, what is emitted there) of all nodes at which the source sounds."""
    k = len(path.positions_m)
    if k == 1:
        yield 0, 0, signal
        return
    window = lagrange_window(path.hop).astype(np.float32)
    half = len(window) // 2
    for j in range(1 - POINTS // 2, k - 1 + POINTS // 2):  # beyond its ends the path holds still
        first, end = max(j * path.hop - half, 0), min(j * path.hop + half, len(signal))
        if first < end and signal[first:end].any():
            skip = first - (j * path.hop - half)
            yield min(max(j, 0), k - 1), first, signal[first:end] * window[skip : skip + end - first]


def _convolve(piece: Array, responses: Floats) -> Floats:
    """Piece (n,) through responses (M, l): (n + l − 1, M)."""
    from scipy.signal import oaconvolve

    return oaconvolve(piece[None], responses, axes=-1).T


def _overlap_add(out: Array, part: Floats, start: int) -> None:
    """Add part to out from row `start`, which may lie before the first, as far as out reaches."""
    first, end = max(start, 0), min(start + len(part), len(out))
    if first < end:
        out[first:end] += part[first - start : end - start]
