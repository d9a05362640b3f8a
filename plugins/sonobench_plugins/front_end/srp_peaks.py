"""Positions of steered-response-power maxima, each read back as one row of delays, so that peaks of one talker arrive together.

Source: DiBiase 2000, "A high-accuracy, low-latency technique for talker localization in reverberant environments" (SRP-PHAT);
several sources one after another as in Brutti, Omologo & Svaizer 2010, "Multiple source localization based on acoustic map
de-emphasis": the strongest point is taken, its peaks are removed from every pair's table, and the map is drawn anew.
Deviations: tables are rectified (negative correlation speaks for no position), and only the peak found in a pair is
removed, not the region around the expected delay, so a pair that did not hear the talker keeps what it heard of others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sonobench import Block, DelayTable, Detections, Header, Scan, Sensor, Setup, SetupError
from sonobench.protocols import Activity, Delay, Preprocessor, State
from sonobench.signal import (
    Picked,
    Search,
    StreamState,
    TableFrame,
    TableStream,
    WindowName,
    open_search,
    open_stream,
    pair_sensors,
    rig,
    stack_sensor,
    widened,
)
from sonobench_plugins.activity.energy import Energy
from sonobench_plugins.delay.phat import Phat


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    stream: TableStream
    memory: StreamState
    search: Search
    pairs: int


@dataclass(frozen=True)
class SrpPeaks:
    """Maxima of steered power; ONE "tdoa" sensor "stack" of all pairs (and, with `tables`, one a pair for the field)."""

    frame_s: float = 0.128  #: length of a frame
    hop_s: float = 0.064  #: time between scans
    window: WindowName = "hann"  #: rectangular, hamming or hann
    pairs: Literal["scene", "all"] = "scene"  #: pairs of the stack: those that the scene names, or every two microphones
    search: Literal["own", "all"] = "all"  #: pairs of the steered power: the stack's own, or every two microphones
    preprocess: tuple[Preprocessor, ...] = ()  #: what samples go through before they are framed, one after another
    delay: Delay = field(default_factory=Phat)  #: delay estimator
    activity: Activity = field(default_factory=Energy)  #: voice activity
    memory_s: float = 0.1  #: time constant of the average over frames, 0 for none
    oversampling: int = 2  #: table columns a lag
    grid_m: float = 0.07  #: spacing of the points searched
    height_m: float | None = None  #: height of the searched plane; None: nominal height_m
    volume: bool = False  #: search the whole room instead of a plane
    max_peaks: int = 3  #: talkers of a scan at most
    significance: float = 8.0  #: least steered power, in standard deviations above what unrelated pairs add up to
    relative: float = 0.4  #: least steered power, as a share of the scan's highest
    radius_m: float = 0.4  #: no two talkers of a scan are nearer
    window_s: float = 1e-4  #: how far a pair's peak may lie from the delay of the picked position
    pair_share: float = 0.5  #: least height of a pair's peak, as a share of the steered power
    min_pairs: int = 3  #: pairs that must have a peak
    tables: bool = False  #: offer the delay tables as field "gcc" too

    def open(self, header: Header) -> tuple[Setup, State]:
        """Plan tables and search; SetupError where there are no microphones, pairs, room or height, or the frame is too short."""
        unit = rig(header, self.pairs, "srp-peaks")
        if header.box_m is None:
            raise SetupError(f"srp-peaks searches a room; recording {header.name} has no box_m (free field or unknown): use gcc-peaks")
        cut = (self.frame_s, self.hop_s, self.window)
        searched = widened(unit, header) if self.search == "all" else unit
        stream = open_stream(searched, header, (self.delay, self.activity, self.preprocess), cut, self.oversampling, self.memory_s)
        sensors: tuple[Sensor, ...] = (stack_sensor(unit), *(pair_sensors(unit) if self.tables else ()))
        setup = Setup.from_header(header, sensors, stream.framing.hop / stream.framing.rate_hz, unit.rate_hz)
        height_m = None if self.volume else setup.value("height_m", self.height_m, "srp-peaks")
        search = open_search(searched, header, stream.plan, self.grid_m, height_m)
        return setup, _State(stream, stream.start(), search, len(unit.pairs))

    def step(self, state: State, block: Block) -> tuple[State, list[Scan]]:
        """Take samples, return the scans of the groups of frames that they complete."""
        memory, frames = state.stream.step(state.memory, block)
        return _State(state.stream, memory, state.search, state.pairs), [self._scan(state, f) for f in frames]

    def flush(self, state: State) -> list[Scan]:
        """The scans of the last whole frames."""
        return [self._scan(state, f) for f in state.stream.flush(state.memory)]

    def _scan(self, state: _State, frame: TableFrame) -> Scan:
        sensors = 1 + (state.pairs if self.tables else 0)
        searched = np.arange(sensors) == 0
        if frame.values is None or not frame.heard.any():
            return Scan(frame.time_s, np.zeros(sensors, bool))
        picks, pairs = self._picks(state, frame, frame.values), state.pairs
        rows = Detections(
            z=np.array([p.delay_s[:pairs] for p in picks]).reshape(-1, pairs),
            sensor=np.zeros(len(picks), np.int64),
            score=np.array([p.power for p in picks]),
            valid=np.array([p.valid[:pairs] for p in picks], bool).reshape(-1, pairs),
        )
        fields: dict[str, Any] = {}
        if self.tables:
            plan, blank = state.stream.plan, np.zeros((1, frame.values.shape[1]), np.float32)
            fields["gcc"] = DelayTable(np.concatenate([blank, frame.values[:pairs]]), plan.start_s, plan.step_s)
        return Scan(frame.time_s, searched, (rows,), fields)

    def _picks(self, state: _State, frame: TableFrame, values: NDArray[np.float32]) -> list[Picked]:
        search, tables = state.search, np.maximum(values, np.float32(0.0))
        heard = int(frame.heard.sum())
        # a pair that hears nothing common has independent values of the table's own mean and variance at any point
        chance = float(tables.mean(axis=1).sum()) / heard
        spread = math.sqrt(float(tables.var(axis=1).sum())) / heard
        floor, out = chance + self.significance * spread, list[Picked]()
        while len(out) < self.max_peaks:
            at, power = search.strongest(tables, heard, [p.position for p in out], self.radius_m)
            if not power >= floor:
                break
            found = search.read(tables, at, power, self.window_s, self.pair_share * power)
            if found.valid[: state.pairs].sum() < self.min_pairs:
                break
            floor = max(floor, self.relative * power)
            out.append(found)
            tables = search.without(tables, found)
        return out
