"""Blocks of any length → overlapping frames, in groups whose arithmetic does not depend on how the recording was cut."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sonobench.errors import InputError, SetupError
from sonobench.types import Array, Block, Floats

WindowName = Literal["rectangular", "hamming", "hann"]

#: Frames that are worked on together, counted from the recording's first: eight keep the transforms in the cache, and a
#: fixed grouping keeps vectorised arithmetic the same bit for bit whatever the blocks' lengths.
GROUP = 8

_COSINE = {"rectangular": 0.0, "hamming": 0.46, "hann": 0.5}


def window(name: str, length: int) -> Array:
    """Window (length,) by name, periodic (the form whose overlapped copies add up to a constant).

    Raises:
        ValueError: no window has that name.
    """
    if name not in _COSINE:
        raise ValueError(f"there is no window {name!r}; choose one of {', '.join(_COSINE)}")
    share = _COSINE[name]
    return (1.0 - share) - share * np.cos(2.0 * np.pi * np.arange(length) / length)


@dataclass(frozen=True, slots=True)
class Framing:
    """How arrays that share a clock are cut into frames.

    Attributes:
        arrays: names of the arrays that are read, in the order of their channels.
        channels: channels of each.
        length, hop: samples of a frame, and between the starts of frames.
        rate_hz, start_s: sampling rate and time of sample 0.
    """

    arrays: tuple[str, ...]
    channels: tuple[int, ...]
    length: int
    hop: int
    rate_hz: float
    start_s: float

    def time_s(self, frame: int) -> float:
        """Centre of the samples of a frame."""
        return self.start_s + (frame * self.hop + (self.length - 1) / 2.0) / self.rate_hz


@dataclass(frozen=True, slots=True, eq=False)
class Tail:
    """Samples that wait for the rest of their group.

    Attributes:
        frame: index of the next frame.
        chunks: one tuple of (n, channels) float32 an array; the first sample is the next frame's first.
        counts: samples taken so far, one an array.
    """

    frame: int
    chunks: tuple[tuple[NDArray[np.float32], ...], ...]
    counts: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Consecutive frames: index of the first, and samples (f, length, channels) float32."""

    first: int
    samples: NDArray[np.float32]


def framing(arrays: dict[str, int], frame_s: float, hop_s: float, rate_hz: float, start_s: float = 0.0) -> Framing:
    """Framing of arrays {name: channels}; lengths are rounded to whole samples.

    Raises:
        SetupError: a frame or a hop holds no sample, or frames leave samples out.
    """
    length, hop = round(frame_s * rate_hz), round(hop_s * rate_hz)
    if length < 2 or hop < 1:
        raise SetupError(f"frame_s {frame_s} and hop_s {hop_s} are {length} and {hop} samples at {rate_hz} Hz; 2 and 1 are needed")
    if hop > length:
        raise SetupError(f"hop_s {hop_s} is longer than frame_s {frame_s}: the samples between would never be heard; shorten hop_s")
    return Framing(tuple(arrays), tuple(arrays.values()), length, hop, float(rate_hz), float(start_s))


def empty_tail(plan: Framing) -> Tail:
    """The tail before the first block."""
    return Tail(0, ((),) * len(plan.arrays), (0,) * len(plan.arrays))


def push(plan: Framing, tail: Tail, block: Block) -> tuple[Tail, list[Frames]]:
    """Take a block; return the groups of GROUP frames that it completes. Blocks of other arrays pass by.

    Raises:
        InputError: samples are missing before the block, its channels do not fit, or it holds NaN or infinity.
    """
    if block.array not in plan.arrays:
        return tail, []
    which = plan.arrays.index(block.array)
    check_block(block, plan.channels[which], tail.counts[which])
    chunks, counts = list(tail.chunks), list(tail.counts)
    chunks[which] = (*chunks[which], block.samples)
    counts[which] += len(block.samples)
    tail = replace(tail, chunks=tuple(chunks), counts=tuple(counts))
    groups = (_available(plan, tail)) // GROUP
    return _take(plan, tail, [GROUP] * groups) if groups else (tail, [])


def drain(plan: Framing, tail: Tail) -> list[Frames]:
    """The whole frames that are left at the recording's end, fewer than GROUP; samples that fill no frame are dropped."""
    left = _available(plan, tail)
    return _take(plan, tail, [left])[1] if left else []


def _available(plan: Framing, tail: Tail) -> int:
    samples = min(tail.counts) - tail.frame * plan.hop
    return 0 if samples < plan.length else 1 + (samples - plan.length) // plan.hop


def _take(plan: Framing, tail: Tail, sizes: list[int]) -> tuple[Tail, list[Frames]]:
    whole = [np.concatenate(c) for c in tail.chunks]  # every array holds at least a frame here
    shortest = min(map(len, whole))
    joined = whole[0] if len(whole) == 1 else np.concatenate([w[:shortest] for w in whole], axis=1)
    cut: Any = np.lib.stride_tricks.sliding_window_view(joined, plan.length, axis=0)[:: plan.hop].swapaxes(1, 2)
    out, at = [], 0
    for size in sizes:
        out.append(Frames(tail.frame + at, cut[at : at + size]))
        at += size
    return Tail(tail.frame + at, tuple((w[at * plan.hop :],) for w in whole), tail.counts), out


def check_block(block: Block, channels: int, expected: int) -> None:
    """Raise InputError unless a block goes on at sample `expected`, with these channels, all finite."""
    if block.first_sample != expected:
        raise InputError(f"array {block.array}: a block begins at sample {block.first_sample}, sample {expected} was due; blocks are lost")
    if block.samples.shape[1] != channels:
        raise InputError(f"array {block.array}: a block has {block.samples.shape[1]} channels, its header says {channels}")
    finite = np.isfinite(block.samples)
    if not finite.all():
        row, channel = np.argwhere(~finite)[0]
        raise InputError(
            f"array {block.array}: sample {expected + row} of channel {channel} is {block.samples[row, channel]}; "
            "front ends need finite samples, so repair or leave out the recording"
        )


def mean_square(frames: Floats) -> Array:
    """Mean square of each channel (f, channels) of frames (f, n, channels)."""
    return np.einsum("fnc,fnc->fc", frames, frames, dtype=np.float64) / frames.shape[1]
