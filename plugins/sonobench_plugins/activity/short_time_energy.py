"""End-point detection by short-time energy against the quietest or the loudest window so far.

E_n, the mean square of the N samples up to n (over all channels), slides through a frame sample by sample; a frame holds sound where its largest E_n
reaches the threshold. Two rules: "minimum" records the smallest E_n as the noise's energy and adds 10 dB; "maximum" records the largest and multiplies it by alpha.
Source: Liang 2016, 2.2.3, eq. 2-2, which uses "maximum", alpha = .1 and N = 100 samples at 8 kHz.
Deviations: the window's mean instead of its sum, so that a threshold does not depend on N. Both records are of the past and the frame itself, so
"maximum" takes everything for sound until the first sound has come (its own energy is then the record), and one click raises the threshold for good;
`record_db` begins the record at a level known beforehand. "minimum" takes a sound that never pauses for noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sonobench.errors import SetupError
from sonobench.protocols import State
from sonobench.types import Array, Bools, Floats


@dataclass(frozen=True)
class ShortTimeEnergy:
    """Energy of short windows against a record."""

    rule: Literal["minimum", "maximum"] = "maximum"  #: the record that the threshold follows
    above_db: float = 10.0  #: threshold over the smallest energy, for "minimum"
    alpha: float = 0.1  #: threshold as a share of the largest energy, for "maximum"
    window_samples: int = 100  #: N; 0: the whole frame
    record_db: float | None = None  #: level re full scale at which the record begins; None: the first frame's
    silence_db: float = -100.0  #: level re full scale below which nothing is sound or noise

    def __post_init__(self) -> None:
        if self.rule not in ("minimum", "maximum"):
            raise ValueError(f"rule is {self.rule!r}; 'minimum' or 'maximum' is needed")
        if not (0 < self.alpha <= 1 and self.above_db >= 0 and self.window_samples >= 0):
            raise ValueError(
                f"alpha is {self.alpha}, above_db {self.above_db} and window_samples {self.window_samples}; above 0 to 1, and at least 0, are needed"
            )

    def start(self, rate_hz: float) -> State:
        """The record: `record_db`, or one that any energy breaks."""
        if self.record_db is not None:
            return float(10.0 ** (self.record_db / 10.0))
        return np.inf if self.rule == "minimum" else 0.0

    def active(self, state: State, frames: Floats) -> tuple[State, Bools]:
        """Frames (f, n, channels) in order → (state, (f,) bool).

        Raises:
            SetupError: a frame is shorter than N.
        """
        energy, silence = self.energy(frames), 10.0 ** (self.silence_db / 10.0)
        loudest = energy.max(axis=1)
        if self.rule == "minimum":
            quietest = np.where(energy > silence, energy, np.inf).min(axis=1)  # digital silence is no room's noise
            record = np.minimum.accumulate(np.concatenate([[state], quietest]))
            threshold = record[1:] * 10.0 ** (self.above_db / 10.0)
        else:
            record = np.maximum.accumulate(np.concatenate([[state], loudest]))
            threshold = record[1:] * self.alpha
        return float(record[-1]), (loudest >= threshold) & (loudest > silence)

    def energy(self, frames: Floats) -> Array:
        """E_n (f, n − N + 1) of the windows that lie within each frame (eq. 2-2, over N)."""
        samples = frames.shape[1]
        width = self.window_samples or samples
        if width > samples:
            raise SetupError(f"short-time-energy needs window_samples of at most a frame's {samples}, got {width}; 0 takes the whole frame")
        power = np.einsum("fnc,fnc->fn", frames, frames, dtype=np.float64) / frames.shape[2]
        sums = np.cumsum(np.concatenate([np.zeros((len(power), 1)), power], axis=1), axis=1)
        return np.maximum(sums[:, width:] - sums[:, :-width], 0.0) / width
