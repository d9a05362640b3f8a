"""Delays at the highest peaks of each pair's generalised cross-correlation, and the correlations as fields.

The field "gcc" is the correlation whose peaks are picked. A second one, "energy", may come of another estimator: with `cc` the sum of its
tables over all pairs at the delays of a point is the power of a beam steered there, but for a constant (every pair scaled to a coherent
peak of 1, so that microphones of different gains count alike).
Source: Knapp & Carter 1976; detections as in Ma et al. 2006 (several peaks a pair, some of them clutter).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from sonobench import Block, DelayTable, Detections, Header, Scan, Setup
from sonobench.protocols import Activity, Delay, Preprocessor, State
from sonobench.signal import Rig, StreamState, TableFrame, TableStream, WindowName, open_stream, pair_sensors, pick, rig, widened
from sonobench.types import Bools
from sonobench_plugins.activity.energy import Energy
from sonobench_plugins.delay.phat import Phat


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    stream: TableStream
    memory: StreamState
    allowed: Bools
    energy: TableStream | None = None
    energy_memory: StreamState | None = None


@dataclass(frozen=True)
class GccPeaks:
    """Peaks of delay tables; one single-pair "tdoa" sensor a pair."""

    frame_s: float = 0.128  #: length of a frame
    hop_s: float = 0.064  #: time between scans
    window: WindowName = "hann"  #: rectangular, hamming or hann
    pairs: Literal["scene", "all", "widened"] = "scene"  #: the scene's, every two microphones, or both: "pair-…", then the rest as "wide-…"
    preprocess: tuple[Preprocessor, ...] = ()  #: what samples go through before they are framed, one after another
    delay: Delay = field(default_factory=Phat)  #: delay estimator
    energy: Delay | None = None  #: estimator of a second field, "energy"; None: no such field
    activity: Activity = field(default_factory=Energy)  #: voice activity
    relative: float = 0.5  #: least height of a peak, as a share of the pair's highest
    absolute: float = 0.1  #: least height of a peak; 1 is full coherence
    max_peaks: int = 4  #: peaks of a pair at most
    margin_s: float = 5e-5  #: how far beyond the pair's aperture a peak may lie
    memory_s: float = 0.0  #: time constant of the average over frames, 0 for none
    oversampling: int = 4  #: table columns a lag

    def open(self, header: Header) -> tuple[Setup, State]:
        """Plan the tables; SetupError where there are no microphones or pairs, or the frame is too short."""
        unit = rig(header, "scene" if self.pairs == "widened" else self.pairs, "gcc-peaks")
        own = len(unit.pairs)
        unit = widened(unit, header) if self.pairs == "widened" else unit
        stream = self._stream(self.delay, unit, header)
        second = None if self.energy is None else self._stream(self.energy, unit, header)
        period_s = stream.framing.hop / stream.framing.rate_hz
        setup = Setup.from_header(header, pair_sensors(unit, own), period_s, unit.rate_hz)
        return setup, _State(stream, stream.start(), self._allowed(stream, unit), second, None if second is None else second.start())

    def step(self, state: State, block: Block) -> tuple[State, list[Scan]]:
        """Take samples, return the scans of the groups of frames that they complete."""
        memory, frames = state.stream.step(state.memory, block)
        second: list[TableFrame] = []
        energy_memory = state.energy_memory
        if state.energy is not None:
            energy_memory, second = state.energy.step(state.energy_memory, block)
        return replace(state, memory=memory, energy_memory=energy_memory), self._scans(state, frames, second)

    def flush(self, state: State) -> list[Scan]:
        """The scans of the last whole frames."""
        second = [] if state.energy is None else state.energy.flush(state.energy_memory)
        return self._scans(state, state.stream.flush(state.memory), second)

    def _stream(self, delay: Delay, unit: Rig, header: Header) -> TableStream:
        cut = (self.frame_s, self.hop_s, self.window)
        wide = replace(unit, max_delay_s=unit.max_delay_s + self.margin_s)
        return open_stream(wide, header, (delay, self.activity, self.preprocess), cut, self.oversampling, self.memory_s)

    def _allowed(self, stream: TableStream, unit: Rig) -> Bools:
        lag_s = stream.plan.start_s + stream.plan.step_s * np.arange(stream.plan.columns)
        return np.abs(lag_s) <= unit.max_delay_s[:, None] + self.margin_s

    def _scans(self, state: _State, frames: list[TableFrame], second: list[TableFrame]) -> list[Scan]:
        if state.energy is None:
            return [self._scan(state, f, None) for f in frames]
        return [self._scan(state, f, g) for f, g in zip(frames, second, strict=True)]

    def _scan(self, state: _State, frame: TableFrame, energy: TableFrame | None) -> Scan:
        if frame.values is None:
            return Scan(frame.time_s, frame.heard)
        plan, values = state.stream.plan, frame.values
        highest = np.where(state.allowed, values, 0.0).max(axis=1)
        floor = np.maximum(self.relative * highest, self.absolute)
        pair, column, height = pick(values, state.allowed & frame.heard[:, None], floor, self.max_peaks)
        z = (plan.start_s + plan.step_s * column)[:, None]
        fields = {"gcc": DelayTable(values, plan.start_s, plan.step_s)}
        if energy is not None and energy.values is not None:
            fields["energy"] = DelayTable(energy.values, plan.start_s, plan.step_s)
        return Scan(frame.time_s, frame.heard, (Detections(z, pair, score=height),), fields)
