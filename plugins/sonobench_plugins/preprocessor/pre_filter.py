"""A high pass, low pass or band pass: Butterworth, causal, in second-order sections.

Source: Liang 2016, 2.2.1, which names the three kinds and no design; Butterworth 1930, "On the theory of filter amplifiers".
A causal filter delays sound, low frequencies more than high ones, by the same on every channel: delays between channels stay as
they were, and time stamps are early by the group delay (about order / (2 pi) periods of a high pass's cut-off, at that
frequency). Filtering forwards and backwards would leave no delay, but needs the end of the recording first.
A delay estimator that whitens (PHAT) divides any filter of both channels out again. What then counts is which frequencies are
left out altogether: with `narrow` front ends transform only what the filter passes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sonobench.errors import SetupError
from sonobench.protocols import State
from sonobench.types import Array


class _Running(NamedTuple):
    sections: Array  # (s, 6)
    memory: Array  # (s, 2, channels)


@dataclass(frozen=True)
class PreFilter:
    """Butterworth filter with cut-offs at −3 dB; by default a high pass against hum and rumble."""

    low_hz: float | None = 100.0  #: lower cut-off; None: a low pass
    high_hz: float | None = None  #: upper cut-off; None: a high pass
    order: int = 4  #: of each edge; the slope is 6 dB an octave times this
    narrow: bool = True  #: front ends leave what lies beyond the cut-offs out of their transforms

    def __post_init__(self) -> None:
        edges = [e for e in (self.low_hz, self.high_hz) if e is not None]
        if not edges or not all(0 < e < np.inf for e in edges) or sorted(set(edges)) != edges:
            raise ValueError(
                f"low_hz is {self.low_hz} and high_hz {self.high_hz}; one positive cut-off, or a lower and an upper, are needed"
            )
        if not 1 <= self.order <= 12:
            raise ValueError(f"order is {self.order}; 1 to 12 is needed (steeper filters ring longer than sounds last)")

    @property
    def passes_hz(self) -> tuple[float, float] | None:
        """The cut-offs, or None where front ends are to keep the whole band."""
        return (self.low_hz or 0.0, self.high_hz or np.inf) if self.narrow else None

    def start(self, rate_hz: float, channels: int) -> State:
        """At rest.

        Raises:
            SetupError: a cut-off is not below half the rate.
        """
        from scipy.signal import butter

        edges = [e for e in (self.low_hz, self.high_hz) if e is not None]
        if edges[-1] >= rate_hz / 2:
            raise SetupError(f"pre-filter cuts at {edges[-1]:g} Hz; at {rate_hz:g} Hz a cut-off below {rate_hz / 2:g} Hz is needed")
        kind = "bandpass" if len(edges) == 2 else "lowpass" if self.low_hz is None else "highpass"
        sections = butter(self.order, edges if len(edges) == 2 else edges[0], kind, output="sos", fs=rate_hz)
        return _Running(sections, np.zeros((len(sections), 2, channels)))

    def process(self, state: State, samples: Array) -> tuple[State, Array]:
        """Filter the next (n, channels)."""
        from scipy.signal import sosfilt

        out, memory = sosfilt(state.sections, samples, axis=0, zi=state.memory)
        return _Running(state.sections, memory), out

    def finish(self, state: State) -> Array:
        """Nothing is due."""
        return np.zeros((0, state.memory.shape[2]))
