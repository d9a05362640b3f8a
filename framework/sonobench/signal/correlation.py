"""Generalised cross-correlation in groups of frames: windowed spectra of the band, and delay tables of any estimator.

The band is kept by cutting the one-sided spectra just above it (which only makes the lag step longer) and by zeroing
the bins below it, before any delay estimator sees them: every estimator is band-limited, and no more than a third of
the bins are zeros, so that medians over bins mean something. The upper fifth of the bins stays empty: that guard band lets a
short FIR filter interpolate the correlation between lags to better than −60 dB.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonobench.errors import PluginError, SetupError
from sonobench.protocols import Complexes, Delay
from sonobench.signal.framing import window
from sonobench.types import Array, Floats, Ints

_GUARD = 1.25  # bins in all over bins of the band
_BATCH_BYTES = 1 << 18  # of cross-spectra at a time: what stays in the cache, and what the allocator keeps instead of returning it
_HALF = 10  # lags on each side that the interpolating filter reads


def whitened(spectra: Complexes) -> Complexes:
    """X / |X|, 0 where X is 0 (…, bin): the numerator and the denominator of the phase transform, once a microphone.

    Source: Knapp & Carter 1976, table I (PHAT).
    """
    from sonobench.signal._kernels import unit_phase

    x = np.ascontiguousarray(spectra).reshape(-1, spectra.shape[-1])
    out = np.empty_like(x)
    unit_phase(x, out)
    return out.reshape(spectra.shape)


def cross_spectra(spectra: Complexes, pairs: Ints) -> Complexes:
    """S_i conj(S_j) (…, P, bin) of spectra (…, mic, bin); its inverse transform peaks where i is later than j."""
    from sonobench.signal._kernels import cross

    mics, bins = spectra.shape[-2:]
    x = np.ascontiguousarray(spectra).reshape(-1, mics, bins)
    out = np.empty((len(x), len(pairs), bins), x.dtype)
    cross(x, np.ascontiguousarray(pairs), out)
    return out.reshape(*spectra.shape[:-2], len(pairs), bins)


def weighed(estimator: Any, spectra: Complexes, pairs: Ints) -> Floats:
    """Correlations (…, P, lag) of an estimator that weighs averages, of one periodogram (…, mic, bin): its `correlate`."""
    power = spectra.real**2 + spectra.imag**2
    return correlations(estimator.weigh(cross_spectra(spectra, pairs), power, pairs))


def correlations(weighted: Complexes) -> Floats:
    """Circular correlations (…, lag) of weighted cross-spectra (…, bin), scaled so that a lone delay's peak is that of the phase transform."""
    from scipy.fft import irfft

    magnitude = np.abs(weighted)
    mean = magnitude.sum(axis=-1, keepdims=True) / np.maximum(np.count_nonzero(magnitude, axis=-1)[..., None], 1)
    correlation: Floats = irfft(np.divide(weighted, mean, out=np.zeros_like(weighted), where=mean > 0), overwrite_x=True)
    return correlation


@dataclass(frozen=True, slots=True, eq=False)
class TablePlan:
    """Everything about delay tables that does not depend on the samples.

    Attributes:
        pairs: (P, 2) channels.
        window: (n,) float32.
        fft_length: of the zero-padded frames, ≥ 2 n.
        band: first and one past the last bin of the band.
        bins: of the spectra that a delay estimator gets, one-sided.
        reach: lags of the circular correlation on each side of zero.
        taps: (oversampling, taps) float32 of the interpolating filter.
        step_s, start_s: of the tables' columns.
        high_hz: upper edge of the band.
    """

    pairs: Ints
    window: NDArray[np.float32]
    fft_length: int
    band: tuple[int, int]
    bins: int
    reach: int
    taps: NDArray[np.float32]
    step_s: float
    start_s: float
    high_hz: float

    @property
    def columns(self) -> int:
        """Columns of a table."""
        return 2 * self.reach * len(self.taps) + 1

    @property
    def batch(self) -> int:
        """Frames at a time whose cross-spectra stay in the cache."""
        return max(1, _BATCH_BYTES // (len(self.pairs) * self.bins * np.dtype(np.complex64).itemsize))

    def spectra(self, frames: Floats) -> Complexes:
        """Band-limited one-sided spectra (f, mic, bins) complex64 of frames (f, n, mic)."""
        return self._spectra(frames, self.window)

    def _spectra(self, frames: Floats, shape: NDArray[np.float32]) -> Complexes:
        from scipy.fft import rfft

        f, n, mics = frames.shape
        padded = np.zeros((f, mics, self.fft_length), np.float32)
        np.multiply(frames.swapaxes(1, 2), shape, out=padded[..., :n])
        out = np.zeros((f, mics, self.bins), np.complex64)
        low, high = self.band
        out[..., low:high] = rfft(padded, overwrite_x=True)[..., low:high]
        return out

    def welch(self, frames: Floats, segments: int) -> tuple[Complexes, Floats]:
        """Averages over half-overlapping segments of each frame: cross-spectra (f, P, bins), power (f, mic, bins).

        Source: Welch 1967; the window is the plan's, at the segments' length.
        """
        n = frames.shape[1]
        length = 2 * n // (segments + 1)
        shape = np.interp(np.linspace(0, n - 1, length), np.arange(n), self.window).astype(np.float32)
        cross: Any = 0.0
        power: Any = 0.0
        for k in range(segments):
            begin = k * (n - length) // max(segments - 1, 1)
            spectra = self._spectra(frames[:, begin : begin + length], shape)
            cross = cross + cross_spectra(spectra, self.pairs)
            power = power + (spectra.real**2 + spectra.imag**2)
        return cross / segments, power / segments

    def weighted_tables(self, weighted: Complexes) -> NDArray[np.float32]:
        """Delay tables (f, P, columns) of weighted cross-spectra (f, P, bins)."""
        out = np.empty((*weighted.shape[:2], self.columns), np.float32)
        self._interpolate(correlations(weighted), out)
        return out

    def tables(self, delay: Delay, spectra: Complexes) -> NDArray[np.float32]:
        """Delay tables (f, P, columns); a fully coherent pair's whitened peak is 1.

        Raises:
            PluginError: the estimator's answer has another shape.
        """
        out = np.empty((len(spectra), len(self.pairs), self.columns), np.float32)
        for f in range(0, len(spectra), self.batch):
            self._correlate(delay, spectra[f : f + self.batch], out[f : f + self.batch])
        return out

    def _correlate(self, delay: Delay, spectra: Complexes, out: NDArray[np.float32]) -> None:
        lags = 2 * (self.bins - 1)
        circular: Any = np.asarray(delay.correlate(spectra, self.pairs))
        shape = (len(spectra), len(self.pairs), lags)
        if circular.shape != shape or not np.isrealobj(circular):
            raise PluginError(
                f"delay estimator {type(delay).__name__} gave {circular.dtype} of shape {circular.shape} for spectra {spectra.shape}; "
                f"real correlations (frame, pair, lag) of shape {shape} are needed"
            )
        self._interpolate(circular, out)

    def _interpolate(self, circular: Any, out: NDArray[np.float32]) -> None:
        from sonobench.signal._kernels import interpolate

        lags = 2 * (self.bins - 1)
        scale: Any = np.float32(lags / (2.0 * (self.band[1] - self.band[0])))
        interpolate(
            np.ascontiguousarray(circular, np.float32).reshape(-1, lags), self.reach, self.taps, scale, out.reshape(-1, self.columns)
        )


def plan_tables(
    pairs: Ints, rate_hz: float, window_name: str, length: int, max_delay_s: float, band_hz: Array | None, oversampling: int
) -> TablePlan:
    """Plan the tables of pairs for frames of `length` samples, out to ±max_delay_s.

    Raises:
        SetupError: the frame is too short for the delays, or the band is empty at this rate.
    """
    from scipy.fft import next_fast_len

    if max_delay_s > 0.5 * length / rate_hz:
        raise SetupError(
            f"a frame of {length / rate_hz:.4g} s is too short for delays up to {max_delay_s:.4g} s; twice that is needed: raise frame_s"
        )
    fft_length = next_fast_len(2 * length, real=True)
    low_hz, high_hz = (0.0, rate_hz / 2) if band_hz is None else (float(band_hz[0]), min(float(band_hz[1]), rate_hz / 2))
    low = max(1, int(np.ceil(low_hz * fft_length / rate_hz)))  # the mean carries no delay
    high = int(high_hz * fft_length / rate_hz) + 1
    if high - low < 4:
        raise SetupError(
            f"the band {low_hz:g} to {high_hz:g} Hz holds {max(high - low, 0)} bins of a {fft_length}-point transform; widen it"
        )
    lags = 2 * next_fast_len(int(np.ceil(_GUARD * (high - 1))), real=True)
    lag_s = fft_length / rate_hz / lags
    reach = int(np.ceil(max_delay_s / lag_s)) + 2
    taps = _fractional_taps(oversampling)
    shape = window(window_name, length).astype(np.float32)
    return TablePlan(pairs, shape, fft_length, (low, high), lags // 2 + 1, reach, taps, lag_s / oversampling, -reach * lag_s, high_hz)


def _fractional_taps(oversampling: int) -> NDArray[np.float32]:
    """Kaiser-windowed sinc (oversampling, 2 _HALF), phase by phase."""
    share = np.arange(oversampling)[:, None] / oversampling
    distance = np.arange(-_HALF + 1, _HALF + 1)[None, :] - share
    inside = np.clip(1.0 - (distance / _HALF) ** 2, 0.0, None)
    taps = np.sinc(distance) * np.i0(6.0 * np.sqrt(inside)) / np.i0(6.0)
    return (taps / taps.sum(axis=1, keepdims=True)).astype(np.float32)
