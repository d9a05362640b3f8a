"""Delays at the highest peaks of each pair's generalised cross-correlation, and the correlations as a field.

Source: Knapp & Carter 1976; detections as in Ma et al. 2006 (several peaks a pair, some of them clutter).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from sonobench import Block, DelayTable, Detections, Header, Scan, Setup
from sonobench.protocols import Activity, Delay, Preprocessor, State
from sonobench.signal import Rig, StreamState, TableFrame, TableStream, WindowName, open_stream, pair_sensors, pick, rig
from sonobench.types import Bools
from sonobench_plugins.activity.energy import Energy
from sonobench_plugins.delay.phat import Phat


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    stream: TableStream
    memory: StreamState
    allowed: Bools


@dataclass(frozen=True)
class GccPeaks:
    """Peaks of delay tables; one single-pair "tdoa" sensor a pair."""

    frame_s: float = 0.128  #: length of a frame
    hop_s: float = 0.064  #: time between scans
    window: WindowName = "hann"  #: rectangular, hamming or hann
    pairs: Literal["scene", "all"] = "scene"  #: the pairs that the scene names, or every two microphones
    preprocess: tuple[Preprocessor, ...] = ()  #: what samples go through before they are framed, one after another
    delay: Delay = field(default_factory=Phat)  #: delay estimator
    activity: Activity = field(default_factory=Energy)  #: voice activity
    relative: float = 0.5  #: least height of a peak, as a share of the pair's highest
    absolute: float = 0.1  #: least height of a peak; 1 is full coherence
    max_peaks: int = 4  #: peaks of a pair at most
    margin_s: float = 5e-5  #: how far beyond the pair's aperture a peak may lie
    memory_s: float = 0.0  #: time constant of the average over frames, 0 for none
    oversampling: int = 4  #: table columns a lag

    def open(self, header: Header) -> tuple[Setup, State]:
        """Plan the tables; SetupError where there are no microphones or pairs, or the frame is too short."""
        unit = rig(header, self.pairs, "gcc-peaks")
        cut = (self.frame_s, self.hop_s, self.window)
        wide = replace(unit, max_delay_s=unit.max_delay_s + self.margin_s)
        stream = open_stream(wide, header, (self.delay, self.activity, self.preprocess), cut, self.oversampling, self.memory_s)
        period_s = stream.framing.hop / stream.framing.rate_hz
        setup = Setup.from_header(header, pair_sensors(unit), period_s, unit.rate_hz)
        return setup, _State(stream, stream.start(), self._allowed(stream, unit))

    def step(self, state: State, block: Block) -> tuple[State, list[Scan]]:
        """Take samples, return the scans of the groups of frames that they complete."""
        memory, frames = state.stream.step(state.memory, block)
        return _State(state.stream, memory, state.allowed), [self._scan(state, f) for f in frames]

    def flush(self, state: State) -> list[Scan]:
        """The scans of the last whole frames."""
        return [self._scan(state, f) for f in state.stream.flush(state.memory)]

    def _allowed(self, stream: TableStream, unit: Rig) -> Bools:
        lag_s = stream.plan.start_s + stream.plan.step_s * np.arange(stream.plan.columns)
        return np.abs(lag_s) <= unit.max_delay_s[:, None] + self.margin_s

    def _scan(self, state: _State, frame: TableFrame) -> Scan:
        if frame.values is None:
            return Scan(frame.time_s, frame.heard)
        plan, values = state.stream.plan, frame.values
        highest = np.where(state.allowed, values, 0.0).max(axis=1)
        floor = np.maximum(self.relative * highest, self.absolute)
        pair, column, height = pick(values, state.allowed & frame.heard[:, None], floor, self.max_peaks)
        z = (plan.start_s + plan.step_s * column)[:, None]
        table = DelayTable(values, plan.start_s, plan.step_s)
        return Scan(frame.time_s, frame.heard, (Detections(z, pair, score=height),), {"gcc": table})
