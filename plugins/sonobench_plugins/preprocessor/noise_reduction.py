"""Noise reduction in short-time spectra: Wiener filter or spectral subtraction, overlapped and added.

Source: Boll 1979, "Suppression of acoustic noise in speech using spectral subtraction"; Berouti, Schwartz & Makhoul 1979 (factor and floor);
Scalart & Filho 1996, "Speech enhancement based on a priori signal to noise estimation" (Wiener gain), with the decision-directed estimate of Ephraim & Malah
1984. Liang 2016, 2.2, names the step without a rule.

Frames overlap by half under a root-Hann window before and after, whose squares add up to 1. The noise is the mean power of quiet frames: those
within `quiet_db` of a floor that falls at once to a quieter frame and rises slowly. A frame quieter than the floor by more than
`quiet_db` begins the mean anew, so a recording that starts with a sound mends itself at the first pause.

ONE real gain per bin is applied to ALL channels, from their mean power. A real gain moves no bin's phase; but channels with gains of their own would pass
two different filters, changing in time, and after overlap and addition what one microphone hears later would no longer be a delayed
copy of what the other heard. The same filter on both commutes with the delay, up to how far it changes within a delay, much shorter than a hop.
Sample k that comes out is sample k that went in: it comes a hop later, with the same number.
Deviations: the a-posteriori ratio is over the mean of the channels, which varies less than one channel's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sonobench.errors import SetupError
from sonobench.protocols import State
from sonobench.types import Array

_MOST = 1e8  # largest signal-to-noise ratio that is told apart from none


@dataclass(frozen=True, slots=True, eq=False)
class _Noise:
    """Noise power (bins,), the quiet frames in its mean, the floor (dB), and the last frame's estimated sound over noise (bins,)."""

    power: Array
    frames: int
    floor_db: float
    sound: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Running:
    """Root window (2 hop,), samples that wait (n, c), the last hop, the sum so far of its end (hop, c), frames done, the noise or None."""

    root: Array
    waiting: Array
    last: Array
    overlap: Array
    frames: int
    noise: _Noise | None
    rate_hz: float


@dataclass(frozen=True)
class NoiseReduction:
    """Attenuates what stays as quiet as the pauses, bin by bin."""

    rule: Literal["wiener", "subtraction"] = "wiener"  #: how a bin's gain follows from its power over the noise's
    frame_s: float = 0.032  #: length of a frame; half of it is the hop and the latency
    floor: float = 0.1  #: least gain
    over: float = 1.0  #: factor on the estimated noise power
    memory_s: float = 0.5  #: time constant of the noise power, over quiet frames
    quiet_db: float = 3.0  #: a frame at most this far above the floor is noise
    rise_db_s: float = 1.0  #: rise of the floor a second
    smoothing: float = 0.98  #: share of the last frame in the Wiener rule's signal-to-noise ratio; 0 for none

    def __post_init__(self) -> None:
        if self.rule not in ("wiener", "subtraction"):
            raise ValueError(f"rule is {self.rule!r}; 'wiener' or 'subtraction' is needed")
        if not (0 <= self.floor <= 1 and 0 <= self.smoothing < 1):
            raise ValueError(f"floor is {self.floor} and smoothing {self.smoothing}; 0 to 1 and 0 to below 1 are needed")
        for name in ("frame_s", "over", "memory_s", "quiet_db", "rise_db_s"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} is {getattr(self, name)}; a positive number is needed")

    def start(self, rate_hz: float, channels: int) -> State:
        """Nothing heard.

        Raises:
            SetupError: a frame holds fewer than 8 samples.
        """
        hop = round(self.frame_s * rate_hz / 2)
        if hop < 4:
            raise SetupError(f"noise-reduction: frame_s {self.frame_s} is {2 * hop} samples at {rate_hz:g} Hz; 8 are needed")
        root = np.sqrt(0.5 - 0.5 * np.cos(np.pi * np.arange(2 * hop) / hop))
        return _Running(root, np.zeros((0, channels)), np.zeros((hop, channels)), np.zeros((hop, channels)), 0, None, float(rate_hz))

    def process(self, state: State, samples: Array) -> tuple[State, Array]:
        """Take the next (n, channels); return the hops that they complete, the first frame's one hop later."""
        hop, out = len(state.last), [np.zeros((0, samples.shape[1]))]
        buffer = np.concatenate([state.waiting, samples])
        for first in range(0, len(buffer) - hop + 1, hop):
            state, ready = self._frame(state, buffer[first : first + hop], learn=state.frames > 0)
            out += [ready] if state.frames > 1 else []  # the first frame's first half lies before the first sample
        return replace(state, waiting=buffer[len(buffer) // hop * hop :].copy()), np.concatenate(out)

    def finish(self, state: State) -> Array:
        """The last hop and what waited; frames that silence fills up teach no noise."""
        hop, (rest, channels) = len(state.last), state.waiting.shape
        if state.frames == 0 and rest == 0:
            return np.zeros((0, channels))
        due, out = rest + (hop if state.frames else 0), [np.zeros((0, channels))]
        filled = np.zeros((-(-rest // hop) * hop + hop, channels))
        filled[:rest] = state.waiting
        for first in range(0, len(filled), hop):
            state, ready = self._frame(state, filled[first : first + hop], learn=False)
            out += [ready] if state.frames > 1 else []
        return np.concatenate(out)[:due]

    def _frame(self, state: _Running, fresh: Array, learn: bool) -> tuple[_Running, Array]:
        """Reduce the frame of the last hop and a fresh one; return the finished half."""
        from scipy.fft import irfft, rfft

        hop = len(fresh)
        spectra = rfft(np.concatenate([state.last, fresh]).T * state.root)  # (c, bins)
        power = (spectra.real**2 + spectra.imag**2).mean(axis=0)
        noise = self._heard(state, power) if learn else state.noise
        if noise is not None:
            gain, sound = self._gain(noise, power)
            noise, spectra = replace(noise, sound=sound), gain * spectra
        frame = (irfft(spectra, 2 * hop) * state.root).T
        after = replace(state, last=fresh.copy(), overlap=frame[hop:].copy(), frames=state.frames + 1, noise=noise)
        return after, state.overlap + frame[:hop]

    def _heard(self, state: _Running, power: Array) -> _Noise | None:
        """The noise after a whole frame of this power (bins,)."""
        hop_s, old, total = len(state.last) / state.rate_hz, state.noise, float(power.sum())
        if total <= 0.0:  # digital silence says nothing about the room's noise
            return old
        now = 10.0 * math.log10(total)
        if old is None or now < old.floor_db - self.quiet_db:
            return _Noise(power, 1, now, np.zeros_like(power) if old is None else old.sound)
        floor = min(now, old.floor_db + self.rise_db_s * hop_s)
        if now > floor + self.quiet_db:
            return replace(old, floor_db=floor)
        share = max(1.0 / (old.frames + 1), -math.expm1(-hop_s / self.memory_s))
        return replace(old, power=old.power + share * (power - old.power), frames=old.frames + 1, floor_db=floor)

    def _gain(self, noise: _Noise, power: Array) -> tuple[Array, Array]:
        """Gain (bins,) and estimated sound over noise (bins,) of a frame of this power."""
        with np.errstate(over="ignore"):
            ratio = np.minimum(power / np.maximum(self.over * noise.power, np.finfo(float).tiny), _MOST)
        above = np.maximum(ratio - 1.0, 0.0)
        if self.rule == "wiener":
            prior = self.smoothing * noise.sound + (1.0 - self.smoothing) * above
            gain = np.maximum(prior / (1.0 + prior), self.floor)
        else:
            gain = np.sqrt(np.maximum(above / np.maximum(ratio, 1.0), self.floor**2))
        return gain, gain**2 * ratio
