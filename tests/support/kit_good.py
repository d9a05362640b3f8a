"""The smallest component of each role that holds every claim of the conformance kit; the faults are made from these."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sonobench.errors import SetupError
from sonobench.geometry import sensor_delays, unit_vector
from sonobench.protocols import Directions, Focused, Mixture, Rendering, Series, SoundSignal
from sonobench.scoring import aligned
from sonobench.testing import fixtures
from sonobench.types import Block, Detections, Estimate, Header, MicArray, Scan, Sensor, Setup, Space, Truth


class Belief(NamedTuple):
    time_s: float
    position: Any
    weight: float
    setup: Setup
    sensors: Any
    more: Any = None


@dataclass(frozen=True)
class GoodTracker:
    """One talker: the grid point that explains the rows best pulls the old position, the longer ago the more."""

    grid_m: float = 0.25

    @property
    def space(self) -> Space:
        return Space.of("x_m", "y_m")

    def init(self, rng: Any, setup: Setup) -> Any:
        return Belief(setup.start_s, np.array([2.0, 1.5]), 0.1, setup, setup.of_kind("tdoa", "good"))

    def step(self, rng: Any, state: Any, scan: Scan) -> Any:
        share = 1 - np.exp(-self.dt(state, scan) / 0.3)
        rows = {q: self.rows(scan, q) for q in state.sensors}
        seen = any(len(z) for z in rows.values())
        position = state.position + share * (self.fix(state, rows) - state.position) if seen else state.position
        weight = self.believe(state, scan, seen)
        state = state._replace(time_s=scan.time_s, position=position, weight=weight)
        return state, self.report(state, scan)

    def dt(self, state: Any, scan: Scan) -> float:
        return scan.time_s - state.time_s

    def rows(self, scan: Scan, q: int) -> Any:
        return scan.rows(q)[0]

    def fix(self, state: Any, rows: Any) -> Any:
        (x0, y0), (x1, y1) = state.setup.box_m[:, :2]
        grid = np.stack(np.meshgrid(np.arange(x0, x1, self.grid_m), np.arange(y0, y1, self.grid_m)), axis=-1).reshape(-1, 2)
        cost = np.zeros(len(grid))
        for q, z in rows.items():
            if len(z):
                miss = np.abs(sensor_delays(grid, state.setup, q)[:, None, :] - z).max(axis=-1)
                cost += np.minimum(miss.min(axis=1), 2e-4)
        return grid[np.argmin(cost)]

    def believe(self, state: Any, scan: Scan, seen: bool) -> float:
        return 1.0 if seen else 0.3 * state.weight if scan.searched.any() else state.weight

    def report(self, state: Any, scan: Scan) -> Estimate:
        there = state.weight >= 0.5
        covs = 0.01 * np.eye(2)[None][: int(there)]
        return Estimate(scan.time_s, state.position[None][: int(there)], covs=covs, count=state.weight)


class Buffer(NamedTuple):
    header: Header
    samples: Any
    first: int
    more: Any = None


@dataclass(frozen=True)
class GoodFrontEnd:
    """Frames of 0.1 s; the highest peak of each pair's whitened correlation where the frame is loud."""

    floor_rms: float = 1e-3

    def open(self, header: Header) -> Any:
        if not header.arrays:
            raise SetupError(f"good reads microphones; recording {header.name} has no samples")
        array = header.arrays[0]
        sensors = [
            Sensor(f"pair-{p}", array.name, "tdoa", array.elements[ij], Space.of("tau_s"), [[0, 1]]) for p, ij in enumerate(array.pairs)
        ]
        setup = Setup.from_header(header, sensors, 0.1, array.rate_hz)
        return setup, Buffer(header, np.zeros((0, array.channels)), 0)

    def step(self, state: Any, block: Block) -> Any:
        self.guard(block)
        samples, first, scans = np.concatenate([state.samples, block.samples]), state.first, []
        while len(samples) >= 1600:
            scans += self.scan(state.header, samples[:1600], first)
            samples, first = samples[1600:], first + 1600
        return state._replace(samples=samples, first=first), scans

    def flush(self, state: Any) -> list[Scan]:
        return []

    def guard(self, block: Block) -> None:
        if not np.isfinite(block.samples).all():
            raise ValueError(f"array {block.array}: a sample after {block.first_sample} is not finite")

    def scan(self, header: Header, frame: Any, first: int) -> list[Scan]:
        array = header.arrays[0]
        time_s, pairs = (first + 800) / array.rate_hz, array.pairs
        if np.sqrt(np.mean(frame**2)) < self.floor_rms:
            return self.quiet(time_s, len(pairs))
        cross = np.fft.rfft(frame.T)
        cross = cross[pairs[:, 0]] * cross[pairs[:, 1]].conj()
        lag = np.argmax(np.fft.irfft(cross / (np.abs(cross) + 1e-12)), axis=-1)
        z = ((lag + 800) % 1600 - 800) / array.rate_hz
        return [Scan(time_s, np.ones(len(pairs), bool), (Detections(z[:, None], np.arange(len(pairs))),))]

    def quiet(self, time_s: float, sensors: int) -> list[Scan]:
        return [Scan(time_s, np.zeros(sensors, bool))]


@dataclass(frozen=True)
class GoodPreprocessor:
    """Half of every sample, one sample late."""

    share: float = 0.5

    def start(self, rate_hz: float, channels: int) -> Any:
        return np.zeros((0, channels))

    def process(self, state: Any, samples: Any) -> Any:
        due = np.concatenate([state, self.share * samples])
        return due[-1:].copy(), due[:-1]

    def finish(self, state: Any) -> Any:
        return state


@dataclass(frozen=True)
class GoodDirection:
    """The intensity."""

    def directions(self, samples: Any) -> Any:
        flow = np.mean(samples[..., 1:] * samples[..., :1], axis=1)[:, None]
        length = np.linalg.norm(flow, axis=-1, keepdims=True)
        u = np.divide(flow, length, out=np.zeros_like(flow), where=length > 0)
        return Directions(u, length[..., 0] > 0, np.full((*u.shape[:2], 1, 1), 1e-4) * np.eye(2))


@dataclass(frozen=True)
class Beam:
    """Mean power of p + uᵀv towards u, of a covariance."""

    C: Any
    unit: str = "1"

    def at(self, z: Any, sensor: Any) -> Any:
        a = np.concatenate([np.ones((*np.shape(z)[:-1], 1)), unit_vector(z)], axis=-1)
        return np.einsum("...i,ij,...j->...", a, self.C, a)


@dataclass(frozen=True)
class GoodSpectrum:
    """A beam that is turned."""

    def fields(self, samples: Any) -> Any:
        return [Beam(x.T @ x / len(x)) for x in samples]


@dataclass(frozen=True)
class GoodDelay:
    """PHAT, also of averages."""

    floor: float = 1e-12
    segments: int = 1
    memory_s: float = 0.0

    def correlate(self, spectra: Any, pairs: Any) -> Any:
        cross = spectra[..., pairs[:, 0], :] * spectra[..., pairs[:, 1], :].conj()
        return np.fft.irfft(cross / (np.abs(cross) + self.floor))

    def weigh(self, cross: Any, power: Any, pairs: Any) -> Any:
        return cross / (np.abs(cross) + self.floor)


@dataclass(frozen=True)
class GoodActivity:
    """Louder than ten times the quietest frame so far."""

    ratio: float = 10.0

    def start(self, rate_hz: float) -> Any:
        return np.inf

    def active(self, state: Any, frames: Any) -> Any:
        level = np.sqrt(np.mean(frames**2, axis=(1, 2)))
        floor = np.minimum.accumulate(np.concatenate([[state], level]))
        return floor[-1], level > self.ratio * floor[1:]


@dataclass(frozen=True)
class GoodSound:
    """White noise."""

    rms: float = 0.1

    def render(self, rng: Any, duration_s: float, rate_hz: float) -> Any:
        samples = self.rms * rng.standard_normal(round(duration_s * rate_hz))
        return SoundSignal(samples, (0.0, rate_hz / 2), {"licence": "none", "source": "tests"})


@dataclass(frozen=True)
class GoodMotion:
    """Constant velocity whose positions and velocities are kicked apart."""

    rate: float = 0.3

    n_modes = 1

    @property
    def space(self) -> Space:
        return Space.of("x_m", "vx_m_s", "y_m", "vy_m_s")

    def F(self, dt_s: float) -> Any:
        return np.kron(np.eye(2), np.array([[1.0, dt_s], [0.0, 1.0]]))

    def Q(self, dt_s: float) -> Any:
        return self.rate * dt_s * np.eye(4)

    def moments(self, x: Any, P: Any, mode: Any, dt_s: float, memory: Any = None) -> Any:
        return x @ self.F(dt_s).T, self.F(dt_s) @ P @ self.F(dt_s).T + self.Q(dt_s)

    def sample(self, rng: Any, x: Any, mode: Any, dt_s: float, memory: Any = None) -> Any:
        return x @ self.F(dt_s).T + np.sqrt(self.rate * dt_s) * rng.standard_normal(x.shape), mode

    def log_density(self, x1: Any, x0: Any, mode: Any, dt_s: float, memory: Any = None) -> Any:
        r, variance = x1 - x0 @ self.F(dt_s).T, self.rate * dt_s
        return -0.5 * np.sum(r**2, axis=-1) / variance - 2 * np.log(2 * np.pi * variance)


@dataclass(frozen=True)
class GoodMeasurement:
    """Delays."""

    def bind(self, space: Space, setup: Setup) -> Any:
        setup.of_kind("tdoa", "good")
        return self.bound(space, setup)

    def bound(self, space: Space, setup: Setup) -> Any:
        return fixtures.SensorMeasurement(space, setup)


@dataclass(frozen=True)
class GoodLikelihood:
    """The correlation at a talker's delays, cubed."""

    scale: float = 20.0

    def bind(self, space: Space, setup: Setup) -> Any:
        return self.bound(space, setup, tuple(setup.of_kind("tdoa", "good", "pair")))

    def bound(self, space: Space, setup: Setup, sensors: tuple[int, ...]) -> Any:
        return LikelihoodOfPairs(space, setup, sensors, self.scale)


@dataclass(frozen=True)
class LikelihoodOfPairs:
    space: Space
    setup: Setup
    sensors: tuple[int, ...]
    scale: float

    def log_ratio(self, x: Any, scan: Scan) -> Any:
        if "gcc" not in scan.fields:
            return None
        points = x[:, self.space.index(*(n for n in ("x_m", "y_m", "z_m") if n in self.space.names))]
        return self.ratio(np.stack([self.look(points, scan, q) for q in self.sensors], axis=1))

    def focused(self, x: Any, w: Any, scan: Scan) -> Any:
        return None if "gcc" not in scan.fields else Focused(lambda at: self.log_ratio(at, scan))

    def look(self, points: Any, scan: Scan, q: int) -> Any:
        delays = fixtures.measured_of(points, self.setup.sensors[q], self.setup.c_m_s)
        return scan.fields["gcc"].at(delays[:, None], np.array([q]))[:, 0]

    def ratio(self, values: Any) -> Any:
        return self.scale * np.sum(values**3, axis=1)


@dataclass(frozen=True)
class GoodTransform:
    """Linearisation."""

    def points(self, m: Any, P: Any) -> Any:
        return m[..., None, :], np.ones(1)

    def measure(self, m: Any, P: Any, measurement: Any, q: int, pose: Any = None) -> Any:
        H = measurement.jacobian(m, q)[..., 0, :, :]
        C = P @ np.swapaxes(H, -1, -2)
        return measurement.h(m, q)[..., 0, :], H @ C, C


@dataclass(frozen=True)
class GoodBirth:
    """One component in the middle of the room, a little beside it at every scan."""

    uses_scan = False

    def start(self, space: Space, setup: Setup, measurement: Any) -> Any:
        return (0, space)

    def propose(self, rng: Any, memory: Any, scan: Scan, live: Mixture) -> Any:
        count, space = memory
        middle = np.array([1.5 + 0.01 * count if n.endswith("_m") else 0.0 for n in space.names])
        return (count + 1, space), self.mixture(middle + 0.1 * rng.standard_normal(len(space)), scan)

    def mixture(self, m: Any, scan: Scan) -> Any:
        return Mixture(np.array([0.1]), m[None], np.eye(len(m))[None], np.zeros(1, np.int64))


@dataclass(frozen=True)
class GoodSpawn:
    """One component at the place of each, as wide again."""

    weight: float = 0.1

    def spawned(self, moved: Mixture) -> Mixture:
        return Mixture(self.weight * moved.w, moved.m, 2 * moved.P, moved.mode)


@dataclass(frozen=True)
class GoodMetric:
    """Mean nearest distance, both ways, cut at 1 m; 1 m where one side is empty."""

    c_m: float = 1.0

    def evaluate(self, truth: Truth, output: Any, space: Any) -> Any:
        frames = aligned(truth, output, space, None).frames
        values = np.array([self.one(f.truth, f.estimates) for f in frames])
        return {"": Series(values, np.ones(len(values)), "m")}

    def one(self, x: Any, y: Any) -> float:
        if not len(x) or not len(y):
            return self.c_m if len(x) or len(y) else 0.0
        d = np.minimum(np.linalg.norm(x[:, None] - y[None], axis=-1), self.c_m)
        return float(max(d.min(axis=0).mean(), d.min(axis=1).mean()))


@dataclass(frozen=True)
class GoodTrajectory:
    """Along x for four seconds."""

    speed_m_s: float = 0.5

    def position(self, time_s: Any) -> Any:
        x = self.speed_m_s * np.clip(time_s, 0.0, 4.0)
        return np.stack([x, np.ones_like(x), np.ones_like(x)], axis=-1)


@dataclass(frozen=True)
class GoodSimulator:
    """Noise at every microphone."""

    def simulate(self, scene: Any, seed: int) -> Any:
        array = MicArray("walls", "microphones", fixtures.microphones(), 8000.0, fixtures.PAIRS)
        header = Header("tiny", (array,), np.eye(4)[None], duration_s=0.3)
        noise = self.rng(seed).standard_normal((2400, 8)).astype(np.float32)
        return Rendering(header, self.blocks(noise), (), fixtures.truth(3), {}, {})

    def rng(self, seed: int) -> Any:
        return np.random.default_rng(seed)

    def blocks(self, noise: Any) -> Any:
        return [Block("walls", n, noise[n : n + 800]) for n in (0, 800, 1600)]
