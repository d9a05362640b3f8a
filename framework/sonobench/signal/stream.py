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
from sonobench.signal.preprocessing import ChainState, advance, begin, finish, passed_hz
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
    """Memory of a stream: each array's preprocessors, waiting samples, the activity's own, sums (P, lags) and weights (P,) of past tables."""

    chains: tuple[ChainState, ...]
    tail: Tail
    activity: State
    total: Array
    weight: Array


@dataclass(frozen=True, slots=True, eq=False)
class TableStream:
    """What a front end on delay tables shares with any other.

    Attributes:
        framing, plan: how frames are cut and correlated.
        delay, activity: the front end's components.
        keep: share of the past that one hop leaves, in [0, 1).
        preprocess: what samples go through first, one after another.
    """

    framing: Framing
    plan: TablePlan
    delay: Delay
    activity: Activity
    keep: float
    preprocess: tuple[Preprocessor, ...] = ()

    def start(self) -> StreamState:
        """State before the first block."""
        pairs = len(self.plan.pairs)
        total = np.zeros((pairs, self.plan.columns))
        arrays = zip(self.framing.arrays, self.framing.channels, strict=True) if self.preprocess else ()
        chains = tuple(begin(self.preprocess, name, channels, self.framing.rate_hz) for name, channels in arrays)
        return StreamState(chains, empty_tail(self.framing), self.activity.start(self.framing.rate_hz), total, np.zeros(pairs))

    def step(self, state: StreamState, block: Block) -> tuple[StreamState, list[TableFrame]]:
        """Take a block; the frames of each group that it completes."""
        for a, chain in enumerate(state.chains):
            if chain.array == block.array:
                after, ready = advance(self.preprocess, chain, block)
                state = replace(state, chains=(*state.chains[:a], after, *state.chains[a + 1 :]))
                return (state, []) if ready is None else self._framed(state, ready)
        return self._framed(state, block)

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
        tables = self._correlated(group, voiced, heard[voiced]) if len(voiced) else None
        total, weight, out = state.total, state.weight, []
        row: Iterator[Any] = iter(() if tables is None else tables)
        for f in range(len(active)):
            values = next(row) if active[f] else None
            if self.keep > 0.0:
                total, weight, values = self._averaged(total, weight, values, heard[f])
            out.append(TableFrame(self.framing.time_s(group.first + f), values, heard[f]))
        return replace(state, activity=memory, total=total, weight=weight), out

    def _correlated(self, group: Frames, voiced: Any, heard: Bools) -> NDArray[np.float32]:
        spectra = self.plan.spectra(group.samples[voiced])
        with np.errstate(invalid="ignore", divide="ignore"):  # 0 / 0 of a dead microphone, which is masked below
            tables = self.plan.tables(self.delay, spectra)
        tables = np.where(heard[..., None], tables, np.float32(0.0))
        if not np.isfinite(tables).all():
            f, p, _ = np.argwhere(~np.isfinite(tables))[0]
            raise PluginError(
                f"delay estimator {type(self.delay).__name__} gave NaN or infinity for pair {p} "
                f"at {self.framing.time_s(group.first + voiced[f]):.3f} s although both microphones have sound; guard its division"
            )
        return tables

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
    return TableStream(cutting, plan, parts[0], parts[1], keep, parts[2])
