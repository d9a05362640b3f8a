"""White sources at exact fractional delays, and recordings of them in free field."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np

from sonobench import Block, Header, MicArray
from sonobench.protocols import FrontEnd
from sonobench.types import Scan, Setup

RATE_HZ = 8000.0
BOX_M = np.array([[0.0, 0.0, 0.0], [4.0, 3.0, 2.5]])
WALLS_M = np.array(
    [
        [1.8, 0.05, 1.5],
        [2.2, 0.05, 1.5],
        [3.95, 1.3, 1.5],
        [3.95, 1.7, 1.5],
        [2.2, 2.95, 1.5],
        [1.8, 2.95, 1.5],
        [0.05, 1.7, 1.5],
        [0.05, 1.3, 1.5],
    ]
)
WALL_PAIRS = np.array([[0, 1], [2, 3], [4, 5], [6, 7]])


def every_pair(mics: int) -> np.ndarray:
    return np.array(list(combinations(range(mics), 2)))


def delayed(signal: np.ndarray, delays_s: np.ndarray) -> np.ndarray:
    """A signal (n,) at delays (m,), circular and band-limited, (n, m)."""
    spectrum, f = np.fft.rfft(signal), np.fft.rfftfreq(len(signal), 1 / RATE_HZ)
    return np.stack([np.fft.irfft(spectrum * np.exp(-2j * np.pi * f * d), len(signal)) for d in delays_s], axis=1)


def free_field(seed: int, sources_m: list[list[float]], mics_m: np.ndarray, seconds: float = 1.5) -> np.ndarray:
    """White sources of equal power at positions, received with 1 / r, (n, m) float32."""
    rng, total = np.random.default_rng(seed), 0.0
    for position in sources_m:
        distance = np.linalg.norm(mics_m - np.array(position), axis=1)
        total = total + delayed(rng.standard_normal(int(seconds * RATE_HZ)), distance / 343.0) / distance
    return np.asarray(0.1 * total, np.float32)


def header(mics_m: np.ndarray, pairs: np.ndarray, **more: object) -> Header:
    array = MicArray("a", "microphones", mics_m, RATE_HZ, pairs)
    return Header("test", (array,), np.eye(4)[None], **{"box_m": BOX_M, "nominal": {"height_m": 1.5}, **more})  # type: ignore[arg-type]


def scans(front_end: FrontEnd, recording: Header, samples: np.ndarray, cuts: list[int] | None = None) -> tuple[Setup, list[Scan]]:
    """All scans, the samples cut into blocks at `cuts`."""
    setup, state = front_end.open(recording)
    out: list[Scan] = []
    edges = [0, *sorted(cuts or []), len(samples)]
    for a, b in pairwise(edges):
        state, done = front_end.step(state, Block("a", a, samples[a:b]))
        out += done
    return setup, out + front_end.flush(state)
