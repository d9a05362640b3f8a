"""Directions, or spectra of directions, of every vector sensor, frame by frame.

Each element of the arrays of kind "avs" (four channels: p, vx, vy, vz) is a sensor of kind "direction" of its own; its rows are azimuth
and elevation in its array's frame, with the covariance and the score that the estimator states. A spectrum goes out as it is, as the
field "spectrum". Frames are cut without a window: estimators take second or higher moments of plain samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sonobench import Block, Detections, DirectionSpectrum, Header, MicArray, PluginError, Scan, Sensor, Setup, SetupError, Space
from sonobench.geometry import angles
from sonobench.protocols import Activity, Direction, Directions, Preprocessor, Spectrum, State
from sonobench.signal import Frames, Framing, Tail, drain, empty_tail, framing, push
from sonobench.signal.preprocessing import ChainState, begin, finish, through
from sonobench.types import Array, Field, Floats
from sonobench_plugins.activity.always import Always
from sonobench_plugins.direction.intensity import Intensity

_SPACE = Space.of("azimuth_rad", "elevation_rad")


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """How frames are cut, each array's preprocessors, waiting samples, and the activity's memory."""

    framing: Framing
    chains: tuple[ChainState, ...]
    tail: Tail
    activity: State


@dataclass(frozen=True)
class Avs:
    """One sensor "direction-0" and so on an element."""

    array: str = ""  #: the array to read; "": all of kind "avs"
    frame_s: float = 0.1  #: length of a frame
    hop_s: float = 0.1  #: time between scans
    preprocess: tuple[Preprocessor, ...] = ()  #: what samples go through before they are framed, one after another
    activity: Activity = field(default_factory=Always)  #: which frames are looked at
    direction: Direction | None = None  #: estimator of directions; None: intensity, or no rows where there is a spectrum
    spectrum: Spectrum | None = None  #: estimator of spectra, for trackers that take fields; None: no field

    def open(self, header: Header) -> tuple[Setup, State]:
        """Find the arrays; SetupError where there is none of kind "avs", or they differ in rate, or the frame holds too little."""
        arrays = self._arrays(header)
        rate_hz = arrays[0].rate_hz
        cutting = framing({a.name: a.channels for a in arrays}, self.frame_s, self.hop_s, rate_hz, header.start_s)
        elements = [(a.name, e) for a in arrays for e in a.elements]
        sensors = [Sensor(f"direction-{q}", name, "direction", e[None], _SPACE) for q, (name, e) in enumerate(elements)]
        chains = tuple(begin(self.preprocess, a.name, a.channels, rate_hz) for a in arrays) if self.preprocess else ()
        setup = Setup.from_header(header, sensors, cutting.hop / rate_hz, rate_hz)
        return setup, _State(cutting, chains, empty_tail(cutting), self.activity.start(rate_hz))

    def step(self, state: State, block: Block) -> tuple[State, list[Scan]]:
        """Take samples, return the scans of the frames that they complete."""
        chains, ready = through(self.preprocess, state.chains, block)
        state = replace(state, chains=chains)
        return (state, []) if ready is None else self._framed(state, ready)

    def flush(self, state: State) -> list[Scan]:
        """The scans of the last whole frames."""
        out: list[Scan] = []
        for chain in state.chains:
            rest = finish(self.preprocess, chain)
            if rest is not None:
                state, scans = self._framed(state, rest)
                out += scans
        for group in drain(state.framing, state.tail):
            state, scans = self._group(state, group)
            out += scans
        return out

    def _arrays(self, header: Header) -> list[MicArray]:
        arrays = [a for a in header.arrays if a.kind == "avs" and self.array in ("", a.name)]
        if not arrays:
            have = ", ".join(f"{a.name!r} of kind {a.kind!r}" for a in header.arrays) or "no samples"
            wanted = f"array {self.array!r} of kind 'avs'" if self.array else "arrays of kind 'avs' (vector sensors)"
            raise SetupError(f"front end avs reads {wanted}; recording {header.name} has {have}")
        if len({a.rate_hz for a in arrays}) > 1:
            rates = {a.name: a.rate_hz for a in arrays}
            raise SetupError(f"front end avs reads arrays of one rate; recording {header.name} has {rates} Hz: name one by `array`")
        return arrays

    def _framed(self, state: State, block: Block) -> tuple[State, list[Scan]]:
        tail, groups = push(state.framing, state.tail, block)
        state, out = replace(state, tail=tail), []
        for group in groups:
            state, scans = self._group(state, group)
            out += scans
        return state, out

    def _group(self, state: State, group: Frames) -> tuple[State, list[Scan]]:
        """Scans of frames (f, N, 4 Q); only those of a sensor that is active and not digitally silent are looked at."""
        memory, active = self.activity.active(state.activity, group.samples)
        f, n, channels = group.samples.shape
        split = np.asarray(group.samples, float).reshape(f, n, channels // 4, 4)
        heard = np.asarray(active, bool)[:, None] & split.any(axis=(1, 3))
        looked = [np.ascontiguousarray(split[heard[:, q], :, q]) for q in range(heard.shape[1])]
        direction = self.direction or (Intensity() if self.spectrum is None else None)
        rows = [_directions(direction, x) if direction is not None and len(x) else None for x in looked]
        curves = [_fields(self.spectrum, x) if self.spectrum is not None and len(x) else None for x in looked]
        at = np.cumsum(heard, axis=0) - 1  # a frame's place among those looked at
        scans = []
        for k in range(f):
            seen = [(q, one, at[k, q]) for q, one in enumerate(rows) if one is not None and heard[k, q]]
            shown = [one[at[k, q]] if one is not None and heard[k, q] else None for q, one in enumerate(curves)]
            fields = {"spectrum": _stacked(shown)} if any(one is not None for one in shown) else {}
            searched = heard[k] & (direction is not None)
            scans.append(Scan(state.framing.time_s(group.first + k), searched, _detections(seen), fields))
        return replace(state, activity=memory), scans


def _directions(direction: Direction, samples: Floats) -> Directions:
    """What the estimator says of frames (f, N, 4); PluginError where its shapes do not fit."""
    given = direction.directions(samples)
    who = f"direction estimator {type(direction).__name__}"
    if not isinstance(given, Directions):
        raise PluginError(f"{who} gave a {type(given).__name__}; sonobench.protocols.Directions(u, valid, R, score) is needed")
    u, valid = np.asarray(given.u, float), np.asarray(given.valid, bool)
    if u.ndim != 3 or u.shape[0] != len(samples) or u.shape[2] != 3 or valid.shape != u.shape[:2]:
        raise PluginError(f"{who} gave u {u.shape} and valid {valid.shape} for {len(samples)} frames; (f, n, 3) and (f, n) are needed")
    R = None if given.R is None else np.asarray(given.R, float)
    score = None if given.score is None else np.asarray(given.score, float)
    if (R is not None and R.shape != (*u.shape[:2], 2, 2)) or (score is not None and score.shape != u.shape[:2]):
        raise PluginError(f"{who} gave R or score of another shape than (f, n, 2, 2) or (f, n) with f, n = {u.shape[:2]}")
    length = np.linalg.norm(u[valid], axis=-1)
    if not np.allclose(length, 1.0, rtol=0, atol=1e-6):
        odd = length[~(np.abs(length - 1.0) <= 1e-6)][0]
        raise PluginError(f"{who} gave a valid u of length {odd:g}; unit vectors are needed, or valid False where there is no direction")
    if R is not None and not _covariances(R[valid]):
        raise PluginError(f"{who} gave R that is no covariance; finite, symmetric R without negative eigenvalues is needed, or None")
    return Directions(u, valid, R, score)


def _covariances(R: Array) -> bool:
    if not np.isfinite(R).all():
        return False
    scale = np.abs(R).max(initial=0.0, axis=(-2, -1), keepdims=True)
    alike = np.abs(R - np.swapaxes(R, -2, -1)) <= 1e-6 * scale
    return bool(alike.all() and (np.linalg.eigvalsh(R) >= -1e-9 * scale[..., 0]).all())


def _fields(spectrum: Spectrum, samples: Floats) -> Sequence[Field]:
    curves = spectrum.fields(samples)
    if len(curves) != len(samples):
        raise PluginError(f"spectrum {type(spectrum).__name__} gave {len(curves)} fields for {len(samples)} frames; one a frame is needed")
    odd = [type(c).__name__ for c in curves if not isinstance(c, Field)]
    if odd:
        raise PluginError(f"spectrum {type(spectrum).__name__} gave a {odd[0]}; fields with `unit` and `at(z, sensor)` are needed")
    return curves


def _detections(seen: Sequence[tuple[int, Directions, int]]) -> tuple[Detections, ...]:
    """One group of the rows of all sensors (sensor, what was found, frame); () where none was looked at."""
    if not seen:
        return ()
    keep = [one.valid[k] for _, one, k in seen]
    z = np.concatenate([angles(one.u[k][on]) for (_, one, k), on in zip(seen, keep, strict=True)])
    sensor = np.concatenate([np.full(on.sum(), q, np.int64) for (q, _, _), on in zip(seen, keep, strict=True)])
    R = [one.R[k][on] for (_, one, k), on in zip(seen, keep, strict=True) if one.R is not None]
    score = [one.score[k][on] for (_, one, k), on in zip(seen, keep, strict=True) if one.score is not None]
    return (Detections(z, sensor, np.concatenate(R) if R else None, np.concatenate(score) if score else None),)


def _stacked(curves: Sequence[Field | None]) -> Field:
    """One field over all sensors, from those of a sensor each; None says nothing.

    Raises:
        PluginError: several sensors whose fields are no direction spectra.
    """
    if len(curves) == 1 and curves[0] is not None:
        return curves[0]
    known: Any = next(one for one in curves if one is not None)
    if not all(one is None or isinstance(one, DirectionSpectrum) for one in curves):
        raise PluginError(f"front end avs stacks direction spectra of several sensors; {type(known).__name__} fits an array of one element")
    mute = replace(known, height=np.zeros(1), heard=np.zeros(1, bool))
    parts: list[Any] = [mute if one is None else one for one in curves]
    return DirectionSpectrum(**{n: np.concatenate([getattr(p, n) for p in parts]) for n in ("noise", "spread", "height", "power", "heard")})
