"""The types that travel between recordings, front ends, trackers and metrics.

Frozen dataclasses of read-only arrays (float64 unless said). They pickle, print, and round-trip through MCAP without
loss. `None` means "not given, no information"; an array with 0 rows means "looked, nothing there".

Legend of the letters that bodies and comments use:

| letter | meaning | letter | meaning |
| --- | --- | --- | --- |
| x, d | state, its dimension | z, dz | measurement, its dimension |
| m, P, w | mean, covariance, weight of a component | n, J, N | targets, components, particles |
| F, Q | transition, process noise | h, H, R | measurement function, its Jacobian, noise |
| S, K | innovation covariance, gain | p_D, p_S | probability of detection, of survival |
| kappa | clutter intensity (per unit of measurement space) | tau | delay (s) |
| q, Q | a sensor, the number of sensors | k | a scan, or an evaluation time |
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sonobench.errors import SetupError

Array = NDArray[np.float64]
Floats = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_EMPTY: Mapping[str, Any] = MappingProxyType({})


def read_only(value: ArrayLike, dtype: Any = np.float64, shape: tuple[int | None, ...] | None = None, name: str = "array") -> NDArray[Any]:
    """Return `value` as a C-contiguous read-only array, copied only where somebody could still write to it.

    Args:
        value: anything that NumPy takes.
        dtype: element type.
        shape: expected shape, None for a free axis.
        name: what the error calls it.

    Raises:
        ValueError: the shape does not fit.
    """
    array = np.asarray(value, dtype=dtype)
    if array.flags.writeable or not array.flags.c_contiguous or array.base is not None:
        array = np.array(array, dtype=dtype, order="C", copy=True)
        array.flags.writeable = False
    if shape is not None and (array.ndim != len(shape) or any(s is not None and s != a for s, a in zip(shape, array.shape, strict=True))):
        wanted = "(" + ", ".join("*" if s is None else str(s) for s in shape) + ")"
        raise ValueError(f"{name} has shape {array.shape}; {wanted} is needed")
    return array


class _Travels:
    """Pickling through the constructor, so that arrays arrive read-only and mappings immutable."""

    __slots__ = ()

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        values = (getattr(self, f.name) for f in dataclasses.fields(self) if f.init)  # type: ignore[arg-type]
        return type(self), tuple(dict(v) if isinstance(v, MappingProxyType) else v for v in values)

    def _set(self, **values: Any) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)


def identical(a: Any, b: Any) -> bool:
    """Whether two travelling values are the same bit for bit (dtype, shape, bytes), recursively."""
    if dataclasses.is_dataclass(a) and not isinstance(a, type):
        return type(a) is type(b) and all(identical(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, Mapping):
        return isinstance(b, Mapping) and a.keys() == b.keys() and all(identical(a[k], b[k]) for k in a)
    if isinstance(a, (tuple, list)):
        return type(a) is type(b) and len(a) == len(b) and all(map(identical, a, b))
    if isinstance(a, float) and isinstance(b, float) and math.isnan(a):
        return math.isnan(b)
    return type(a) is type(b) and bool(a == b)


@dataclass(frozen=True, slots=True)
class Space:
    """Named coordinates with units, in order.

    Attributes:
        names: such as "x_m", "vx_m_s", "azimuth_rad"; the suffix is the unit.
        periods: wrap period per name, 0 where the coordinate is a line; by default 2 pi for names that contain "azimuth" and end in "_rad".
    """

    names: tuple[str, ...]
    periods: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        names = tuple(self.names)
        if len(set(names)) != len(names):
            raise ValueError(f"a space names each coordinate once, got {names}")
        periods = tuple(map(float, self.periods)) or tuple(2 * math.pi if "azimuth" in n and n.endswith("_rad") else 0.0 for n in names)
        if len(periods) != len(names):
            raise ValueError(f"{len(periods)} periods for {len(names)} names {names}")
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "periods", periods)

    @classmethod
    def of(cls, *names: str) -> Space:
        """A space of these names with their default periods."""
        return cls(names)

    def __len__(self) -> int:
        return len(self.names)

    def index(self, *names: str) -> list[int]:
        """Columns of `names`.

        Raises:
            SetupError: a name is missing.
        """
        missing = [n for n in names if n not in self.names]
        if missing:
            raise SetupError(f"the state space {list(self.names)} has no {', '.join(missing)}")
        return [self.names.index(n) for n in names]

    def residual(self, a: Floats, b: Floats) -> Floats:
        """a − b (…, d), each periodic coordinate wrapped to [−period/2, period/2)."""
        difference = np.asarray(a - b)
        if not any(self.periods):
            return difference
        period = np.array(self.periods)
        turns = np.divide(difference, period, out=np.zeros_like(difference), where=period > 0)
        return difference - period * np.floor(turns + 0.5)


@dataclass(frozen=True, slots=True, eq=False)
class Sensor(_Travels):
    """One source of measurement rows.

    Attributes:
        name: unique in a Setup.
        array: the array it belongs to.
        kind: "tdoa" (tau = (|x − m_i| − |x − m_j|) / c, positive when i is farther), "direction", or a plugin's own.
        elements: (k, 3) m, in the array's frame.
        space: the measurement's coordinates (dz); a stack of P pairs is ONE sensor with dz = P.
        pairs: (dz, 2) rows of `elements` (i, j) for kind "tdoa", else (0, 2).
    """

    name: str
    array: str
    kind: str
    elements: Array
    space: Space
    pairs: Ints = field(default_factory=lambda: np.zeros((0, 2), np.int64))

    def __post_init__(self) -> None:
        elements = read_only(self.elements, shape=(None, 3), name=f"sensor {self.name}: elements")
        pairs = read_only(self.pairs, np.int64, (None, 2), f"sensor {self.name}: pairs")
        if self.kind == "tdoa" and len(pairs) != len(self.space):
            raise ValueError(f"sensor {self.name}: {len(pairs)} pairs for {len(self.space)} delays")
        if pairs.size and not (pairs.min() >= 0 and pairs.max() < len(elements)):
            raise ValueError(f"sensor {self.name}: pairs name elements 0 to {pairs.max()}, there are {len(elements)}")
        self._set(elements=elements, pairs=pairs)


@dataclass(frozen=True, slots=True, eq=False)
class MicArray(_Travels):
    """Microphones (or vector sensors) that share a clock and a frame.

    Attributes:
        name: unique in a recording.
        kind: "microphones" (one channel an element) or "avs" (four channels an element: p, vx, vy, vz).
        elements: (k, 3) m, in the array's frame.
        rate_hz: sampling rate of every channel.
        pairs: (P, 2) the pairs (i, j) that the scene names; (0, 2): none.
    """

    name: str
    kind: str
    elements: Array
    rate_hz: float
    pairs: Ints = field(default_factory=lambda: np.zeros((0, 2), np.int64))

    def __post_init__(self) -> None:
        elements = read_only(self.elements, shape=(None, 3), name=f"array {self.name}: elements")
        self._set(
            elements=elements, pairs=read_only(self.pairs, np.int64, (None, 2), f"array {self.name}: pairs"), rate_hz=float(self.rate_hz)
        )

    @property
    def channels(self) -> int:
        """Channels of a sample block."""
        return len(self.elements) * (4 if self.kind == "avs" else 1)


@dataclass(frozen=True, slots=True, eq=False)
class Header(_Travels):
    """What a recording says of itself before its first sample; a pipeline may read all of it.

    Attributes:
        name: the recording's name (scene and seed, or take).
        arrays: sampled arrays; () for a measurement-level recording.
        poses: (A, 4, 4) homogeneous, room ← array, one for each name in `array_names`.
        sensors: sensors of the recorded measurement scans; () where only samples are recorded.
        array_names: names of the arrays that `poses` places (those of `arrays`, or those that `sensors` name).
        start_s, duration_s: span of the recording.
        period_s: period of recorded scans, None where irregular or where there are none.
        c_m_s: speed of sound.
        box_m: (2, 3) lower and upper corner of the room, None in free field or when unknown.
        reflections: (6,) pressure reflection coefficients of the walls x0 x1 y0 y1 z0 z1, or None.
        band_hz: (2,) where the sounds carry energy (a clip resampled upwards has nothing above its own half rate), or None.
        nominal: scalars that a tracker may take as its own parameters (p_d, clutter_per_scan, delay_std_s, height_m, …).
        given: arrays that the scene hands out to whoever asks (births, starts, source_count, …).
    """

    name: str
    arrays: tuple[MicArray, ...] = ()
    poses: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
    sensors: tuple[Sensor, ...] = ()
    array_names: tuple[str, ...] = ()
    start_s: float = 0.0
    duration_s: float = 0.0
    period_s: float | None = None
    c_m_s: float = 343.0
    box_m: Array | None = None
    reflections: Array | None = None
    band_hz: Array | None = None
    nominal: Mapping[str, float] = field(default_factory=lambda: _EMPTY)
    given: Mapping[str, Array] = field(default_factory=lambda: _EMPTY)

    def __post_init__(self) -> None:
        names = tuple(self.array_names) or tuple(a.name for a in self.arrays)
        self._set(
            arrays=tuple(self.arrays),
            sensors=tuple(self.sensors),
            array_names=names,
            poses=read_only(self.poses, shape=(len(names), 4, 4), name="poses"),
            box_m=None if self.box_m is None else read_only(self.box_m, shape=(2, 3), name="box_m"),
            reflections=None if self.reflections is None else read_only(self.reflections, shape=(6,), name="reflections"),
            band_hz=None if self.band_hz is None else read_only(self.band_hz, shape=(2,), name="band_hz"),
            nominal=MappingProxyType({k: float(v) for k, v in sorted(self.nominal.items())}),
            given=MappingProxyType({k: read_only(v) for k, v in sorted(self.given.items())}),
        )

    def offering(self, names: Iterable[str]) -> Header:
        """This header with only the `given` arrays that a pipeline asked for.

        Raises:
            SetupError: the recording does not give one of them.
        """
        wanted = tuple(names)
        missing = [n for n in wanted if n not in self.given]
        if missing:
            raise SetupError(
                f"the pipeline asks for given {missing}; recording {self.name} gives {sorted(self.given) or 'nothing'}: "
                f"take a pipeline that asks for less, or a scene whose key `given` names them"
            )
        return dataclasses.replace(self, given={n: self.given[n] for n in wanted})


@dataclass(frozen=True, slots=True, eq=False)
class Block(_Travels):
    """A run of samples of one array.

    Attributes:
        array: name of the array.
        first_sample: index of the first sample in the recording.
        samples: (n, channels) float32.
    """

    array: str
    first_sample: int
    samples: NDArray[np.float32]

    def __post_init__(self) -> None:
        self._set(samples=read_only(self.samples, np.float32, (None, None), f"block of {self.array}: samples"))


@dataclass(frozen=True, slots=True, eq=False)
class Setup(_Travels):
    """What an honest user of a recording knows before frame 1; never truth.

    Attributes:
        sensors: (Q) what Detections and Fields index; several groupings of the same microphones may be listed.
        array_names, poses: (A) names and (A, 4, 4) room ← array.
        start_s: time of the state before frame 1.
        period_s: time between scans, None where irregular.
        c_m_s, rate_hz, box_m (2, 3), reflections (6,): as in Header; None is unknown.
        nominal: scalars; a parameter that a component leaves None is taken from here.
        given: only what this pipeline asked for.
    """

    sensors: tuple[Sensor, ...]
    array_names: tuple[str, ...] = ()
    poses: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
    start_s: float = 0.0
    period_s: float | None = None
    c_m_s: float = 343.0
    rate_hz: float | None = None
    box_m: Array | None = None
    reflections: Array | None = None
    nominal: Mapping[str, float] = field(default_factory=lambda: _EMPTY)
    given: Mapping[str, Array] = field(default_factory=lambda: _EMPTY)

    def __post_init__(self) -> None:
        self._set(
            sensors=tuple(self.sensors),
            array_names=tuple(self.array_names),
            poses=read_only(self.poses, shape=(len(self.array_names), 4, 4), name="poses"),
            box_m=None if self.box_m is None else read_only(self.box_m, shape=(2, 3), name="box_m"),
            reflections=None if self.reflections is None else read_only(self.reflections, shape=(6,), name="reflections"),
            nominal=MappingProxyType({k: float(v) for k, v in sorted(self.nominal.items())}),
            given=MappingProxyType({k: read_only(v) for k, v in sorted(self.given.items())}),
        )

    @classmethod
    def from_header(cls, header: Header, sensors: Iterable[Sensor], period_s: float | None = None, rate_hz: float | None = None) -> Setup:
        """The setup of a front end that reads `header` and lists `sensors`."""
        return cls(
            sensors=tuple(sensors),
            array_names=header.array_names,
            poses=header.poses,
            start_s=header.start_s,
            period_s=period_s,
            c_m_s=header.c_m_s,
            rate_hz=rate_hz,
            box_m=header.box_m,
            reflections=header.reflections,
            nominal=header.nominal,
            given=header.given,
        )

    def value(self, name: str, own: float | None, who: str) -> float:
        """`own` where it is set, else the nominal value of that name.

        Raises:
            SetupError: neither is there.
        """
        if own is not None:
            return own
        if name not in self.nominal:
            raise SetupError(
                f"{who} leaves {name} to the recording, which has no nominal {name} (it has {sorted(self.nominal) or 'none'}); set {name}"
            )
        return self.nominal[name]

    def of_kind(self, kind: str, who: str, name: str = "") -> list[int]:
        """Indices of the sensors of a kind whose name is, or starts with, `name` ("" is all).

        Raises:
            SetupError: there is none.
        """
        found = [i for i, s in enumerate(self.sensors) if s.kind == kind and s.name.startswith(name)]
        if not found:
            have = [f"{s.name} ({s.kind}, dz {len(s.space)})" for s in self.sensors] or "none"
            raise SetupError(
                f"{who} reads sensors of kind {kind!r}" + (f" named {name!r}" if name else "") + f"; the front end lists {have}"
            )
        return found

    def pose(self, sensor: Sensor, scan: Scan | None = None) -> Array:
        """(4, 4) room ← array of `sensor`, at the scan's time when its arrays move."""
        poses = self.poses if scan is None or scan.pose is None else scan.pose
        return np.asarray(poses[self.array_names.index(sensor.array)])


@dataclass(frozen=True, slots=True, eq=False)
class Detections(_Travels):
    """What a front end picked in one frame; the order of rows carries no meaning.

    Attributes:
        z: (m, dz).
        sensor: (m,) int into Setup.sensors, all of one dz.
        R: (m, dz, dz) noise covariance, or None: the measurement model's.
        score: (m,) or None.
        valid: (m, dz) bool, or None: all; a missing component is invalid, never NaN.
    """

    z: Array
    sensor: Ints
    R: Array | None = None
    score: Array | None = None
    valid: Bools | None = None

    def __post_init__(self) -> None:
        z = read_only(self.z, shape=(None, None), name="detections: z")
        m, dz = z.shape
        if not np.isfinite(z).all():
            raise ValueError("detections: z holds NaN or infinity; mark a missing component in `valid`")
        self._set(
            z=z,
            sensor=read_only(self.sensor, np.int64, (m,), "detections: sensor"),
            R=None if self.R is None else read_only(self.R, shape=(m, dz, dz), name="detections: R"),
            score=None if self.score is None else read_only(self.score, shape=(m,), name="detections: score"),
            valid=None if self.valid is None else read_only(self.valid, np.bool_, (m, dz), "detections: valid"),
        )

    def __len__(self) -> int:
        return len(self.z)


@runtime_checkable
class Field(Protocol):
    """A raw curve over the measurement space of its sensors, as arrays; may be negative; not a likelihood."""

    @property
    def unit(self) -> str:
        """Unit of the values, "1" where they have none."""
        ...

    def at(self, z: Floats, sensor: Ints) -> Floats:
        """Values (…, q) at measurements z (…, q, dz) of the sensors (q,)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class DelayTable(_Travels):
    """A generalised cross-correlation per single-pair sensor, tabulated over delay.

    Attributes:
        values: (Q, lags) float32, one row a sensor of the setup; rows of sensors without a table are NaN-free zeros.
        start_s: delay of the first column.
        step_s: delay between columns.
        unit: of the values; "1" for a whitened correlation.
    """

    kind: ClassVar[str] = "delay-table"
    values: NDArray[np.float32]
    start_s: float
    step_s: float
    unit: str = "1"

    def __post_init__(self) -> None:
        self._set(
            values=read_only(self.values, np.float32, (None, None), "delay table: values"),
            start_s=float(self.start_s),
            step_s=float(self.step_s),
        )

    def at(self, z: Floats, sensor: Ints) -> Floats:
        """Linear interpolation at delays z (…, q, 1) of sensors (q,); 0 outside the table. Returns (…, q)."""
        lags = self.values.shape[1]
        position = (np.asarray(z)[..., 0] - self.start_s) / self.step_s
        inside = (position >= 0) & (position <= lags - 1)
        low = np.clip(position.astype(np.int64), 0, lags - 2)
        share = position - low
        left, right = self.values[sensor, low], self.values[sensor, low + 1]
        return np.where(inside, left + share * (right - left), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class DirectionSpectrum(_Travels):
    """The expected number of sources per steradian of each vector sensor, from the subspace that they span.

        rho(u) = height · (1 + bᵀ P b / bᵀ T b)^(−power),      b = [1; u]/√2, or its 10 distinct products (those of two channels times √2)

    P projects on the noise subspace, to which sources are orthogonal, T says by how much they are expected to miss it.

    Attributes:
        noise: (Q, b, b) P, b 4 or 10, one a sensor of the setup.
        spread: (Q, b, b) T.
        height: (Q,) such that the integral over the sphere is the number of sources found; 0 where none was.
        power: (Q,).
        heard: (Q,) bool; False where the sensor says nothing.
    """

    kind: ClassVar[str] = "direction-spectrum"
    noise: Array
    spread: Array
    height: Array
    power: Array
    heard: Bools

    def __post_init__(self) -> None:
        noise = read_only(self.noise, shape=(None, None, None), name="direction spectrum: noise")
        if noise.shape[1:] not in ((4, 4), (10, 10)):
            raise ValueError(f"direction spectrum: noise has shape {noise.shape}; (Q, 4, 4) or (Q, 10, 10) is needed")
        rows = len(noise)
        self._set(
            noise=noise,
            spread=read_only(self.spread, shape=noise.shape, name="direction spectrum: spread"),
            height=read_only(self.height, shape=(rows,), name="direction spectrum: height"),
            power=read_only(self.power, shape=(rows,), name="direction spectrum: power"),
            heard=read_only(self.heard, np.bool_, (rows,), "direction spectrum: heard"),
        )

    @property
    def unit(self) -> str:
        """Sources per steradian."""
        return "1/sr"

    def at(self, z: Floats, sensor: Ints) -> Floats:
        """rho (…, q) towards azimuths and elevations z (…, q, 2), in the array's frame, of the sensors (q,)."""
        z = np.asarray(z, float)
        found = np.empty(z.shape[:-1])
        for column, q in enumerate(sensor):
            found[..., column] = self._of(z[..., column, :], int(q))
        return found

    def _of(self, z: Floats, q: int) -> Floats:
        level = np.cos(z[..., 1])
        u = level * np.cos(z[..., 0]), level * np.sin(z[..., 0]), np.sin(z[..., 1])
        half, root = 0.5, math.sqrt(0.5)
        if self.noise.shape[1] == 4:
            b = np.stack([np.full(level.shape, root), *(root * part for part in u)])
        else:  # in the order of the distinct pairs of channels
            x, y, w = u
            r = root  # √2/2
            b = np.stack(
                [np.full(level.shape, half), r * x, r * y, r * w, half * x * x, r * x * y, r * x * w, half * y * y, r * y * w, half * w * w]
            )
        flat = b.reshape(len(b), -1)
        missed = (flat * (self.noise[q] @ flat)).sum(axis=0)
        expected = (flat * (self.spread[q] @ flat)).sum(axis=0)
        ratio = np.maximum(missed, 0.0) / np.maximum(expected, np.finfo(float).tiny)
        return np.asarray(self.height[q] * np.exp(-self.power[q] * np.log1p(ratio))).reshape(level.shape)


@dataclass(frozen=True, slots=True, eq=False)
class Scan(_Travels):
    """What a tracker gets for one frame.

    Attributes:
        time_s: centre of the analysed samples.
        searched: (Q,) bool. False: no evidence from this sensor (voice inactive, packet lost, only a field), so no
            miss factor. True with no row of its own: a miss.
        detections: one set a sensor group; () where only fields are offered.
        fields: evaluable curves by name.
        pose: (A, 4, 4) at time_s, or None: the setup's.
        extra: small named arrays.
    """

    time_s: float
    searched: Bools
    detections: tuple[Detections, ...] = ()
    fields: Mapping[str, Field] = field(default_factory=lambda: _EMPTY)
    pose: Array | None = None
    extra: Mapping[str, Array] = field(default_factory=lambda: _EMPTY)

    def __post_init__(self) -> None:
        if not math.isfinite(self.time_s):
            raise ValueError(f"scan: time_s is {self.time_s}")
        self._set(
            time_s=float(self.time_s),
            searched=read_only(self.searched, np.bool_, (None,), "scan: searched"),
            detections=tuple(self.detections),
            fields=MappingProxyType(dict(sorted(self.fields.items()))),
            pose=None if self.pose is None else read_only(self.pose, shape=(None, 4, 4), name="scan: pose"),
            extra=MappingProxyType({k: read_only(v) for k, v in sorted(self.extra.items())}),
        )

    def rows(self, sensor: int) -> tuple[Array, Array | None]:
        """Measurements (m, dz) of one sensor and their covariances (m, dz, dz) or None."""
        for group in self.detections:
            mine = group.sensor == sensor
            if mine.any():
                return group.z[mine], None if group.R is None else group.R[mine]
        return np.zeros((0, 0)), None


@dataclass(frozen=True, slots=True, eq=False)
class Estimate(_Travels):
    """What a tracker says after one scan, in its own space; repeated rows are allowed and count.

    Attributes:
        time_s: the scan's time.
        states: (n, d); (0, d) is nobody.
        covs: (n, d, d) or None.
        labels: (n,) int64 never reused in a run, or None (always or never given).
        existence: (n,) probabilities or weights, or None.
        count: expected number of targets, or None.
        info: small diagnostics, for logs only.
    """

    time_s: float
    states: Array
    covs: Array | None = None
    labels: Ints | None = None
    existence: Array | None = None
    count: float | None = None
    info: Mapping[str, float] = field(default_factory=lambda: _EMPTY)

    def __post_init__(self) -> None:
        states = read_only(self.states, shape=(None, None), name="estimate: states")
        n, d = states.shape
        if not np.isfinite(states).all():
            raise ValueError("estimate: states hold NaN or infinity")
        self._set(
            time_s=float(self.time_s),
            states=states,
            covs=None if self.covs is None else read_only(self.covs, shape=(n, d, d), name="estimate: covs"),
            labels=None if self.labels is None else read_only(self.labels, np.int64, (n,), "estimate: labels"),
            existence=None if self.existence is None else read_only(self.existence, shape=(n,), name="estimate: existence"),
            count=None if self.count is None else float(self.count),
            info=MappingProxyType({k: float(v) for k, v in sorted(self.info.items())}),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Truth(_Travels):
    """Where the targets are; seen by metrics only.

    Attributes:
        time_s: (k,) evaluation times.
        label: (n,) int64.
        position: (k, n, 3) m in the room; finite also where a target does not exist.
        exists: (k, n) bool.
        active: (k, n) bool: sounds at that instant (implies exists).
        velocity: (k, n, 3) m/s or None.
        mode: (k, n) int64 motion mode or None.
        valid: (k,) bool; False is not scored.
        period_s: the recording's evaluation period.
        parameters: scalars of the scene that a metric may want.
    """

    time_s: Array
    label: Ints
    position: Array
    exists: Bools
    active: Bools
    velocity: Array | None = None
    mode: Ints | None = None
    valid: Bools | None = None
    period_s: float | None = None
    parameters: Mapping[str, float] = field(default_factory=lambda: _EMPTY)

    def __post_init__(self) -> None:
        time_s = read_only(self.time_s, shape=(None,), name="truth: time_s")
        label = read_only(self.label, np.int64, (None,), "truth: label")
        k, n = len(time_s), len(label)
        self._set(
            time_s=time_s,
            label=label,
            position=read_only(self.position, shape=(k, n, 3), name="truth: position"),
            exists=read_only(self.exists, np.bool_, (k, n), "truth: exists"),
            active=read_only(self.active, np.bool_, (k, n), "truth: active"),
            velocity=None if self.velocity is None else read_only(self.velocity, shape=(k, n, 3), name="truth: velocity"),
            mode=None if self.mode is None else read_only(self.mode, np.int64, (k, n), "truth: mode"),
            valid=read_only(np.ones(k, bool) if self.valid is None else self.valid, np.bool_, (k,), "truth: valid"),
            parameters=MappingProxyType({a: float(v) for a, v in sorted(self.parameters.items())}),
        )
