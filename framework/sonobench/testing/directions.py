"""What estimators of directions, and of spectra over directions, must do with the samples of one vector sensor."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from sonobench.errors import SetupError
from sonobench.geometry import angles, unit_vector
from sonobench.testing import fixtures
from sonobench.testing.fixtures import MemoryRecording
from sonobench.testing.kit import Case, broken, claim, need, untouched
from sonobench.types import Array, MicArray

_DIRECTION, _SPECTRUM = ("direction",), ("spectrum",)
#: where the talkers of the frames are, azimuth and elevation (rad)
TALKERS = np.radians([[40.0, 20.0], [-130.0, -35.0], [175.0, 50.0]])
_AT_ARRAY = np.array([0.7, -0.2])


def frames(count: int = 3, n: int = 1500, noise: float = 0.1, seed: int = 5) -> Array:
    """(count, n, 4) of one talker a frame, who hisses (uniformly: cumulants see nothing of Gaussian sound), in noise of that deviation on every channel."""
    rng = np.random.default_rng(seed)
    s = rng.uniform(-(3**0.5), 3**0.5, (count, n, 1))
    u = unit_vector(TALKERS[np.arange(count) % len(TALKERS)])[:, None]
    return np.concatenate([s, s * u], axis=-1) + noise * rng.standard_normal((count, n, 4))


def samples(duration_s: float = 1.2, sounding: tuple[float, float] = (0.0, 1.2), seed: int = 3) -> Array:
    """(n, 8) of two vector sensors that hear one talker in one direction, over faint sensor noise; what `fixtures.samples` is of microphones."""
    rng = np.random.default_rng(seed)
    n = round(duration_s * fixtures.RATE_HZ)
    time_s = np.arange(n) / fixtures.RATE_HZ
    s = 0.1 * rng.uniform(-(3**0.5), 3**0.5, n) * ((time_s >= sounding[0]) & (time_s < sounding[1]))
    wave = np.concatenate([[1.0], unit_vector(_AT_ARRAY)])
    return np.asarray(s[:, None] * np.tile(wave, 2) + 1e-4 * rng.standard_normal((n, 8)))


def sampled(signal: Array | None = None, lengths: Sequence[int] = (1600,)) -> MemoryRecording:
    """A recording of two vector sensors."""
    signal = samples() if signal is None else signal
    usual = fixtures.sampled(signal, lengths)
    ears = MicArray("walls", "avs", np.array([[2.0, 0.3, 0.4], [2.0, 0.3, 0.6]]), fixtures.RATE_HZ)
    return MemoryRecording(dataclasses.replace(usual.header, arrays=(ears,)), tuple(usual.blocks()))


def reads_vectors(front_end: Any) -> bool:
    """Whether a front end refuses microphones and takes vector sensors."""
    try:
        front_end.open(fixtures.sampled().header)
    except SetupError:
        pass
    else:
        return False
    try:
        front_end.open(sampled().header)
    except SetupError:
        return False
    return True


def _error(u: Any, truth: Array) -> float:
    """The largest angle (rad) between unit vectors and directions."""
    return float(np.arccos(np.clip(np.sum(u * unit_vector(truth), axis=-1), -1.0, 1.0)).max())


@claim("direction.runs", _DIRECTION)
def direction_runs(case: Case) -> None:
    """Frames (f, N, 4) give u (f, n, 3), valid (f, n), and R (f, n, 2, 2) and score (f, n) or None."""
    found = case.component.directions(frames())
    u, valid = np.asarray(found.u), np.asarray(found.valid)
    need(u.ndim == 3 and u.shape[0] == 3 and u.shape[2] == 3, f"u of 3 frames has shape {u.shape}; (3, n, 3) is needed")
    need(valid.shape == u.shape[:2] and valid.dtype == bool, f"valid is {valid.dtype} {valid.shape}; bool {u.shape[:2]} is needed")
    for name, value, shape in (("R", found.R, (*valid.shape, 2, 2)), ("score", found.score, valid.shape)):
        need(value is None or np.shape(value) == shape, f"{name} has shape {np.shape(value)}; {shape} or None is needed")


@claim("direction.unit", _DIRECTION, ["direction.runs"])
def direction_unit(case: Case) -> None:
    """Directions are finite unit vectors, covariances symmetric and positive, in sound and in digital silence."""
    x = frames()
    x[1] = 0.0
    found = case.component.directions(x)
    need(np.isfinite(found.u).all(), "u holds NaN or infinity; a row that stands for nothing has a finite u and valid False")
    need(np.allclose(np.linalg.norm(found.u[found.valid], axis=-1), 1.0, atol=1e-9), "a valid u is no unit vector")
    need(not np.any(found.valid[1]), "a frame of zeros has a valid direction")
    need(np.any(found.valid[0]) and np.any(found.valid[2]), "a frame with a talker beside a silent one has no valid direction")
    if found.R is not None:
        R = np.asarray(found.R)[found.valid]
        need(np.isfinite(R).all() and np.allclose(R, np.swapaxes(R, -1, -2)), "a valid R is not finite and symmetric")
        need((np.linalg.eigvalsh(R) > 0).all(), "a valid R is not positive definite")


@claim("direction.towards", _DIRECTION, ["direction.unit"])
def direction_towards(case: Case) -> None:
    """The first valid direction of a loud talker points at the talker within 3°, not away."""
    found = case.component.directions(frames())
    need(found.valid.any(axis=1).all(), "a frame with a talker 20 dB above the noise has no valid direction")
    first = np.argmax(found.valid, axis=1)
    off = _error(found.u[np.arange(3), first], TALKERS)
    need(off < np.radians(3.0), f"points {np.degrees(off):.1f}° off; velocities are scaled so that a wave from u reads (s, u s)")


@claim("direction.scale", _DIRECTION, ["direction.towards"])
def direction_scale(case: Case) -> None:
    """How loud a recording is does not matter."""
    loud, faint = (case.component.directions(g * frames()) for g in (1.0, 2.0**-10))
    need(np.array_equal(loud.valid, faint.valid), "the same sound 60 dB fainter has other valid rows")
    need(np.allclose(loud.u[loud.valid], faint.u[loud.valid], atol=1e-5), "the same sound 60 dB fainter has other directions")


@claim("direction.batch", _DIRECTION, ["direction.unit"])
def direction_batch(case: Case) -> None:
    """A frame's directions do not depend on the frames beside it, and the same frames give the same."""
    x = frames()
    whole, again = case.component.directions(x), case.component.directions(x.copy())
    need(np.array_equal(whole.u, again.u), "two calls with the same frames differ")
    for k in range(len(x)):
        one = case.component.directions(x[k : k + 1])
        fits = np.shape(one.u) == (1, *whole.u.shape[1:]) and np.array_equal(one.valid[0], whole.valid[k])
        need(fits, f"frame {k} alone and among others has other rows")
        need(np.allclose(one.u[one.valid], whole.u[k][one.valid[0]], atol=1e-9), f"frame {k} alone and among others has other directions")


@claim("direction.mutation", _DIRECTION, ["direction.runs"])
def direction_mutation(case: Case) -> None:
    """The samples are left as they came."""
    untouched(case.component.directions, frames())


@claim("spectrum.runs", _SPECTRUM)
def spectrum_runs(case: Case) -> None:
    """Frames (f, N, 4) give f fields, which have a unit and finite values (…, q) at directions (…, q, 2)."""
    curves = case.component.fields(frames())
    need(len(curves) == 3, f"{len(curves)} fields of 3 frames; one a frame is needed")
    z = np.zeros((5, 1, 2))
    for one in curves:
        values = np.asarray(one.at(z, np.zeros(1, np.int64)))
        need(values.shape == (5, 1) and np.isfinite(values).all(), f"values at 5 directions have shape {values.shape} or are not finite")
        need(isinstance(one.unit, str) and one.unit, "a field has no unit; '1' where there is none")


@claim("spectrum.peak", _SPECTRUM, ["spectrum.runs"])
def spectrum_peak(case: Case) -> None:
    """A loud talker's direction is higher than 500 others, but those within 10° of it."""
    rng = np.random.default_rng(6)
    others = np.asarray(angles(rng.standard_normal((500, 3))))
    for k, one in enumerate(case.component.fields(frames())):
        far = others[np.sum(unit_vector(others) * unit_vector(TALKERS[k]), axis=-1) < np.cos(np.radians(10.0))]
        values = np.asarray(one.at(np.concatenate([TALKERS[k : k + 1], far])[:, None], np.zeros(1, np.int64)))[:, 0]
        need(values[0] > values[1:].max(), f"frame {k}: {values[0]:.3g} towards the talker, {values[1:].max():.3g} elsewhere")


@claim("spectrum.silence", _SPECTRUM, ["spectrum.runs"])
def spectrum_silence(case: Case) -> None:
    """A frame of zeros beside others gives finite values."""
    x = frames()
    x[1] = 0.0
    z = np.asarray(angles(np.random.default_rng(6).standard_normal((50, 3))))[:, None]
    try:
        curves = case.component.fields(x)
    except (ValueError, np.linalg.LinAlgError) as error:
        broken(f"meets a frame of zeros with {type(error).__name__}: {error}")
    need(np.isfinite(curves[1].at(z, np.zeros(1, np.int64))).all(), "a frame of zeros gives NaN or infinity")


@claim("spectrum.batch", _SPECTRUM, ["spectrum.runs"])
def spectrum_batch(case: Case) -> None:
    """A frame's field does not depend on the frames beside it."""
    x, z = frames(), TALKERS[:, None]
    whole = case.component.fields(x)
    for k in range(len(x)):
        alone = case.component.fields(x[k : k + 1])[0].at(z, np.zeros(1, np.int64))
        need(np.allclose(alone, whole[k].at(z, np.zeros(1, np.int64)), rtol=1e-6, atol=1e-12), f"frame {k} alone gives another field")


@claim("spectrum.mutation", _SPECTRUM, ["spectrum.runs"])
def spectrum_mutation(case: Case) -> None:
    """The samples are left as they came."""
    untouched(case.component.fields, frames())
