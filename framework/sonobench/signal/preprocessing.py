"""Preprocessors one after another on the blocks of one array, and what they leave of its band.

One place for all front ends: `TableStream` puts every block through the chain before it frames it. Blocks that come out
carry the sample numbers of those that went in, so a chain that answers late delays the scans, and shifts no time stamp.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sonobench.errors import PluginError, SetupError
from sonobench.protocols import Preprocessor, State
from sonobench.signal.framing import check_block
from sonobench.types import Array, Block

Chain = tuple[Preprocessor, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ChainState:
    """Memory of a chain: its array and channels, each member's own state, and how many samples came and went."""

    array: str
    channels: int
    memories: tuple[State, ...]
    taken: int = 0
    given: int = 0


def begin(chain: Chain, array: str, channels: int, rate_hz: float) -> ChainState:
    """The state before an array's first block."""
    return ChainState(array, channels, tuple(one.start(rate_hz, channels) for one in chain))


def advance(chain: Chain, state: ChainState, block: Block) -> tuple[ChainState, Block | None]:
    """Take the array's next block; return the samples that are ready, None for none.

    Raises:
        InputError: the block does not go on where the last ended, or holds NaN or infinity.
        PluginError: a preprocessor's answer has another shape, more samples than it got, or NaN.
    """
    check_block(block, state.channels, state.taken)
    samples, memories = np.asarray(block.samples, np.float64), []
    for one, before in zip(chain, state.memories, strict=True):
        after, ready = one.process(before, samples) if len(samples) else (before, samples)
        samples = _checked(one, ready, state)
        memories.append(after)
    return _handed(state, tuple(memories), state.taken + len(block.samples), samples)


def through(chain: Chain, states: tuple[ChainState, ...], block: Block) -> tuple[tuple[ChainState, ...], Block | None]:
    """`advance` of the array that the block is of, among the states of several; a block of an array without one is ready as it is."""
    for a, state in enumerate(states):
        if state.array == block.array:
            after, ready = advance(chain, state, block)
            return (*states[:a], after, *states[a + 1 :]), ready
    return states, block


def finish(chain: Chain, state: ChainState) -> Block | None:
    """The samples that were still due when the array ended, None for none.

    Raises:
        PluginError: not as many samples came out as went in.
    """
    samples = np.zeros((0, state.channels))
    for one, before in zip(chain, state.memories, strict=True):
        after, ready = one.process(before, samples) if len(samples) else (before, samples)
        samples = _checked(one, np.concatenate([ready, one.finish(after)]), state)
    end, block = _handed(state, state.memories, state.taken, samples)
    if end.given != end.taken:
        raise PluginError(
            f"the preprocessors {_names(chain)} took {end.taken} samples of array {state.array} and gave {end.given}; "
            "`finish` must return all that are still due"
        )
    return block


def passed_hz(chain: Chain, band_hz: Array | None, rate_hz: float) -> Array | None:
    """What a chain leaves of a band (low, high); `band_hz` itself where no member narrows it.

    Raises:
        SetupError: nothing is left.
    """
    edges = [tuple(one.passes_hz) for one in chain if getattr(one, "passes_hz", None) is not None]  # type: ignore[attr-defined]
    if not edges:
        return band_hz
    bands = np.array([(0.0, rate_hz / 2) if band_hz is None else band_hz, *edges], float)
    low, high = bands[:, 0].max(), bands[:, 1].min()
    if not low < high:
        raise SetupError(f"the preprocessors {_names(chain)} leave nothing of the recording's {bands[0, 0]:g} to {bands[0, 1]:g} Hz")
    return np.array([low, high])


def _handed(state: ChainState, memories: tuple[State, ...], taken: int, samples: Array) -> tuple[ChainState, Block | None]:
    after = ChainState(state.array, state.channels, memories, taken, state.given + len(samples))
    return after, Block(state.array, state.given, samples.astype(np.float32)) if len(samples) else None


def _checked(one: Preprocessor, samples: Any, state: ChainState) -> Array:
    samples = np.asarray(samples, np.float64)
    if samples.ndim != 2 or samples.shape[1] != state.channels or not np.isfinite(samples).all():
        raise PluginError(
            f"preprocessor {type(one).__name__} gave shape {samples.shape} for array {state.array}; "
            f"finite samples (n, {state.channels}) are needed"
        )
    return samples


def _names(chain: Chain) -> str:
    return ", ".join(type(one).__name__ for one in chain)
