"""Recordings, scans and estimates for the tests of `sonobench.log`."""

from __future__ import annotations

import string
from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sonobench.protocols import Rendering
from sonobench.types import Block, DelayTable, Detections, DirectionSpectrum, Estimate, Header, MicArray, Scan, Sensor, Space, Truth

RATE_HZ = 800.0


def rendering(seed: int = 0, duration_s: float = 0.5, block: int = 37) -> Rendering:
    """Two arrays of different rates and kinds, scans, truth and a clean source; blocks of `block` samples."""
    rng = np.random.default_rng(seed)
    pair = MicArray("pair/left", "microphones", rng.normal(size=(2, 3)), RATE_HZ, np.array([[0, 1]]))
    vector = MicArray("vector", "avs", rng.normal(size=(1, 3)), RATE_HZ / 2)
    sensor = Sensor("tau", "pair/left", "tdoa", pair.elements, Space.of("tau_s"), pair.pairs)
    header = Header(
        name="small",
        arrays=(pair, vector),
        poses=np.stack([np.eye(4), np.eye(4)]),
        sensors=(sensor, sensor),
        duration_s=duration_s,
        period_s=0.1,
        box_m=np.array([[0.0, 0, 0], [3, 3, 2.5]]),
        nominal={"p_d": 0.9},
        given={"births": rng.normal(size=(2, 3)), "count": np.float64(2), "nothing": np.zeros((0, 3))},
    )
    blocks = [piece for array in (pair, vector) for piece in cut(array, noise(rng, array, duration_s), block)]
    blocks.sort(key=lambda b: b.first_sample / (RATE_HZ if b.array == "pair/left" else RATE_HZ / 2))
    times = np.arange(round(duration_s / 0.1)) * 0.1
    return Rendering(
        header=header,
        blocks=blocks,
        scans=[scan(rng, t) for t in times],
        truth=truth(rng, times),
        sources={"talker": (RATE_HZ, rng.normal(size=131).astype(np.float32)), "silent": (RATE_HZ, np.zeros(0, np.float32))},
        provenance={"seed": seed, "scene": {"name": "small", "sizes": np.array([1.0, 2.0])}},
    )


def noise(rng: np.random.Generator, array: MicArray, duration_s: float) -> np.ndarray:
    """(n, channels) float32."""
    return rng.normal(size=(round(duration_s * array.rate_hz), array.channels)).astype(np.float32)


def cut(array: MicArray, samples: np.ndarray, length: int) -> list[Block]:
    """Samples in blocks of `length`, the last one shorter."""
    return [Block(array.name, first, samples[first : first + length]) for first in range(0, len(samples), length)]


def scan(rng: np.random.Generator, time_s: float) -> Scan:
    """A scan with every optional part."""
    rows = int(rng.integers(0, 4))
    group = Detections(
        z=rng.normal(size=(rows, 1)),
        sensor=rng.integers(0, 2, rows),
        R=np.ones((rows, 1, 1)),
        score=rng.normal(size=rows),
        valid=np.ones((rows, 1), bool),
    )
    table = DelayTable(rng.normal(size=(2, 5)).astype(np.float32), -1e-3, 5e-4)
    return Scan(time_s, np.array([True, False]), (group,), {"gcc": table}, np.stack([np.eye(4)] * 2), {"energy": rng.normal(size=2)})


def truth(rng: np.random.Generator, times: np.ndarray) -> Truth:
    """Two targets with modes, without velocities."""
    k = len(times)
    return Truth(
        time_s=times,
        label=np.array([3, -1]),
        position=rng.normal(size=(k, 2, 3)),
        exists=rng.random((k, 2)) < 0.8,
        active=rng.random((k, 2)) < 0.4,
        mode=rng.integers(-1, 2, (k, 2)),
        valid=rng.random(k) < 0.9,
        period_s=0.1,
        parameters={"snr_db": 20.0},
    )


def joined(blocks: Any, array: str) -> np.ndarray:
    """The samples of one array, (n, channels)."""
    return np.concatenate([b.samples for b in blocks if b.array == array])


_names = st.text(string.ascii_letters + "é/ _", max_size=6)
_floats = st.floats(width=64)  # NaN, infinities, −0 and subnormals included
_finite = st.floats(allow_nan=False, allow_infinity=False)
_times = st.floats(0, 1e9)


def _array(shape: Any, dtype: Any = np.float64, elements: Any = _floats) -> Any:
    return arrays(dtype, shape, elements=elements)


def _or_none(strategy: Any) -> Any:
    return st.none() | strategy


@st.composite
def detections(draw: Any) -> Detections:
    m, dz = draw(st.integers(0, 3)), draw(st.integers(0, 2))
    return Detections(
        z=draw(_array((m, dz), elements=_finite)),
        sensor=draw(_array((m,), np.int64, st.integers(-(2**63), 2**63 - 1))),
        R=draw(_or_none(_array((m, dz, dz)))),
        score=draw(_or_none(_array((m,)))),
        valid=draw(_or_none(_array((m, dz), np.bool_, st.booleans()))),
    )


@st.composite
def delay_tables(draw: Any) -> DelayTable:
    shape = (draw(st.integers(0, 3)), draw(st.integers(0, 4)))
    return DelayTable(draw(_array(shape, np.float32, st.floats(width=32))), draw(_floats), draw(_floats), draw(_names))


@st.composite
def direction_spectra(draw: Any) -> DirectionSpectrum:
    rows, b = draw(st.integers(0, 2)), draw(st.sampled_from([4, 10]))
    shape = (rows, b, b)
    heard = draw(_array((rows,), np.bool_, st.booleans()))
    return DirectionSpectrum(draw(_array(shape)), draw(_array(shape)), draw(_array((rows,))), draw(_array((rows,))), heard)


@st.composite
def scans(draw: Any) -> Scan:
    return Scan(
        time_s=draw(_times),
        searched=draw(_array((draw(st.integers(0, 3)),), np.bool_, st.booleans())),
        detections=tuple(draw(st.lists(detections(), max_size=2))),
        fields=draw(st.dictionaries(_names, delay_tables() | direction_spectra(), max_size=2)),
        pose=draw(_or_none(_array((draw(st.integers(0, 2)), 4, 4)))),
        extra=draw(st.dictionaries(_names, st.sampled_from([(), (0,), (2, 0, 3), (1, 2)]).flatmap(_array), max_size=2)),
    )


@st.composite
def estimates(draw: Any) -> Estimate:
    n, d = draw(st.integers(0, 3)), draw(st.integers(0, 3))
    return Estimate(
        time_s=draw(_times),
        states=draw(_array((n, d), elements=_finite)),
        covs=draw(_or_none(_array((n, d, d)))),
        labels=draw(_or_none(_array((n,), np.int64, st.integers(-(2**63), 2**63 - 1)))),
        existence=draw(_or_none(_array((n,)))),
        count=draw(_or_none(_floats)),
        info=draw(st.dictionaries(_names, _floats, max_size=2)),
    )
