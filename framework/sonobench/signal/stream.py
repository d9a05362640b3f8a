"""Blocks → delay tables frame by frame: preprocessing, framing, activity, correlation and averaging, with all memory in a State."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonobench.errors import PluginError, SetupError
from sonobench.protocols import Activity, Delay, Preprocessor, State
from sonobench.signal.correlation import TablePlan, plan_tables
from sonobench.signal.framing import Frames, Framing, Tail, WindowName, drain, empty_tail, framing, mean_square, push
from sonobench.signal.preprocessing import ChainState, begin, finish, passed_hz, through
from sonobench.signal.rig import Rig
from sonobench.types import Array, Block, Bools, Header


@dataclass(frozen=True, slots=True, eq=False)
class TableFrame:
    """One frame's correlations.

    Attributes:
        time_s: centre of the analysed samples.
        values: (P, lags) float32, averaged over the memory, or None where no voice is active.
        heard: (P,) False where a microphone of the pair gave only zeros, or all where no voice is active.
    """

    time_s: float
    values: NDArray[np.float32] | None
    heard: Bools


@dataclass(frozen=True, slots=True, eq=False)
class StreamState:
    """Memory of a stream: each array's preprocessors, waiting samples, the activity's own, sums (P, lags) and weights (P,) of past tables.

    `spectra` holds the decayed sums of cross-spectra (P, bins) and power (mic, bins) for estimators that average them, else None.
    """

    chains: tuple[ChainState, ...]
    tail: Tail
    activity: State
    total: Array
    weight: Array
    spectra: tuple[Any, Any] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class TableStream:
    """What a front end on delay tables shares with any other.

    Attributes:
        framing, plan: how frames are cut and correlated.
        delay, activity: the front end's components.
        keep: share of the past that one hop leaves, in [0, 1).
        preprocess: what samples go through first, one after another.
        keep_spectra: the same share for the spectra of an estimator that averages them.
    """

    framing: Framing
    plan: TablePlan
    delay: Delay
    activity: Activity
    keep: float
    preprocess: tuple[Preprocessor, ...] = ()
    keep_spectra: float = 0.0

    def start(self) -> StreamState:
        """State before the first block."""
        pairs = len(self.plan.pairs)
        total = np.zeros((pairs, self.plan.columns))
        arrays = zip(self.framing.arrays, self.framing.channels, strict=True) if self.preprocess else ()
        chains = tuple(begin(self.preprocess, name, channels, self.framing.rate_hz) for name, channels in arrays)
        return StreamState(chains, empty_tail(self.framing), self.activity.start(self.framing.rate_hz), total, np.zeros(pairs))

    def step(self, state: StreamState, block: Block) -> tuple[StreamState, list[TableFrame]]:
        """Take a block; the frames of each group that it completes."""
        chains, ready = through(self.preprocess, state.chains, block)
        state = replace(state, chains=chains)
        return (state, []) if ready is None else self._framed(state, ready)

    def flush(self, state: StreamState) -> list[TableFrame]:
        """What the preprocessors still held, and the whole frames that still waited for their group."""
        out: list[TableFrame] = []
        for chain in state.chains:
            rest = finish(self.preprocess, chain)
            if rest is not None:
                state, frames = self._framed(state, rest)
                out += frames
        return out + [frame for group in drain(self.framing, state.tail) for frame in self._group(state, group)[1]]

    def _framed(self, state: StreamState, block: Block) -> tuple[StreamState, list[TableFrame]]:
        tail, groups = push(self.framing, state.tail, block)
        state, out = replace(state, tail=tail), []
        for group in groups:
            state, frames = self._group(state, group)
            out += frames
        return state, out

    def _group(self, state: StreamState, group: Frames) -> tuple[StreamState, list[TableFrame]]:
        memory, active = self.activity.active(state.activity, group.samples)
        active = np.asarray(active, bool)
        if active.shape != (len(group.samples),):
            raise PluginError(
                f"activity {type(self.activity).__name__} gave shape {active.shape} for {len(group.samples)} frames; one bool a frame is needed"
            )
        alive = mean_square(group.samples) > 0.0
        heard = active[:, None] & alive[:, self.plan.pairs[:, 0]] & alive[:, self.plan.pairs[:, 1]]
        voiced = np.flatnonzero(active)
        tables, spectra = self._correlated(group, voiced, heard[voiced], state.spectra) if len(voiced) else (None, state.spectra)
        total, weight, out = state.total, state.weight, []
        row: Iterator[Any] = iter(() if tables is None else tables)
        for f in range(len(active)):
            values = next(row) if active[f] else None
            if self.keep > 0.0:
                total, weight, values = self._averaged(total, weight, values, heard[f])
            out.append(TableFrame(self.framing.time_s(group.first + f), values, heard[f]))
        return replace(state, activity=memory, total=total, weight=weight, spectra=spectra), out

    def _correlated(self, group: Frames, voiced: Any, heard: Bools, past: Any) -> tuple[NDArray[np.float32], Any]:
        with np.errstate(invalid="ignore", divide="ignore"):  # 0 / 0 of a dead microphone, which is masked below
            if hasattr(self.delay, "weigh"):
                tables, past = self._weighed(group.samples[voiced], past)
            else:
                tables = self.plan.tables(self.delay, self.plan.spectra(group.samples[voiced]))
        tables = np.where(heard[..., None], tables, np.float32(0.0))
        if not np.isfinite(tables).all():
            f, p, _ = np.argwhere(~np.isfinite(tables))[0]
            raise PluginError(
                f"delay estimator {type(self.delay).__name__} gave NaN or infinity for pair {p} "
                f"at {self.framing.time_s(group.first + voiced[f]):.3f} s although both microphones have sound; guard its division"
            )
        return tables, past

    def _weighed(self, frames: Any, past: Any) -> tuple[NDArray[np.float32], Any]:
        """Tables of an estimator that weighs averaged spectra; the average decays from voiced frame to voiced frame."""
        tables, batch = np.empty((len(frames), len(self.plan.pairs), self.plan.columns), np.float32), self.plan.batch
        for f in range(0, len(frames), batch):
            tables[f : f + batch], past = self._weighed_few(frames[f : f + batch], past)
        return tables, past

    def _weighed_few(self, frames: Any, past: Any) -> tuple[NDArray[np.float32], Any]:
        delay: Any = self.delay
        cross, power = self.plan.welch(frames, delay.segments)
        if self.keep_spectra > 0.0:
            cross, power = cross.copy(), power.copy()
            for f in range(len(frames)):
                if past is not None:
                    cross[f] = self.keep_spectra * past[0] + (1.0 - self.keep_spectra) * cross[f]
                    power[f] = self.keep_spectra * past[1] + (1.0 - self.keep_spectra) * power[f]
                past = cross[f], power[f]
        weighted = np.asarray(delay.weigh(cross, power, self.plan.pairs))
        if weighted.shape != cross.shape:
            raise PluginError(
                f"delay estimator {type(delay).__name__}: weigh gave shape {weighted.shape}; that of the cross-spectra, {cross.shape}, is needed"
            )
        return self.plan.weighted_tables(weighted.astype(np.complex64, copy=False)), past

    def _averaged(self, total: Array, weight: Array, values: Any, heard: Bools) -> tuple[Array, Array, Any]:
        total, weight = total * self.keep, weight * self.keep
        if values is None:
            return total, weight, None
        total, weight = total + values, weight + heard
        mean = np.divide(total, weight[:, None], out=np.zeros_like(total), where=heard[:, None])
        return total, weight, mean.astype(np.float32)


def open_stream(
    unit: Rig,
    header: Header,
    parts: tuple[Delay, Activity, tuple[Preprocessor, ...]],
    cut: tuple[float, float, WindowName],
    oversampling: int,
    memory_s: float,
) -> TableStream:
    """The stream of a recording's rig.

    Args:
        unit: the rig.
        header: of the recording; its `band_hz`, and what the preprocessors leave of it, bounds the spectra.
        parts: delay estimator, activity detector and preprocessors.
        cut: frame_s, hop_s and window name.
        oversampling: columns of a table a lag.
        memory_s: time constant of the exponential average over frames, 0 for none.

    Raises:
        SetupError: the frame is too short for the delays or at this rate.
    """
    if oversampling < 1 or memory_s < 0.0:
        raise SetupError(f"oversampling is {oversampling} and memory_s {memory_s}; at least 1 and 0 are needed")
    frame_s, hop_s, name = cut
    cutting = framing(unit.arrays, frame_s, hop_s, unit.rate_hz, header.start_s)
    band_hz = passed_hz(parts[2], header.band_hz, unit.rate_hz)
    plan = plan_tables(unit.pairs, unit.rate_hz, name, cutting.length, float(unit.max_delay_s.max()), band_hz, oversampling)
    keep = float(np.exp(-cutting.hop / cutting.rate_hz / memory_s)) if memory_s > 0.0 else 0.0
    delay = _bound(parts[0], unit, header.c_m_s, unit.rate_hz / plan.fft_length)
    return TableStream(cutting, plan, delay, parts[1], keep, parts[2], _keep_spectra(delay, cutting, plan))


def _bound(delay: Delay, unit: Rig, c_m_s: float, bin_hz: float) -> Delay:
    """The estimator that knows how far apart the pairs' microphones are, where it wants to."""
    if not hasattr(delay, "bind"):
        return delay
    spacing_m = np.linalg.norm(unit.room[unit.pairs[:, 0]] - unit.room[unit.pairs[:, 1]], axis=-1)
    bound: Delay = delay.bind(bin_hz, spacing_m, c_m_s)
    return bound


def _keep_spectra(delay: Any, cutting: Framing, plan: TablePlan) -> float:
    """Share of the averaged spectra that one hop leaves.

    Raises:
        SetupError: segments are too short for the delays, or the averages' parameters make no sense.
    """
    if not hasattr(delay, "weigh"):
        return 0.0
    who = f"delay estimator {type(delay).__name__}"
    if delay.segments < 1 or delay.memory_s < 0:
        raise SetupError(f"{who}: segments is {delay.segments} and memory_s {delay.memory_s}; at least 1 and 0 are needed")
    length_s = 2 * cutting.length // (delay.segments + 1) / cutting.rate_hz
    reach_s = -plan.start_s
    if 2 * reach_s > length_s:
        raise SetupError(
            f"{who}: {delay.segments} segments of a frame of {cutting.length / cutting.rate_hz:.4g} s have {length_s:.4g} s each, too short for "
            f"delays up to {reach_s:.4g} s; raise frame_s or lower segments"
        )
    return float(np.exp(-cutting.hop / cutting.rate_hz / delay.memory_s)) if delay.memory_s > 0.0 else 0.0
