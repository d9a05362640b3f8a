"""How often the highest point of a correlation is the delay of a talker: `gcc-max` on rendered speech against the truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sonobench.geometry import pair_delays
from sonobench.protocols import Rendering
from sonobench.scene.scene import Scene
from sonobench.scene.truth import path
from sonobench.types import Block, Header, MicArray
from sonobench_plugins.front_end.gcc_max import GccMax


@dataclass(frozen=True)
class Plain:
    """Cross-correlation without weighting."""

    def correlate(self, spectra: Any, pairs: Any) -> Any:
        return np.fft.irfft(spectra[..., pairs[:, 0], :] * spectra[..., pairs[:, 1], :].conj())


def heard_apart(made: Rendering) -> Iterator[tuple[str, Header, list[Block]]]:
    """Each copy of an isolated recording as a recording of its own, by the name of its source."""
    blocks = list(made.blocks)
    for array, pose in zip(made.header.arrays, made.header.poses, strict=True):
        header = replace(made.header, arrays=(array,), array_names=(array.name,), poses=pose[None])
        yield array.name.split("/")[1], header, [b for b in blocks if b.array == array.name]


def heard_together(made: Rendering) -> tuple[Header, list[Block]]:
    """The sum of an isolated recording's copies: the mixture, whose noise is as far below it as theirs are below each."""
    first, blocks = made.header.arrays[0], list(made.blocks)
    own = [[b for b in blocks if b.array == a.name] for a in made.header.arrays]
    mixed = [Block("sum", same[0].first_sample, sum(b.samples for b in same)) for same in zip(*own, strict=True)]
    array = MicArray("sum", first.kind, first.elements, first.rate_hz, first.pairs)
    return replace(made.header, arrays=(array,), array_names=("sum",), poses=made.header.poses[:1]), mixed


def errors(front_end: GccMax, scene: Scene, header: Header, blocks: list[Block]) -> np.ndarray:
    """(k, sources, P) s: measured minus true delay of every active frame of one array, NaN where a source does not exist."""
    setup, state = front_end.open(header)
    scans = []
    for block in blocks:
        state, done = front_end.step(state, block)
        scans += done
    scans = [s for s in [*scans, *front_end.flush(state)] if s.detections]
    time_s, sensor = np.array([s.time_s for s in scans]), setup.sensors[0]
    z = np.array([s.detections[0].z[0] for s in scans])
    out = np.full((len(scans), len(scene.sources), z.shape[1]), np.nan)
    for n, source in enumerate(scene.sources.values()):
        spans, at = source.spans(scene.duration_s), path(source, scene.duration_s, time_s)
        there = (time_s >= spans[0, 0]) & (time_s <= spans[-1, 1])
        out[there, n] = z[there] - pair_delays(at[there], sensor.elements, sensor.pairs, scene.c_m_s)
    return out
