"""The delay at which each pair's generalised cross-correlation is highest, all pairs of a frame as one row of delays.

One row holds what the pairs heard of one talker, which a single highest point can only mean while one talker sounds. A
recording with isolated talkers (simulator option `isolated`) has one copy of its arrays for each; every copy in whose
frame voice is active gives a row, and all rows are one set, sorted by their delays, so that neither order nor sensor
tells which copy a row came from. An ordinary recording has one copy: one row a frame.
Source: Knapp & Carter 1976; Chen, Chen, Yin & Hou 2012, eq. 42 and 43.
Deviations: the highest column is refined by the parabola through its neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from sonobench import Block, Detections, Header, Scan, Setup, SetupError
from sonobench.protocols import Activity, Delay, Preprocessor, State
from sonobench.signal import Rig, StreamState, TableFrame, TableStream, WindowName, open_stream, refine, rig, stack_sensor
from sonobench.types import Array, Bools, Floats, MicArray
from sonobench_plugins.activity.energy import Energy
from sonobench_plugins.delay.phat import Phat


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """Streams and memories of the copies, frames that wait for those of other copies, and the pairs' largest delays (P,)."""

    streams: tuple[TableStream, ...]
    memories: tuple[StreamState, ...]
    waiting: tuple[tuple[TableFrame, ...], ...]
    limit_s: Array


@dataclass(frozen=True)
class GccMax:
    """The highest point of every pair's correlation within its aperture; ONE "tdoa" sensor "stack" of all pairs."""

    frame_s: float = 0.032  #: length of a frame
    hop_s: float = 0.032  #: time between scans
    window: WindowName = "hann"  #: rectangular, hamming or hann
    pairs: Literal["scene", "all"] = "scene"  #: the pairs that the scene names, or every two microphones
    preprocess: tuple[Preprocessor, ...] = ()  #: what samples go through before they are framed, one after another
    delay: Delay = field(default_factory=Phat)  #: delay estimator
    activity: Activity = field(default_factory=Energy)  #: voice activity, of each copy by itself
    memory_s: float = 0.0  #: time constant of the average over frames, 0 for none
    oversampling: int = 4  #: table columns a lag

    def open(self, header: Header) -> tuple[Setup, State]:
        """Plan the tables; SetupError where there are no microphones or pairs, the frame is too short, or arrays differ in their copies."""
        copies = _copies(header)
        units = [rig(copy, self.pairs, "gcc-max") for copy in copies]
        streams = tuple(self._stream(unit, copy) for unit, copy in zip(units, copies, strict=True))
        cutting, first = streams[0].framing, units[0]
        setup = Setup.from_header(header, [stack_sensor(first)], cutting.hop / cutting.rate_hz, first.rate_hz)
        return setup, _State(streams, tuple(s.start() for s in streams), ((),) * len(streams), first.max_delay_s)

    def step(self, state: State, block: Block) -> tuple[State, list[Scan]]:
        """Take samples, return the scans of the frames that they complete in all copies."""
        fresh = [s.step(m, block) for s, m in zip(state.streams, state.memories, strict=True)]
        waiting = [(*w, *frames) for w, (_, frames) in zip(state.waiting, fresh, strict=True)]
        ready = min(map(len, waiting))
        scans = [self._scan(state, frames) for frames in zip(*(w[:ready] for w in waiting), strict=True)]
        return _State(state.streams, tuple(m for m, _ in fresh), tuple(w[ready:] for w in waiting), state.limit_s), scans

    def flush(self, state: State) -> list[Scan]:
        """The scans of the last whole frames; a copy that ends before the others hears nothing more."""
        left = [(*w, *s.flush(m)) for s, m, w in zip(state.streams, state.memories, state.waiting, strict=True)]
        return [self._scan(state, [w[k] for w in left if k < len(w)]) for k in range(max(map(len, left)))]

    def _stream(self, unit: Rig, header: Header) -> TableStream:
        cut = (self.frame_s, self.hop_s, self.window)
        return open_stream(unit, header, (self.delay, self.activity, self.preprocess), cut, self.oversampling, self.memory_s)

    def _scan(self, state: _State, frames: tuple[TableFrame, ...] | list[TableFrame]) -> Scan:
        plan, time_s = state.streams[0].plan, frames[0].time_s
        voiced = [(f.values, f.heard) for f in frames if f.values is not None and f.heard.any()]
        if not voiced:
            return Scan(time_s, np.zeros(1, bool))
        allowed = np.abs(plan.start_s + plan.step_s * np.arange(plan.columns)) <= state.limit_s[:, None]
        found = [_highest(values, allowed) for values, _ in voiced]
        tau = np.array([plan.start_s + plan.step_s * at for at, _ in found])
        valid = np.array([heard for _, heard in voiced])
        z = np.where(valid, np.clip(tau, -state.limit_s, state.limit_s), 0.0)
        score = np.array([height[heard].mean() for (_, height), (_, heard) in zip(found, voiced, strict=True)])
        order = np.lexsort(z.T[::-1])
        rows = Detections(z[order], np.zeros(len(z), np.int64), score=score[order], valid=valid[order])
        return Scan(time_s, np.ones(1, bool), (rows,))


def _highest(tables: Floats, allowed: Bools) -> tuple[Array, Array]:
    """Column (P,), with its fraction, and height (P,) of the highest allowed point of tables (P, k); an edge is not refined."""
    row = np.arange(len(tables))
    at = np.argmax(np.where(allowed, tables, -np.inf), axis=1)
    left, right = np.maximum(at - 1, 0), np.minimum(at + 1, tables.shape[1] - 1)
    inner = (tables[row, at] > tables[row, left]) & (tables[row, at] >= tables[row, right])
    offset, height = refine(tables[row, left], tables[row, at], tables[row, right])
    return np.where(inner, at + offset, at), np.where(inner, height, tables[row, at])


def _copies(header: Header) -> list[Header]:
    """The header cut into copies of its microphone arrays: arrays of equal elements, pairs and rate that stand at the same place."""
    groups: dict[tuple[object, ...], list[tuple[MicArray, Array]]] = {}
    for array in header.arrays:
        if array.kind == "microphones":
            pose = header.poses[header.array_names.index(array.name)]
            key = (array.elements.tobytes(), array.pairs.tobytes(), array.rate_hz, pose.tobytes())
            groups.setdefault(key, []).append((array, pose))
    counts = {group[0][0].name: len(group) for group in groups.values()}
    if len(set(counts.values())) > 1:
        raise SetupError(f"gcc-max joins the copies of one talker over all arrays; recording {header.name} has unequal numbers {counts}")
    if not groups:
        return [header]
    parts = [list(part) for part in zip(*groups.values(), strict=True)]
    return [
        replace(header, arrays=tuple(a for a, _ in part), array_names=tuple(a.name for a, _ in part), poses=np.stack([p for _, p in part]))
        for part in parts
    ]
