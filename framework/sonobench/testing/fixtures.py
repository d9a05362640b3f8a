"""What components are tried on: a room of 4 × 3 × 2.5 m with four microphone pairs on its walls and two walking talkers.

Numpy only. Every array that is handed out is fresh and, where its type makes it so, read-only.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sonobench.geometry import angles, lift, max_delay, pair_delays, unit_vector
from sonobench.signal import subspace
from sonobench.signal.cumulants import LIVE
from sonobench.types import (
    Array,
    Block,
    DelayTable,
    Detections,
    DirectionSpectrum,
    Field,
    Header,
    MicArray,
    Scan,
    Sensor,
    Setup,
    Space,
    Truth,
)

BOX_M = np.array([[0.0, 0.0, 0.0], [4.0, 3.0, 2.5]])
HEIGHT_M = 1.2
C_M_S = 343.0
PERIOD_S = 0.1
RATE_HZ = 16000.0
DELAY_STD_S = 4e-5
POSITION_STD_M = 0.02
DIRECTION_STD_RAD = 0.02
PAIRS = np.array([[0, 1], [2, 3], [4, 5], [6, 7]])
NOMINAL = {
    "p_d": 0.95,
    "clutter_per_scan": 0.5,
    "delay_std_s": DELAY_STD_S,
    "position_std_m": POSITION_STD_M,
    "direction_std_rad": DIRECTION_STD_RAD,
    "height_m": HEIGHT_M,
    "count": 2.0,
}
#: what a scene of a vector sensor writes into its truth
PARAMETERS = {
    **{f"origin_{axis}_m": 0.0 for axis in "xyz"},
    "source_variance": 1.0,
    "pressure_noise_variance": 0.5,
    "velocity_noise_variance": 0.2,
    "snapshots": 1000.0,
}
_ON_WALLS = np.array(
    [[0.05, 1.2], [0.05, 1.8], [3.95, 1.2], [3.95, 1.8], [1.7, 0.05], [2.3, 0.05], [1.7, 2.95], [2.3, 2.95]],
)
_HEIGHTS = np.array([0.9, 1.5, 1.6, 0.9, 1.0, 1.5, 1.5, 0.8])


#: state spaces that components are tried on, in this order
SPACES = (
    Space.of("x_m", "vx_m_s", "y_m", "vy_m_s"),
    Space.of("x_m", "vx_m_s", "y_m", "vy_m_s", "z_m", "vz_m_s"),
    Space.of("x_m", "y_m", "z_m"),
    Space.of("azimuth_rad", "azimuth_rad_s", "elevation_rad", "elevation_rad_s"),
)


def microphones(planar: bool = False) -> Array:
    """(8, 3) m; all at the talkers' height, or spread around it."""
    heights = np.full(8, HEIGHT_M) if planar else _HEIGHTS
    return np.column_stack([_ON_WALLS, heights])


def sensors(grouping: str, planar: bool = False) -> tuple[Sensor, ...]:
    """ "pairs": four sensors of one delay; "stack": one of four; "both": the stack and then the pairs; "positions": one of x and y; "directions": one."""
    mics = microphones(planar)
    stack = Sensor("stack", "walls", "tdoa", mics, Space(tuple(f"tau{p}_s" for p in range(4))), PAIRS)
    pairs = tuple(Sensor(f"pair-{p}", "walls", "tdoa", mics[ij], Space.of("tau_s"), np.array([[0, 1]])) for p, ij in enumerate(PAIRS))
    floor = Sensor("position", "walls", "position", np.zeros((0, 3)), Space.of("x_m", "y_m"))
    ear = Sensor("direction", "walls", "direction", np.array([[2.0, 0.3, 0.4]]), Space.of("azimuth_rad", "elevation_rad"))
    return {"pairs": pairs, "stack": (stack,), "both": (stack, *pairs), "positions": (floor,), "directions": (ear,)}[grouping]


def setup(grouping: str = "pairs", planar: bool = False) -> Setup:
    """What a tracker is told; everything that the recording gives is given."""
    return Setup(
        sensors=sensors(grouping, planar),
        array_names=("walls",),
        poses=np.eye(4)[None],
        period_s=PERIOD_S,
        c_m_s=C_M_S,
        rate_hz=RATE_HZ,
        box_m=BOX_M,
        reflections=np.full(6, 0.6),
        nominal=NOMINAL,
        given=given(),
    )


def foreign_setup() -> Setup:
    """The same room, whose only sensor is of a kind that nobody reads."""
    nose = Sensor("nose-0", "walls", "odour", np.zeros((1, 3)), Space.of("strength_1"))
    return dataclasses.replace(setup(), sensors=(nose,))


def given() -> dict[str, Array]:
    """What a scene may hand out, in the shapes of scenes: starts (n, 7) t, position, velocity; births (n, 3); source_count (k, 2) t, n."""
    start, later = talkers(np.array([0.0, 1.0]))
    times = regular(100)
    return {
        "starts": np.concatenate([np.zeros((2, 1)), start, later - start], axis=1),
        "births": start,
        "source_count": np.stack([times, np.full(100, 2.0)], axis=1),
        "activity": np.stack([times, np.ones(100), np.ones(100)], axis=1),
        "snr_db": np.array([20.0]),
    }


def talkers(time_s: Array) -> Array:
    """(k, 2, 3) m: two talkers who walk straight on for ten seconds."""
    start = np.array([[1.0, 0.9, HEIGHT_M], [3.0, 2.1, HEIGHT_M]])
    velocity = np.array([[0.15, 0.1, 0.0], [-0.15, -0.08, 0.0]])
    return np.asarray(start + np.asarray(time_s)[:, None, None] * velocity)


def regular(k: int, period_s: float = PERIOD_S) -> Array:
    """k scan times."""
    return np.asarray(period_s * np.arange(1, k + 1), float)


def scan(setup: Setup, time_s: float, points: Array, rng: np.random.Generator, clutter: int = 1, noise_s: float = DELAY_STD_S / 2) -> Scan:
    """What every sensor of a setup measures of points (n, 3), and `clutter` false rows a sensor, in no order."""
    groups: dict[int, list[tuple[int, Array]]] = {}
    for q, unit in enumerate(setup.sensors):
        low, high = limits(unit, setup.c_m_s)
        noise = noise_s if unit.kind == "tdoa" else deviation(unit) / 2
        true = measured_of(points, unit, setup.c_m_s)
        seen = np.clip(true + noise * rng.standard_normal(true.shape), low, high)
        rows = np.concatenate([seen, rng.uniform(low, high, (clutter, len(high)))])
        groups.setdefault(len(high), []).append((q, rng.permutation(rows)))
    detections = tuple(
        Detections(np.concatenate([z for _, z in group]), np.concatenate([np.full(len(z), q) for q, z in group]))
        for group in groups.values()
    )
    return Scan(float(time_s), np.ones(len(setup.sensors), bool), detections, fields(setup, time_s, points))


def fields(setup: Setup, time_s: float, points: Array) -> dict[str, Field]:
    """ "gcc", a table of the single pairs, and "spectrum" where there are sensors of directions."""
    found: dict[str, Field] = {"gcc": table(setup, time_s, points)}
    if any(unit.kind == "direction" for unit in setup.sensors):
        found["spectrum"] = spectrum(setup, points)
    return found


def spectrum(setup: Setup, points: Array) -> DirectionSpectrum:
    """Peaks 2° wide towards each of the points (n, 3), of the subspace that cumulants without error would have."""
    rows = []
    for unit in setup.sensors:
        u = unit_vector(measured_of(points, unit, setup.c_m_s)) if unit.kind == "direction" else np.zeros((0, 3))
        sources = np.linalg.qr(subspace.steering(u, 10).T)[0]
        noise = LIVE @ LIVE.T - sources @ sources.T
        rows.append(subspace.spectrum(subspace.Subspace(noise, 0 * noise, len(u), np.zeros(9)), 2 * DIRECTION_STD_RAD))
    heard = np.array([unit.kind == "direction" for unit in setup.sensors])
    parts = {name: np.concatenate([getattr(row, name) for row in rows]) for name in ("noise", "spread", "height", "power")}
    return DirectionSpectrum(**parts, heard=heard)


def table(setup: Setup, time_s: float, points: Array) -> DelayTable:
    """A correlation a single pair: a peak two samples wide of height .4 at the delay of each point (n, 3), in noise of deviation .03; else zeros."""
    step_s, reach_s = 0.25 / RATE_HZ, 2.5e-3
    lags = step_s * np.arange(round(2 * reach_s / step_s) + 1) - reach_s
    values = np.zeros((len(setup.sensors), len(lags)), np.float32)
    for q, unit in enumerate(setup.sensors):
        if unit.kind == "tdoa" and len(unit.space) == 1:
            own = np.random.default_rng([q, round(1e6 * time_s)])
            off = np.abs(lags - measured_of(points, unit, setup.c_m_s)) * RATE_HZ
            values[q] = 0.4 * np.maximum(1.0 - off, 0.0).sum(axis=0) + 0.03 * own.standard_normal(len(lags))
    return DelayTable(values, -reach_s, step_s)


def limits(unit: Sensor, c_m_s: float) -> tuple[Array, Array]:
    """The lowest and highest (dz,) that a sensor can measure."""
    if unit.kind == "position":
        return BOX_M[0, : len(unit.space)], BOX_M[1, : len(unit.space)]
    if unit.kind == "direction":
        return np.array([-np.pi, -np.pi / 2]), np.array([np.pi, np.pi / 2])
    high = max_delay(unit.elements, unit.pairs, c_m_s)
    return -high, high


def deviation(unit: Sensor) -> float:
    """The nominal deviation of what a sensor measures."""
    return {"tdoa": DELAY_STD_S, "direction": DIRECTION_STD_RAD}.get(unit.kind, POSITION_STD_M)


def measured_of(points: Any, unit: Sensor, c_m_s: float) -> Array:
    """Noise-free measurements (…, dz) of points (…, 2 or 3)."""
    points = lift(points, HEIGHT_M)
    if unit.kind == "direction":
        return np.asarray(angles(points - unit.elements[0]))
    return np.asarray(points[..., : len(unit.space)] if unit.kind == "position" else pair_delays(points, unit.elements, unit.pairs, c_m_s))


def scans(
    setup: Setup, times_s: Sequence[float] | Array, clutter: int = 1, truth_times_s: Array | None = None, seed: int = 1
) -> list[Scan]:
    """Scans of the two talkers; `truth_times_s` says when the talkers were where they are seen (default: at the scans)."""
    rng = np.random.default_rng(seed)
    where = talkers(np.asarray(times_s if truth_times_s is None else truth_times_s))
    return [scan(setup, t, points, rng, clutter) for t, points in zip(times_s, where, strict=True)]


def silent(setup: Setup, time_s: float, searched: bool) -> Scan:
    """A scan without rows: a miss of everything where searched, no evidence where not."""
    return Scan(float(time_s), np.full(len(setup.sensors), searched))


def permuted(scan: Scan, rng: np.random.Generator) -> Scan:
    """The same scan with the rows of every set in another order."""

    def shuffled(group: Detections) -> Detections:
        order = rng.permutation(len(group))
        kept = {n: None if getattr(group, n) is None else getattr(group, n)[order] for n in ("R", "score", "valid")}
        return Detections(group.z[order], group.sensor[order], **kept)

    return dataclasses.replace(scan, detections=tuple(shuffled(g) for g in scan.detections))


@dataclass(frozen=True, eq=False)
class MemoryRecording:
    """A recording that was never written: what `Pipeline` and front ends read of one."""

    header: Header
    _blocks: tuple[Block, ...] = ()
    _scans: tuple[Scan, ...] = ()
    input_sha: str = "synthetic"

    def blocks(self) -> Iterator[Block]:
        """Samples in time order."""
        return iter(self._blocks)

    def scans(self) -> Iterator[Scan]:
        """Recorded scans in time order."""
        return iter(self._scans)


def samples(duration_s: float = 1.2, sounding: tuple[float, float] = (0.0, 1.2), seed: int = 3) -> Array:
    """(n, 8) of one talker who stands at `talkers(0)[0, 0]` and hisses, over faint sensor noise; float64."""
    rng = np.random.default_rng(seed)
    n = round(duration_s * RATE_HZ)
    time_s = np.arange(n) / RATE_HZ
    spectrum = np.fft.rfft(rng.standard_normal(n) * ((time_s >= sounding[0]) & (time_s < sounding[1])))
    distance = np.linalg.norm(microphones() - talkers(np.zeros(1))[0, 0], axis=1)
    turn = np.exp(-2j * np.pi * np.fft.rfftfreq(n, 1 / RATE_HZ) * distance[:, None] / C_M_S)
    received = np.fft.irfft(spectrum * turn / distance[:, None], n).T
    return np.asarray(0.1 * received + 1e-4 * rng.standard_normal((n, 8)))


def cut(samples: Array, lengths: Sequence[int]) -> tuple[Block, ...]:
    """Blocks of these lengths, over and over, until the samples are used up."""
    blocks: list[Block] = []
    first = 0
    while first < len(samples):
        n = lengths[len(blocks) % len(lengths)]
        blocks.append(Block("walls", first, samples[first : first + n].astype(np.float32)))
        first += n
    return tuple(blocks)


def sampled(signal: Array | None = None, lengths: Sequence[int] = (1600,)) -> MemoryRecording:
    """A recording of samples."""
    signal = samples() if signal is None else signal
    array = MicArray("walls", "microphones", microphones(), RATE_HZ, PAIRS)
    return MemoryRecording(_header(len(signal) / RATE_HZ, (array,), ()), cut(signal, lengths))


def measured(k: int = 12, grouping: str = "pairs") -> MemoryRecording:
    """A recording of scans without samples."""
    told = setup(grouping)
    header = dataclasses.replace(_header(k * PERIOD_S, (), told.sensors), period_s=PERIOD_S)
    return MemoryRecording(header, (), tuple(scans(told, regular(k))))


def _header(duration_s: float, arrays: tuple[MicArray, ...], sensors: tuple[Sensor, ...]) -> Header:
    return Header(
        name="synthetic",
        arrays=arrays,
        poses=np.eye(4)[None],
        sensors=sensors,
        array_names=("walls",),
        duration_s=duration_s,
        c_m_s=C_M_S,
        box_m=BOX_M,
        reflections=np.full(6, 0.6),
        band_hz=np.array([0.0, RATE_HZ / 2]),
        nominal=NOMINAL,
        given=given(),
    )


def truth(k: int = 10) -> Truth:
    """The two talkers at regular times, sounding throughout."""
    times_s = regular(k)
    there = np.ones((k, 2), bool)
    velocity = np.gradient(talkers(times_s), times_s, axis=0)
    return Truth(times_s, np.array([1, 2]), talkers(times_s), there, there, velocity=velocity, period_s=PERIOD_S, parameters=PARAMETERS)


def nobody(k: int = 10) -> Truth:
    """Truth without targets."""
    none: Any = np.zeros((k, 0), bool)
    still = np.zeros((k, 0, 3))
    return Truth(regular(k), np.zeros(0, int), still, none, none, velocity=still, period_s=PERIOD_S, parameters=PARAMETERS)


def gaussians(space: Space, n: int = 5) -> tuple[Array, Array, Any]:
    """n Gaussians around the middle of the room, slow; mode 0."""
    rng = np.random.default_rng(8)
    root = 0.3 * np.random.default_rng(0).standard_normal((n, len(space), len(space)))
    angular = np.array([name.split("_")[0] in ("azimuth", "elevation") for name in space.names])
    root = np.where(angular[:, None], 0.2, 1.0) * root  # within a hemisphere
    middle = [1.5 if name in ("x_m", "y_m", "z_m") else 0.2 for name in space.names]
    return (
        np.array(middle) + np.where(angular, 0.1, 0.3) * rng.standard_normal((n, len(space))),
        np.asarray(root @ np.swapaxes(root, 1, 2) + np.diag(np.where(angular, 4e-4, 0.01))),
        np.zeros(n, np.int64),
    )


@dataclass(frozen=True, eq=False)
class LinearMeasurement:
    """z = H x + b with one sensor: what a transform must carry through exactly."""

    H: Array
    b: Array
    sensors: tuple[int, ...] = (0,)
    n_modes: int = 1

    def h(self, x: Any, q: int, pose: Any = None) -> Any:
        """(…, 1, dz)."""
        return (np.asarray(x) @ self.H.T + self.b)[..., None, :]

    def jacobian(self, x: Any, q: int, pose: Any = None) -> Any:
        """(…, 1, dz, d)."""
        return np.broadcast_to(self.H, (*np.shape(x)[:-1], 1, *self.H.shape))

    def residual(self, z: Any, z_hat: Any, q: int) -> Any:
        """z − ẑ."""
        return np.asarray(z) - np.asarray(z_hat)

    def R(self, q: int, scan: Any = None) -> Array:
        """Identity."""
        return np.eye(len(self.b))

    def p_d(self, x: Any, q: int, scan: Any = None) -> Any:
        """0.9 everywhere."""
        return np.full((*np.shape(x)[:-1], 1), 0.9)

    def log_clutter(self, z: Any, q: int) -> Any:
        """One false row a unit."""
        return np.zeros(np.shape(z)[:-1])


@dataclass(frozen=True, eq=False)
class SensorMeasurement:
    """The delays, positions or directions that a setup's sensors measure, with a Jacobian by differences: what births are tried with."""

    space: Space
    setup: Setup
    n_modes: int = 1

    @property
    def sensors(self) -> tuple[int, ...]:
        """All of the setup."""
        return tuple(range(len(self.setup.sensors)))

    def h(self, x: Any, q: int, pose: Any = None) -> Any:
        """(…, 1, dz)."""
        unit = self.setup.sensors[q]
        columns = self.space.index(*(n for n in ("x_m", "y_m", "z_m") if n in self.space.names))
        return measured_of(np.asarray(x)[..., columns], unit, self.setup.c_m_s)[..., None, :]

    def jacobian(self, x: Any, q: int, pose: Any = None) -> Any:
        """(…, 1, dz, d)."""
        x = np.asarray(x)
        step = 1e-6 * np.eye(x.shape[-1])
        columns = [(self.h(x + s, q) - self.h(x - s, q)) / 2e-6 for s in step]
        return np.stack(columns, axis=-1)

    def residual(self, z: Any, z_hat: Any, q: int) -> Any:
        """z − ẑ."""
        return np.asarray(z) - np.asarray(z_hat)

    def R(self, q: int, scan: Any = None) -> Array:
        """Twice the fixture's noise."""
        unit = self.setup.sensors[q]
        return np.eye(len(unit.space)) * deviation(unit) ** 2

    def p_d(self, x: Any, q: int, scan: Any = None) -> Any:
        """Nominal."""
        return np.full((*np.shape(x)[:-1], 1), NOMINAL["p_d"])

    def log_clutter(self, z: Any, q: int) -> Any:
        """Uniform over what the sensor can measure."""
        low, high = limits(self.setup.sensors[q], self.setup.c_m_s)
        inside = np.all((np.asarray(z) >= low) & (np.asarray(z) <= high), axis=-1)
        return np.where(inside, np.log(NOMINAL["clutter_per_scan"]) - np.log(high - low).sum(), -np.inf)
