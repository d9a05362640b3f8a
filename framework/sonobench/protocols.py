"""The roles: what a component of each kind must be able to do.

Structural: nothing is subclassed. A component is a frozen dataclass whose fields are its parameters; data reach it by
`open`, `bind`, `init` and `setup`. A new role is one Protocol here and one line in `ROLES`.
Batch axes come first, vectors in the last axis, matrices in the last two.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from sonobench.types import Array, Block, Bools, Estimate, Field, Floats, Header, Ints, Scan, Setup, Space, Truth

Complexes = NDArray[np.complexfloating[Any, Any]]
State = Any  # each component's own immutable state; opaque to the framework, picklable


@runtime_checkable
class FrontEnd(Protocol):
    """Samples (or recorded scans) → scans. Memory (averaging, noise floor) is its State.

    Optional class attributes: `consumes` ("samples", the default, or "scans": step then gets the recording's Scans
    instead of Blocks) and `causal` (default True; False marks one that reads ahead).
    """

    def open(self, header: Header) -> tuple[Setup, State]:
        """The setup of all scans to come; SetupError where the recording lacks what this front end reads."""
        ...

    def step(self, state: State, block: Any) -> tuple[State, list[Scan]]:
        """Take the next Block (any length, any array), return the scans that are complete."""
        ...

    def flush(self, state: State) -> list[Scan]:
        """The scans that only the end of the recording completes."""
        ...


@runtime_checkable
class Preprocessor(Protocol):
    """Samples → samples of one array (one clock), before they are cut into frames; at an instant the same is done to all channels.

    Sample k of what comes out stands for sample k of what went in. One that must look ahead gives its samples later and the rest
    at `finish`, so that times stay right; how the samples were cut into calls changes no bit. Silence stays silent.
    Optional attribute `passes_hz` (low, high): where it leaves sound; front ends leave the rest out of their transforms.
    """

    def start(self, rate_hz: float, channels: int) -> State:
        """State before the first sample; SetupError where the rate does not suit its parameters."""
        ...

    def process(self, state: State, samples: Array) -> tuple[State, Array]:
        """Take the next (n, channels), n of at least 1, and return those that are ready (n', channels), n' of at least 0."""
        ...

    def finish(self, state: State) -> Array:
        """The samples that were still due, (n', channels)."""
        ...


@runtime_checkable
class Delay(Protocol):
    """Spectra → generalised cross-correlations.

    An estimator that weighs averaged spectra (coherence needs averages: of one periodogram it is 1 everywhere) also has

        segments: int       Welch segments of a frame, half overlapping; 1 is the whole frame
        memory_s: float     time constant of the average over frames, 0 for none
        weigh(cross, power, pairs)

    cross (…, P, bin) complex being the averaged S_i conj(S_j), power (…, mic, bin) the averaged |S|²; it returns the weighted
    cross-spectra (…, P, bin). Front ends then use `weigh` in place of `correlate`, scale each so that the magnitudes average
    to one over the bins, and transform back; `sonobench.signal.weighed` is the `correlate` that goes with it. One that depends on where
    the microphones are has `bind(bin_hz, spacing_m (P,), c_m_s) -> Delay`, which front ends call once: bin k lies at k bin_hz.
    """

    def correlate(self, spectra: Complexes, pairs: Ints) -> Floats:
        """One-sided spectra (…, mic, bin) of `2 (bin − 1)` samples, pairs (P, 2) → circular correlation (…, P, lag), zero lag first.

        The peak of pair (i, j) lies at the lag by which i is later than j. Must be a function of its arguments only.
        """
        ...


class Directions(NamedTuple):
    """Directions of arrival at a vector sensor, by frame.

    u (f, n, 3) unit vectors towards the sources, in the array's frame; valid (f, n) bool, False where a row stands for nothing (its u is
    finite all the same); R (f, n, 2, 2) covariance of (azimuth, elevation) rad², or None where the method has none; score (f, n) or None.
    """

    u: Array
    valid: Bools
    R: Array | None = None
    score: Array | None = None


@runtime_checkable
class Direction(Protocol):
    """Samples of one vector sensor → directions of arrival, frame by frame."""

    def directions(self, samples: Floats) -> Directions:
        """Frames (f, N, 4) of real samples (p, vx, vy, vz) → Directions of at most n sources each.

        Velocities are scaled by −ρ0 c: a plane wave s from the direction u reads (s, u s). Must be a function of its argument only, and of
        each frame by itself.
        """
        ...


@runtime_checkable
class Spectrum(Protocol):
    """Samples of one vector sensor → fields over directions, frame by frame, without picking peaks."""

    def fields(self, samples: Floats) -> Sequence[Field]:
        """Frames (f, N, 4) as in `Direction` → f fields, each to be evaluated at z (…, q, 2), azimuth and elevation in the array's frame."""
        ...


@runtime_checkable
class Activity(Protocol):
    """Says which frames hold voice."""

    def start(self, rate_hz: float) -> State:
        """State before the first frame."""
        ...

    def active(self, state: State, frames: Floats) -> tuple[State, Bools]:
        """Frames (f, n, channels) in order → (state, (f,) bool)."""
        ...


@runtime_checkable
class Motion(Protocol):
    """How targets move. `mode` (n,) int sits beside particles and components alike; dt_s is never assumed constant.

    A model with n_modes > 1 also has

        branches(x, P, mode, dt_s, memory=None)

    probability (n, n_modes) of each next mode, and means (n, n_modes, d) and covariances (n, n_modes, d, d) of the Gaussians by each.
    `mode` is that before the step throughout; `moments` are those of all branches together.

    A model that learns from updates also has

        adapt(memory, prior, posterior, dt_s)

    the memory after an update moved a target's mean from prior (d,) to posterior (d,), dt_s after the update before; `memory` None is the
    start's. Where `adaptive` is False it learns nothing. Trackers of one target carry the memory; the others refuse such a model.
    """

    @property
    def space(self) -> Space:
        """The state's coordinates."""
        ...

    @property
    def n_modes(self) -> int:
        """Number of motion modes, 1 for a single model."""
        ...

    def moments(self, x: Array, P: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Array]:
        """Predicted means (n, d) and covariances (n, d, d) of Gaussians (n, d), (n, d, d)."""
        ...

    def sample(self, rng: np.random.Generator, x: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Ints]:
        """Draw the next states and modes of particles (n, d)."""
        ...

    def log_density(self, x1: Array, x0: Array, mode: Ints, dt_s: float, memory: State = None) -> Array:
        """log p(x1 | x0, mode) (n,); −inf off the support of a degenerate model."""
        ...


@runtime_checkable
class BoundMeasurement(Protocol):
    """A measurement model that knows the state space and the setup; `q` indexes Setup.sensors.

    A measurement space may be curved (directions are): its differences are then steps in the plane that touches it at ẑ.
    `residual(z, ẑ)` is that step, `jacobian` and the model's `R` are in its axes, `log_clutter` is per unit of its area, and there are

        moved(z_hat, step, q)     where a step (…, dz) leads to from ẑ (…, dz): residual(moved(ẑ, s), ẑ) = s
        noise(R, z, z_hat, q)     covariances R (…, dz, dz) that rows z state for their own components, as those of residual(z, ẑ)

    for `points.image_moments` and `evidence.noise_of`, through which every filter goes.
    """

    @property
    def sensors(self) -> tuple[int, ...]:
        """The sensors that it reads."""
        ...

    @property
    def n_modes(self) -> int:
        """L, the detections that one target can cause at a sensor; 1 is the usual."""
        ...

    def h(self, x: Floats, q: int, pose: Array | None = None) -> Floats:
        """Noise-free measurements (…, L, dz) of states (…, d); `pose` (4, 4) overrides the setup's."""
        ...

    def jacobian(self, x: Floats, q: int, pose: Array | None = None) -> Floats:
        """dh/dx (…, L, dz, d)."""
        ...

    def residual(self, z: Floats, z_hat: Floats, q: int) -> Floats:
        """z − ẑ in the sensor's space, wrapped where it is periodic."""
        ...

    def R(self, q: int, scan: Scan | None = None) -> Array:
        """Noise covariance (dz, dz)."""
        ...

    def p_d(self, x: Floats, q: int, scan: Scan | None = None) -> Floats:
        """Probability of detection (…, L)."""
        ...

    def log_clutter(self, z: Floats, q: int, valid: Bools | None = None) -> Floats:
        """log of the clutter intensity (…,), per unit of measurement space; −inf outside its support.

        With `valid` (dz,) bool, of rows that have only these components: the intensity's marginal.
        """
        ...


@runtime_checkable
class Measurement(Protocol):
    """What sensors would measure of a state."""

    def bind(self, space: Space, setup: Setup) -> BoundMeasurement:
        """Look up names, sensors and nominal values once; SetupError where something is missing."""
        ...


class Focused(NamedTuple):
    """What a scan says once it is known where the target may be: candidates chosen, features weighed.

    log_ratio: as `BoundLikelihood.log_ratio` of this scan, at any later points (n, d); for this step only, never kept in a state.
    measurement, rows: for Gaussian proposals, (sensor q, z (dz,), R (dz, dz)) of the rows that were chosen; none, or None and (), where it
    offers no such rows.
    """

    log_ratio: Callable[[Floats], Array]
    measurement: BoundMeasurement | None = None
    rows: tuple[tuple[int, Array, Array], ...] = ()


@runtime_checkable
class BoundLikelihood(Protocol):
    """A likelihood of fields that knows the state space and the setup.

    Optional method, for evidence whose choice among candidates depends on where the target may be:

        focused(x, w, scan) -> Focused | None

    x (n, d) being the predicted particles and w (n,) their weights, which sum to 1; None as `log_ratio`. Trackers of one target use it
    in place of `log_ratio` where it is there.
    """

    @property
    def sensors(self) -> tuple[int, ...]:
        """The sensors whose fields it reads."""
        ...

    def log_ratio(self, x: Floats, scan: Scan) -> Array | None:
        """log p(fields | one target at x) − log p(fields | none) (n,) at any points x (n, d); None where the scan holds no such field.

        InputError where the front end offers other evidence, but not the field that this reads.
        """
        ...


@runtime_checkable
class Likelihood(Protocol):
    """How probable a scan's fields are with a target somewhere, beside nobody anywhere: evidence without detections."""

    def bind(self, space: Space, setup: Setup) -> BoundLikelihood:
        """Look up names, sensors and nominal values once; SetupError where something is missing."""
        ...


@runtime_checkable
class Transform(Protocol):
    """How moments pass through a nonlinear function."""

    def points(self, m: Array, P: Array) -> tuple[Array, Array]:
        """Points (…, p, d) and weights (p,) of Gaussians (…, d), (…, d, d); for a linearisation p = 1."""
        ...

    def measure(self, m: Array, P: Array, measurement: BoundMeasurement, q: int, pose: Array | None = None) -> tuple[Array, Array, Array]:
        """ẑ (…, dz), covariance of h (…, dz, dz) without R, cross-covariance (…, d, dz) of Gaussians through h."""
        ...


class Mixture(NamedTuple):
    """Weighted Gaussians as arrays: w (J,), m (J, d), P (J, d, d), mode (J,)."""

    w: Array
    m: Array
    P: Array
    mode: Ints


@runtime_checkable
class Birth(Protocol):
    """Where targets may appear.

    Attribute `uses_scan`: True when proposals come from the scan's own measurements (which must then not be counted
    twice: the tracker adds them after its update), False when they are a prior that goes through the update.
    Optional method `initial(memory) -> Mixture`: components that exist at the setup's start already; they are predicted
    before the first update, as births are not.
    """

    @property
    def uses_scan(self) -> bool: ...

    def start(self, space: Space, setup: Setup, measurement: BoundMeasurement) -> State:
        """Memory before the first scan."""
        ...

    def propose(self, rng: np.random.Generator, memory: State, scan: Scan, live: Mixture) -> tuple[State, Mixture]:
        """Born components; a particle tracker samples from them."""
        ...


@runtime_checkable
class Spawn(Protocol):
    """Where targets split off others."""

    def spawned(self, moved: Mixture) -> Mixture:
        """What splits off the posterior of the last scan, whose components come moved to this one with their weights (before p_S).

        SetupError where the components are of another dimension than this expects; trackers ask at init, with no component.
        """
        ...


@runtime_checkable
class Tracker(Protocol):
    """Scans → estimates. Optionally `run(rng, setup, scans) -> list[Estimate]` (a smoother; marked offline)."""

    @property
    def space(self) -> Space:
        """Coordinates of Estimate.states."""
        ...

    def init(self, rng: np.random.Generator, setup: Setup) -> State:
        """State before frame 1; SetupError where the setup lacks what the tracker needs."""
        ...

    def step(self, rng: np.random.Generator, state: State, scan: Scan) -> tuple[State, Estimate]:
        """Advance by one scan; neither state nor scan is changed."""
        ...


@dataclass(frozen=True, eq=False)
class Series:
    """One column of a metric.

    Attributes:
        values: (k,) one per valid evaluation time for the pool "frame-rms"; of any length else (one a frame, one a matched
            target). NaN only where `weights` is 0.
        weights: as many, 0 where the value does not count.
        unit: "m", "1", …
        better: which way is good.
        pool: how values become a number over frames and runs. "mean": weighted mean; "rms": root of the weighted mean
            of squares; "median"; "rate": the sum of values over the sum of weights; "frame-rms": rms over runs at each
            frame, then the mean over frames.
        worst: the value that stands in where the output is empty and the metric undefined, or None.
        coverage: share of target time that the values speak of, in [0, 1]; 1 for a metric that is always defined.
    """

    values: Array
    weights: Array
    unit: str
    better: Literal["lower", "higher"] = "lower"
    pool: Literal["mean", "rms", "median", "rate", "frame-rms"] = "mean"
    worst: float | None = None
    coverage: float = 1.0


@runtime_checkable
class Metric(Protocol):
    """Truth against estimates (or scans) → columns. Optional class attribute `reads`: "estimates" (default) or "scans"."""

    def evaluate(self, truth: Truth, output: Sequence[Any], space: Any) -> Mapping[str, Series]:
        """Columns by name: "" is the metric itself, "missed" becomes `gospa.missed`.

        `output` is the list of Estimates in the Space `space`, or of Scans of the Setup `space`; an empty list is a failed
        trial, whose space may be None.
        """
        ...


@runtime_checkable
class Sound(Protocol):
    """What a source emits."""

    def render(self, rng: np.random.Generator, duration_s: float, rate_hz: float) -> SoundSignal:
        """A mono signal of that length and rate."""
        ...


class SoundSignal(NamedTuple):
    """samples (n,) float64; band_hz (low, high) where it carries energy; licence and source for the provenance."""

    samples: Array
    band_hz: tuple[float, float]
    provenance: Mapping[str, str]


@runtime_checkable
class Trajectory(Protocol):
    """Where a source is."""

    def position(self, time_s: Array) -> Array:
        """(k, 3) m in the room at times (k,) since the source's start; holds still after its end."""
        ...


@runtime_checkable
class Simulator(Protocol):
    """Scene + seed → what a recording holds."""

    def simulate(self, scene: Any, seed: int) -> Rendering:
        """Render; a pure function of its arguments."""
        ...


class Rendering(NamedTuple):
    """A recording in memory: header, blocks and scans in time order, truth, clean source signals, provenance."""

    header: Header
    blocks: Sequence[Block]
    scans: Sequence[Scan]
    truth: Truth
    sources: Mapping[str, tuple[float, NDArray[np.float32]]]  # label → (rate_hz, samples (n,))
    provenance: Mapping[str, Any]


class PipelineLike(Protocol):
    """A named entry of a board."""

    front_end: FrontEnd
    tracker: Tracker | None
    given: tuple[str, ...]


#: role name (as plugins and tables say it) → protocol
ROLES: Mapping[str, type] = {
    "front_end": FrontEnd,
    "preprocessor": Preprocessor,
    "delay": Delay,
    "direction": Direction,
    "spectrum": Spectrum,
    "activity": Activity,
    "motion": Motion,
    "measurement": Measurement,
    "likelihood": Likelihood,
    "transform": Transform,
    "birth": Birth,
    "spawn": Spawn,
    "tracker": Tracker,
    "metric": Metric,
    "sound": Sound,
    "trajectory": Trajectory,
    "simulator": Simulator,
    "pipeline": PipelineLike,
}

__all__ = [
    "ROLES",
    "Activity",
    "Birth",
    "BoundLikelihood",
    "BoundMeasurement",
    "Delay",
    "Direction",
    "Directions",
    "Focused",
    "FrontEnd",
    "Likelihood",
    "Measurement",
    "Metric",
    "Mixture",
    "Motion",
    "PipelineLike",
    "Preprocessor",
    "Rendering",
    "Series",
    "Simulator",
    "Sound",
    "SoundSignal",
    "Spawn",
    "Spectrum",
    "State",
    "Tracker",
    "Trajectory",
    "Transform",
]
