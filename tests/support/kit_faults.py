"""One deliberately broken component for every check of the conformance kit, and nothing else wrong with it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import kit_good as good
import numpy as np

from sonobench.errors import SetupError
from sonobench.pipeline import Pipeline
from sonobench.protocols import Mixture, Series
from sonobench.testing import fixtures
from sonobench.types import Block, Detections, Estimate, Scan, Space

#: check → (role, component, words of the sentence)
FAULTS: dict[str, tuple[str, Any, str]] = {}


def fault(check: str, words: str, **parameters: Any) -> Any:
    """Enter a broken component under the check that must find it."""

    def enter(cls: type) -> type:
        frozen = dataclass(frozen=True)(cls)
        role = next(r for r in _ROLES if cls.__mro__[1] is _ROLES[r])
        FAULTS[check] = (role, frozen(**parameters), words)
        return frozen

    return enter


_ROLES = {
    "tracker": good.GoodTracker,
    "front_end": good.GoodFrontEnd,
    "preprocessor": good.GoodPreprocessor,
    "delay": good.GoodDelay,
    "direction": good.GoodDirection,
    "spectrum": good.GoodSpectrum,
    "activity": good.GoodActivity,
    "sound": good.GoodSound,
    "motion": good.GoodMotion,
    "measurement": good.GoodMeasurement,
    "likelihood": good.GoodLikelihood,
    "transform": good.GoodTransform,
    "birth": good.GoodBirth,
    "spawn": good.GoodSpawn,
    "metric": good.GoodMetric,
    "trajectory": good.GoodTrajectory,
    "simulator": good.GoodSimulator,
}
_calls = itertools.count(1)
_unseeded = np.random.default_rng()


# any role


def _local() -> type:
    @fault("pickled", "cannot be pickled")
    class Local(good.GoodDelay):
        pass

    return Local


_local()


@fault("printed", "memory address")
class Unprinted(good.GoodDelay):
    def __repr__(self) -> str:
        return object.__repr__(self)


@fault("table", "floor = 1e-09, and 2e-09")
class Doubling(good.GoodDelay):
    floor: float = 5e-10

    def __post_init__(self) -> None:
        object.__setattr__(self, "floor", 2 * self.floor)


# trackers


@fault("tracker.runs", "KeyError")
class Crashing(good.GoodTracker):
    def fix(self, state: Any, rows: Any) -> Any:
        raise KeyError("pair-9")


@fault("tracker.estimates", "the estimate of the scan at 0.1 s says 1.1 s")
class Late(good.GoodTracker):
    def report(self, state: Any, scan: Scan) -> Estimate:
        return Estimate(scan.time_s + 1, state.position[None], count=state.weight)


@fault("tracker.finite", "covs at 0.1 s hold NaN")
class NotANumber(good.GoodTracker):
    def report(self, state: Any, scan: Scan) -> Estimate:
        return Estimate(scan.time_s, state.position[None], covs=np.full((1, 2, 2), np.nan), count=state.weight)


@fault("tracker.seed", "two runs from one seed differ")
class Unseeded(good.GoodTracker):
    def fix(self, state: Any, rows: Any) -> Any:
        return super().fix(state, rows) + 0.01 * _unseeded.standard_normal(2)


@fault("tracker.mutation", "do not write into the old one")
class Overwriting(good.GoodTracker):
    def fix(self, state: Any, rows: Any) -> Any:
        state.position[:] += 0.1
        return super().fix(state, rows)


@fault("tracker.state", "its state cannot be pickled")
class Closing(good.GoodTracker):
    def init(self, rng: Any, setup: Any) -> Any:
        return super().init(rng, setup)._replace(more=lambda x: x)


@fault("tracker.nothing", "a set of 0 rows and no set give different estimates")
class CountingSets(good.GoodTracker):
    def believe(self, state: Any, scan: Scan, seen: bool) -> float:
        return super().believe(state, scan, seen or len(scan.detections) > 0)


@fault("tracker.searched", "apply a miss only to sensors whose `searched` is True")
class AlwaysMissing(good.GoodTracker):
    def believe(self, state: Any, scan: Scan, seen: bool) -> float:
        return 1.0 if seen else 0.3 * state.weight


@fault("tracker.many", "IndexError")
class FewRows(good.GoodTracker):
    def rows(self, scan: Scan, q: int) -> Any:
        z = super().rows(scan, q)
        table = np.zeros((30, *z.shape[1:]))
        for k, row in enumerate(z):
            table[k] = row
        return table[: len(z)]


@fault("tracker.irregular", "TypeError")
class Periodic(good.GoodTracker):
    def dt(self, state: Any, scan: Scan) -> float:
        return 1.0 * state.setup.period_s


@fault("tracker.dt", "predict over scan.time_s minus the state's time")
class CountingScans(good.GoodTracker):
    def dt(self, state: Any, scan: Scan) -> float:
        return 0.1


@fault("tracker.rows", "the same rows in another order")
class FirstRow(good.GoodTracker):
    def rows(self, scan: Scan, q: int) -> Any:
        return super().rows(scan, q)[:1]


@fault("tracker.planar", "LinAlgError")
class Volume(good.GoodTracker):
    def init(self, rng: Any, setup: Any) -> Any:
        state = super().init(rng, setup)
        mics = np.concatenate([setup.sensors[q].elements for q in state.sensors])
        spread = mics - mics[0]
        return state._replace(more=np.linalg.inv(spread.T @ spread))


@fault("tracker.foreign", "init meets foreign sensors with StopIteration")
class Assuming(good.GoodTracker):
    def init(self, rng: Any, setup: Any) -> Any:
        first = next(q for q, s in enumerate(setup.sensors) if s.kind == "tdoa")
        return good.Belief(setup.start_s, np.array([2.0, 1.5]), 0.1, setup, range(first, len(setup.sensors)))


# front ends


@fault("front_end.runs", "no scan of 1.2 s of sound")
class Mute(good.GoodFrontEnd):
    def scan(self, header: Any, frame: Any, first: int) -> list[Scan]:
        return []


@fault("front_end.scans", "searched has 5 entries, the setup 4 sensors")
class OneMore(good.GoodFrontEnd):
    def scan(self, header: Any, frame: Any, first: int) -> list[Scan]:
        return [Scan(s.time_s, np.append(s.searched, True), s.detections) for s in super().scan(header, frame, first)]


@fault("front_end.repeats", "two runs over one recording differ")
class Remembering(good.GoodFrontEnd):
    def scan(self, header: Any, frame: Any, first: int) -> list[Scan]:
        return [
            Scan(s.time_s, s.searched, tuple(Detections(g.z + 1e-9 * next(_calls), g.sensor) for g in s.detections))
            for s in super().scan(header, frame, first)
        ]


@fault("front_end.blocks", "blocks of (37, 1601, 4096) samples and of 1600 give different scans")
class BlockByBlock(good.GoodFrontEnd):
    def step(self, state: Any, block: Block) -> Any:
        self.guard(block)
        return state, self.scan(state.header, np.resize(block.samples, (1600, 8)), block.first_sample)


@fault("front_end.mutation", "stepping twice from one state gives different scans")
class Collecting(good.GoodFrontEnd):
    def open(self, header: Any) -> Any:
        setup, state = super().open(header)
        return setup, state._replace(more=[])

    def step(self, state: Any, block: Block) -> Any:
        following, scans = super().step(state, block)
        late = []
        for scan in scans:
            state.more.append(scan)
            late.append(Scan(scan.time_s + 1e-3 * len(state.more), scan.searched, scan.detections))
        return following, late


@fault("front_end.state", "its state cannot be pickled")
class ClosingFrontEnd(good.GoodFrontEnd):
    def open(self, header: Any) -> Any:
        setup, state = super().open(header)
        return setup, state._replace(more=lambda x: x)


@fault("front_end.silence", "4 detections in digital silence", floor_rms=0.0)
class Hearing(good.GoodFrontEnd):
    pass


@fault("front_end.every_frame", "give a scan with `searched` False where nothing sounds")
class Dropping(good.GoodFrontEnd):
    def quiet(self, time_s: float, sensors: int) -> list[Scan]:
        return []


@fault("front_end.nan", "took NaN samples without a word")
class Unguarded(good.GoodFrontEnd):
    def guard(self, block: Block) -> None:
        pass


@fault("front_end.foreign", "open meets a recording without what it reads with IndexError")
class Hasty(good.GoodFrontEnd):
    def open(self, header: Any) -> Any:
        header.arrays[0]
        return super().open(header)


# preprocessors


@fault("preprocessor.runs", "8000 samples of 4 channels give (7999, 4)")
class PreprocessorThatForgetsTheLast(good.GoodPreprocessor):
    def finish(self, state: Any) -> Any:
        return state[:0]


@fault("preprocessor.finite", "give NaN or infinity")
class PreprocessorThatOverflows(good.GoodPreprocessor):
    def process(self, state: Any, samples: Any) -> Any:
        following, out = super().process(state, samples)
        return following, np.where(np.abs(out) < 1e3, out, np.inf)


@fault("preprocessor.repeats", "two runs over the same samples differ")
class PreprocessorThatCounts(good.GoodPreprocessor):
    def process(self, state: Any, samples: Any) -> Any:
        following, out = super().process(state, samples)
        return following, out * (1 + 1e-9 * next(_calls))


@fault("preprocessor.blocks", "the samples differ from sample")
class PreprocessorOfBlocks(good.GoodPreprocessor):
    def process(self, state: Any, samples: Any) -> Any:
        return super().process(state, samples / (1.0 + np.abs(samples).max()))


@fault("preprocessor.mutation", "build a new state")
class PreprocessorThatCollects(good.GoodPreprocessor):
    def start(self, rate_hz: float, channels: int) -> Any:
        return [np.zeros((0, channels)), 0]

    def process(self, state: Any, samples: Any) -> Any:
        state[1] += len(samples)
        following, out = super().process(state[0], samples)
        return [following, state[1]], out * (0.5 if state[1] > 8000 else 1.0)

    def finish(self, state: Any) -> Any:
        return state[0]


@fault("preprocessor.state", "its state cannot be pickled")
class PreprocessorThatCloses(good.GoodPreprocessor):
    def start(self, rate_hz: float, channels: int) -> Any:
        return super().start(rate_hz, channels), lambda x: x

    def process(self, state: Any, samples: Any) -> Any:
        following, out = super().process(state[0], samples)
        return (following, state[1]), out

    def finish(self, state: Any) -> Any:
        return state[0]


@fault("preprocessor.silence", "zeros give sound")
class PreprocessorThatDithers(good.GoodPreprocessor):
    def process(self, state: Any, samples: Any) -> Any:
        following, out = super().process(state, samples)
        return following, out + 1e-12


@fault("preprocessor.channels", "give all channels one gain")
class PreprocessorThatClips(good.GoodPreprocessor):
    def process(self, state: Any, samples: Any) -> Any:
        return super().process(state, np.clip(samples, -0.15, 0.15))


@fault("preprocessor.delays", "5 samples between two channels become 6")
class PreprocessorThatShifts(good.GoodPreprocessor):
    """One sample late where a channel begins below zero."""

    def start(self, rate_hz: float, channels: int) -> Any:
        return np.zeros((1, channels)), None

    def process(self, state: Any, samples: Any) -> Any:
        late = samples[0] < 0 if state[1] is None else state[1]
        before = np.concatenate([state[0], samples[:-1]])
        return (samples[-1:].copy(), late), np.where(late, before, samples)

    def finish(self, state: Any) -> Any:
        return state[0][:0]


# delays


@fault("delay.runs", "have shape (3, 512)")
class OnePair(good.GoodDelay):
    def correlate(self, spectra: Any, pairs: Any) -> Any:
        return super().correlate(spectra, pairs)[..., 0, :]


@fault("delay.lags", "1024 lags from 257 bins")
class Padded(good.GoodDelay):
    def correlate(self, spectra: Any, pairs: Any) -> Any:
        found = super().correlate(spectra, pairs)
        return np.concatenate([found, np.zeros_like(found)], axis=-1)


@fault("delay.repeats", "a function of its arguments only")
class Dithered(good.GoodDelay):
    def correlate(self, spectra: Any, pairs: Any) -> Any:
        found = super().correlate(spectra, pairs)
        return found + 1e-6 * _unseeded.standard_normal(found.shape)


@fault("delay.mutation", "writes into its arguments")
class InPlace(good.GoodDelay):
    def correlate(self, spectra: Any, pairs: Any) -> Any:
        spectra /= np.abs(spectra) + self.floor
        return np.fft.irfft(spectra[..., pairs[:, 0], :] * spectra[..., pairs[:, 1], :].conj())


@fault("delay.batch", "alone and in a batch give different correlations")
class BatchScaled(good.GoodDelay):
    def correlate(self, spectra: Any, pairs: Any) -> Any:
        return super().correlate(spectra, pairs) / np.abs(spectra).mean()


@fault("delay.sign", "where i is 5 samples later than j")
class Backwards(good.GoodDelay):
    def correlate(self, spectra: Any, pairs: Any) -> Any:
        return super().correlate(spectra, pairs[:, ::-1])


@fault("delay.silence", "a frame of zeros gives NaN", floor=0.0)
class Unfloored(good.GoodDelay):
    pass


@fault("delay.weigh", "weigh gives shape (3, 257)")
class OneWeight(good.GoodDelay):
    def weigh(self, cross: Any, power: Any, pairs: Any) -> Any:
        return super().weigh(cross, power, pairs)[..., 0, :]


@fault("delay.weigh_mutation", "writes into its arguments")
class OwnAverages(good.GoodDelay):
    def weigh(self, cross: Any, power: Any, pairs: Any) -> Any:
        cross /= np.abs(cross) + self.floor
        return cross


@fault("delay.weigh_batch", "frame 0 alone and in a batch is weighed differently")
class LoudestOfAll(good.GoodDelay):
    def weigh(self, cross: Any, power: Any, pairs: Any) -> Any:
        return cross * (np.abs(cross) > 0.3 * np.abs(cross).max())


@fault("delay.weigh_level", "make what stands beside |cross| a share of it")
class AbsoluteFloor(good.GoodDelay):
    def weigh(self, cross: Any, power: Any, pairs: Any) -> Any:
        return cross / (np.abs(cross) + 100.0)


@fault("delay.weigh_silence", "with 1 of 3 microphones dead weigh gives NaN")
class Undivided(good.GoodDelay):
    def weigh(self, cross: Any, power: Any, pairs: Any) -> Any:
        return cross / np.sqrt(power[..., pairs[:, 0], :] * power[..., pairs[:, 1], :])


@fault("delay.weighed", "correlate and weigh of the same periodogram give different correlations")
class TwoMinds(good.GoodDelay):
    def weigh(self, cross: Any, power: Any, pairs: Any) -> Any:
        return cross


# activity


@fault("activity.runs", "12 frames give int64 (12,)")
class Counting(good.GoodActivity):
    def active(self, state: Any, frames: Any) -> Any:
        state, active = super().active(state, frames)
        return state, active.astype(np.int64)


@fault("activity.voice", "no frame is active", ratio=1e9)
class Deaf(good.GoodActivity):
    pass


@fault("activity.repeats", "two runs over the same frames differ")
class Guessing(good.GoodActivity):
    def active(self, state: Any, frames: Any) -> Any:
        return state, np.arange(len(frames)) > next(_calls) % 2 + 6


@fault("activity.batch", "carry the memory over in the state")
class BatchLoudest(good.GoodActivity):
    def active(self, state: Any, frames: Any) -> Any:
        level = np.sqrt(np.mean(frames**2, axis=(1, 2)))
        return state, level > 0.1 * level.max()


@fault("activity.mutation", "writes into the frames")
class Centring(good.GoodActivity):
    def active(self, state: Any, frames: Any) -> Any:
        frames -= frames.mean(axis=1, keepdims=True)
        return super().active(state, frames)


# sounds


@fault("sound.runs", "a SoundSignal(samples, band_hz, provenance) is needed")
class Bare(good.GoodSound):
    def render(self, rng: Any, duration_s: float, rate_hz: float) -> Any:
        return rng.standard_normal(round(duration_s * rate_hz))


@fault("sound.length", "give shape (16000,)")
class OneSecond(good.GoodSound):
    def render(self, rng: Any, duration_s: float, rate_hz: float) -> Any:
        return super().render(rng, 1.0, rate_hz)


@fault("sound.finite", "all zero", rms=0.0)
class Still(good.GoodSound):
    pass


@fault("sound.seed", "two renderings from one seed differ")
class OwnSeed(good.GoodSound):
    def render(self, rng: Any, duration_s: float, rate_hz: float) -> Any:
        return super().render(_unseeded, duration_s, rate_hz)


@fault("sound.band", "band_hz is (0.0, 16000.0)")
class TooWide(good.GoodSound):
    def render(self, rng: Any, duration_s: float, rate_hz: float) -> Any:
        return super().render(rng, duration_s, rate_hz)._replace(band_hz=(0.0, rate_hz))


# motion


@fault("motion.runs", "n_modes is 0")
class NoMode(good.GoodMotion):
    n_modes = 0


@fault("motion.mutation", "writes into its arguments")
class MovingInPlace(good.GoodMotion):
    def moments(self, x: Any, P: Any, mode: Any, dt_s: float, memory: Any = None) -> Any:
        x += 0.0
        return super().moments(x, P, mode, dt_s)


@fault("motion.shapes", "5 targets of 4 coordinates give shapes")
class OneDensity(good.GoodMotion):
    def log_density(self, x1: Any, x0: Any, mode: Any, dt_s: float, memory: Any = None) -> Any:
        return np.sum(super().log_density(x1, x0, mode, dt_s))


@fault("motion.seed", "two draws from one seed differ")
class UnseededMotion(good.GoodMotion):
    def sample(self, rng: Any, x: Any, mode: Any, dt_s: float, memory: Any = None) -> Any:
        return super().sample(_unseeded, x, mode, dt_s)


@fault("motion.batch", "depends on the components beside it")
class Herding(good.GoodMotion):
    def moments(self, x: Any, P: Any, mode: Any, dt_s: float, memory: Any = None) -> Any:
        m, P = super().moments(x, P, mode, dt_s)
        return (m + dt_s * (m.mean(axis=0) - m), P) if len(m) else (m, P)


@fault("motion.covariance", "is not symmetric")
class Lopsided(good.GoodMotion):
    def moments(self, x: Any, P: Any, mode: Any, dt_s: float, memory: Any = None) -> Any:
        m, P = super().moments(x, P, mode, dt_s)
        return m, P + 1e-2 * dt_s * np.triu(np.ones((4, 4)), 1)


@fault("motion.still", "particles move over dt_s = 0")
class Restless(good.GoodMotion):
    def sample(self, rng: Any, x: Any, mode: Any, dt_s: float, memory: Any = None) -> Any:
        return super().sample(rng, x, mode, max(dt_s, 1e-3))


@fault("motion.samples", "the particles' covariance differs")
class Nervous(good.GoodMotion):
    def sample(self, rng: Any, x: Any, mode: Any, dt_s: float, memory: Any = None) -> Any:
        return x @ self.F(dt_s).T + 1.5 * np.sqrt(self.rate * dt_s) * rng.standard_normal(x.shape), mode


@fault("motion.adapts", "after updates the particles' covariance differs")
class Heedless(good.GoodMotion):
    def moments(self, x: Any, P: Any, mode: Any, dt_s: float, memory: Any = None) -> Any:
        m, spread = super().moments(x, P, mode, dt_s)
        return m, spread + (memory or 0.0) * dt_s * np.eye(4)

    def adapt(self, memory: Any, prior: Any, posterior: Any, dt_s: float) -> Any:
        return (memory or 0.0) + float(np.sum((posterior - prior) ** 2)) / dt_s


@fault("motion.branches", "probabilities sum to")
class Doubled(good.GoodMotion):
    n_modes = 2

    def branches(self, x: Any, P: Any, mode: Any, dt_s: float, memory: Any = None) -> Any:
        m, C = self.moments(x, P, mode, dt_s)
        return np.ones((len(x), 2)), np.stack([m, m], axis=1), np.stack([C, C], axis=1)


@fault("motion.density", "exp(log_density) integrates to")
class Unnormalised(good.GoodMotion):
    def log_density(self, x1: Any, x0: Any, mode: Any, dt_s: float, memory: Any = None) -> Any:
        return super().log_density(x1, x0, mode, dt_s) + 1.0


# measurements


class _Bound(fixtures.SensorMeasurement):
    def jacobian(self, x: Any, q: int, pose: Any = None) -> Any:
        step = 1e-6 * np.eye(np.shape(x)[-1])
        true = fixtures.SensorMeasurement(self.space, self.setup)
        return np.stack([(true.h(x + s, q) - true.h(x - s, q)) / 2e-6 for s in step], axis=-1)


class _Senseless(_Bound):
    sensors = ()  # type: ignore[assignment]


class _Rounding(_Bound):
    def h(self, x: Any, q: int, pose: Any = None) -> Any:
        x[...] = np.round(x, 9)
        return super().h(x, q)


class _Flat(_Bound):
    def h(self, x: Any, q: int, pose: Any = None) -> Any:
        return super().h(x, q)[..., 0, :]


class _Upside(_Bound):
    def residual(self, z: Any, z_hat: Any, q: int) -> Any:
        return z_hat - z


class _Steep(_Bound):
    def jacobian(self, x: Any, q: int, pose: Any = None) -> Any:
        return 1.01 * super().jacobian(x, q)


class _Certain(_Bound):
    def p_d(self, x: Any, q: int, scan: Any = None) -> Any:
        return 1.2 + 0 * super().p_d(x, q)


class _Boundless(_Bound):
    def log_clutter(self, z: Any, q: int) -> Any:
        return np.full(np.shape(z)[:-1], -3.0)


@fault("measurement.runs", "bound to sensors ()")
class Senseless(good.GoodMeasurement):
    def bound(self, space: Any, setup: Any) -> Any:
        return _Senseless(space, setup)


@fault("measurement.mutation", "writes into its arguments")
class Rounding(good.GoodMeasurement):
    def bound(self, space: Any, setup: Any) -> Any:
        return _Rounding(space, setup)


@fault("measurement.shapes", "shapes of h, jacobian, p_d, R, log_clutter")
class Flat(good.GoodMeasurement):
    def bound(self, space: Any, setup: Any) -> Any:
        return _Flat(space, setup)


@fault("measurement.residual", "residual is")
class Upside(good.GoodMeasurement):
    def bound(self, space: Any, setup: Any) -> Any:
        return _Upside(space, setup)


@fault("measurement.jacobian", "finite differences give")
class Steep(good.GoodMeasurement):
    def bound(self, space: Any, setup: Any) -> Any:
        return _Steep(space, setup)


@fault("measurement.noise", "p_d is 1.2 to 1.2")
class Certain(good.GoodMeasurement):
    def bound(self, space: Any, setup: Any) -> Any:
        return _Certain(space, setup)


@fault("measurement.clutter", "the clutter intensity integrates to")
class Boundless(good.GoodMeasurement):
    def bound(self, space: Any, setup: Any) -> Any:
        return _Boundless(space, setup)


@fault("measurement.foreign", "bind meets foreign sensors with ValueError: h of sensor nose-0 has shape")
class Trusting(good.GoodMeasurement):
    def bind(self, space: Space, setup: Any) -> Any:
        return self.bound(space, setup)


# likelihoods


class _Summed(good.LikelihoodOfPairs):
    def ratio(self, values: Any) -> Any:
        return super().ratio(values).sum(keepdims=True)


@fault("likelihood.runs", "states give shape (1,)")
class LikelihoodOfAll(good.GoodLikelihood):
    def bound(self, space: Any, setup: Any, sensors: Any) -> Any:
        return _Summed(space, setup, sensors, self.scale)


class _Flattening(good.LikelihoodOfPairs):
    def log_ratio(self, x: Any, scan: Any) -> Any:
        x[:, 1] = 0.0
        return super().log_ratio(x, scan)


@fault("likelihood.mutation", "writes into its arguments")
class LikelihoodThatStops(good.GoodLikelihood):
    def bound(self, space: Any, setup: Any, sensors: Any) -> Any:
        return _Flattening(space, setup, sensors, self.scale)


class _Normalised(good.LikelihoodOfPairs):
    def ratio(self, values: Any) -> Any:
        ratio = super().ratio(values)
        return ratio - 0.5 * ratio.mean() if len(ratio) else ratio


@fault("likelihood.batch", "asked alone and among others")
class LikelihoodOfShares(good.GoodLikelihood):
    def bound(self, space: Any, setup: Any, sensors: Any) -> Any:
        return _Normalised(space, setup, sensors, self.scale)


class _Sure(good.LikelihoodOfPairs):
    def log_ratio(self, x: Any, scan: Any) -> Any:
        found = super().log_ratio(x, scan)
        return np.zeros(len(x)) if found is None else found


@fault("likelihood.silence", "None is needed")
class LikelihoodOfSilence(good.GoodLikelihood):
    def bound(self, space: Any, setup: Any, sensors: Any) -> Any:
        return _Sure(space, setup, sensors, self.scale)


class _Reversed(good.LikelihoodOfPairs):
    def ratio(self, values: Any) -> Any:
        return -super().ratio(values)


@fault("likelihood.peak", "above 0 is needed")
class LikelihoodOfElsewhere(good.GoodLikelihood):
    def bound(self, space: Any, setup: Any, sensors: Any) -> Any:
        return _Reversed(space, setup, sensors, self.scale)


class _Unmeasured(good.LikelihoodOfPairs):
    def focused(self, x: Any, w: Any, scan: Any) -> Any:
        focus = super().focused(x, w, scan)
        return focus and focus._replace(rows=((self.sensors[0], np.zeros(1), np.eye(1)),))


@fault("likelihood.focused", "no measurement to compare them with")
class LikelihoodOfRowsAlone(good.GoodLikelihood):
    def bound(self, space: Any, setup: Any, sensors: Any) -> Any:
        return _Unmeasured(space, setup, sensors, self.scale)


@fault("likelihood.foreign", "without naming those it reads")
class LikelihoodThatFindsNone(good.GoodLikelihood):
    def bind(self, space: Space, setup: Any) -> Any:
        pairs = tuple(q for q, s in enumerate(setup.sensors) if s.name.startswith("pair"))
        if not pairs:
            raise SetupError(f"no pair among {[s.name for s in setup.sensors]}")
        return self.bound(space, setup, pairs)


# transforms


@fault("transform.runs", "measure must return")
class Halved(good.GoodTransform):
    def measure(self, m: Any, P: Any, measurement: Any, q: int, pose: Any = None) -> Any:
        return super().measure(m, P, measurement, q)[:2]


@fault("transform.mutation", "writes into its arguments")
class Symmetrising(good.GoodTransform):
    def measure(self, m: Any, P: Any, measurement: Any, q: int, pose: Any = None) -> Any:
        P += 0.0
        return super().measure(m, P, measurement, q)


@fault("transform.shapes", "shapes are")
class Deep(good.GoodTransform):
    def measure(self, m: Any, P: Any, measurement: Any, q: int, pose: Any = None) -> Any:
        z, S, C = super().measure(m, P, measurement, q)
        return z[..., None, :], S, C


@fault("transform.points", "the weights sum to 2")
class Heavy(good.GoodTransform):
    def points(self, m: Any, P: Any) -> Any:
        return m[..., None, :], np.full(1, 2.0)


@fault("transform.linear", "the covariance of a linear function is off")
class Loose(good.GoodTransform):
    def measure(self, m: Any, P: Any, measurement: Any, q: int, pose: Any = None) -> Any:
        z, S, C = super().measure(m, P, measurement, q)
        return z, 1.1 * S, C


# spawning


@fault("spawn.mixture", "a weight is -0.0")
class NegativeSpawn(good.GoodSpawn):
    def spawned(self, moved: Any) -> Any:
        return super().spawned(moved)._replace(w=-0.1 * moved.w)


@fault("spawn.mutation", "two calls with one mixture")
class UnseededSpawn(good.GoodSpawn):
    def spawned(self, moved: Any) -> Any:
        found = super().spawned(moved)
        return found._replace(m=found.m + _unseeded.standard_normal(found.m.shape))


# births


@fault("birth.runs", "uses_scan is 'no'")
class Wordy(good.GoodBirth):
    uses_scan = "no"  # type: ignore[assignment]


@fault("birth.mixture", "a weight is -0.1")
class Negative(good.GoodBirth):
    def mixture(self, m: Any, scan: Scan) -> Any:
        return super().mixture(m, scan)._replace(w=np.array([-0.1]))


@fault("birth.seed", "two runs from one seed propose differently")
class UnseededBirth(good.GoodBirth):
    def propose(self, rng: Any, memory: Any, scan: Scan, live: Mixture) -> Any:
        return super().propose(_unseeded, memory, scan, live)


@fault("birth.mutation", "do not write into the old one")
class Tally(good.GoodBirth):
    def start(self, space: Space, setup: Any, measurement: Any) -> Any:
        return [0, space]

    def propose(self, rng: Any, memory: Any, scan: Scan, live: Mixture) -> Any:
        memory[0] += 1
        return memory, super().propose(rng, memory, scan, live)[1]


@fault("birth.uses_scan", "set uses_scan to True")
class Peeking(good.GoodBirth):
    def mixture(self, m: Any, scan: Scan) -> Any:
        return super().mixture(m, scan)._replace(w=np.array([0.1 * len(scan.detections)]))


# metrics


@fault("metric.runs", "a mapping of Series is needed")
class Nameless(good.GoodMetric):
    def evaluate(self, truth: Any, output: Any, space: Any) -> Any:
        return {}


@fault("metric.columns", "coverage is 1.5")
class Overcovered(good.GoodMetric):
    def evaluate(self, truth: Any, output: Any, space: Any) -> Any:
        found = super().evaluate(truth, output, space)[""]
        return {"": Series(found.values, found.weights, "m", coverage=1.5)}


@fault("metric.repeats", "two evaluations of the same differ")
class Moody(good.GoodMetric):
    def one(self, x: Any, y: Any) -> float:
        return super().one(x, y) + 1e-6 * next(_calls)


@fault("metric.rows", "changes with the order of the rows")
class RowByRow(good.GoodMetric):
    def one(self, x: Any, y: Any) -> float:
        if len(x) != len(y) or not len(x):
            return super().one(x, y)
        return float(np.minimum(np.linalg.norm(x - y, axis=1), self.c_m).mean())


@fault("metric.perfect", "for the truth; lower is better")
class Inverted(good.GoodMetric):
    def one(self, x: Any, y: Any) -> float:
        found = super().one(x, y)
        return self.c_m - found if len(x) and len(y) else found


@fault("metric.nobody", "where nobody is there and nobody found; 0 is needed")
class AfraidOfNobody(good.GoodMetric):
    def one(self, x: Any, y: Any) -> float:
        return super().one(x, y) if len(x) or len(y) else self.c_m


@fault("metric.failed", "a failed trial has columns []")
class Forgiving(good.GoodMetric):
    def evaluate(self, truth: Any, output: Any, space: Any) -> Any:
        return super().evaluate(truth, output, space) if output else {}


# trajectories, simulators, pipelines


@fault("trajectory.runs", "It raised ValueError")
class NeedsTimes(good.GoodTrajectory):
    def position(self, time_s: Any) -> Any:
        time_s.max()
        return super().position(time_s)


@fault("trajectory.repeats", "a time asked alone and among others")
class FromFirst(good.GoodTrajectory):
    def position(self, time_s: Any) -> Any:
        return super().position(time_s - time_s[:1].sum())


@fault("trajectory.mutation", "writes into the times")
class ClippingInPlace(good.GoodTrajectory):
    def position(self, time_s: Any) -> Any:
        np.clip(time_s, 0.0, 4.0, out=time_s)
        return super().position(time_s)


@fault("trajectory.continuity", "jumps by 0.7")
class Jumping(good.GoodTrajectory):
    def position(self, time_s: Any) -> Any:
        found = super().position(time_s)
        return found + np.array([0.0, 0.7, 0.0]) * (np.asarray(time_s) > 3.0)[:, None]


@fault("trajectory.end", "still moves after a day")
class Endless(good.GoodTrajectory):
    def position(self, time_s: Any) -> Any:
        return np.multiply.outer(np.asarray(time_s), [0.5, 0.0, 0.0])


@fault("simulator.runs", "It raised ZeroDivisionError")
class Dividing(good.GoodSimulator):
    def rng(self, seed: int) -> Any:
        return 1 / 0


@fault("simulator.order", "begins at sample 900, not 800")
class Gaping(good.GoodSimulator):
    def blocks(self, noise: Any) -> Any:
        return [Block("walls", n, noise[n : n + 800]) for n in (0, 900)]


@fault("simulator.seed", "two renderings from one seed differ in their blocks")
class UnseededSimulator(good.GoodSimulator):
    def rng(self, seed: int) -> Any:
        return _unseeded


# directions and their spectra


@fault("direction.runs", "u of 3 frames has shape (3, 3)")
class Squeezed(good.GoodDirection):
    def directions(self, samples: Any) -> Any:
        found = super().directions(samples)
        return found._replace(u=found.u[:, 0])


@fault("direction.unit", "a frame of zeros has a valid direction")
class Believing(good.GoodDirection):
    def directions(self, samples: Any) -> Any:
        found = super().directions(samples)
        return found._replace(u=np.where(found.valid[..., None], found.u, [1.0, 0.0, 0.0]), valid=np.ones_like(found.valid))


@fault("direction.towards", "° off; velocities are scaled")
class Away(good.GoodDirection):
    def directions(self, samples: Any) -> Any:
        found = super().directions(samples)
        return found._replace(u=-found.u)


@fault("direction.scale", "60 dB fainter has other valid rows")
class Gated(good.GoodDirection):
    def directions(self, samples: Any) -> Any:
        found = super().directions(samples)
        return found._replace(valid=found.valid & (np.mean(samples**2, axis=(1, 2)) > 1e-3)[:, None])


@fault("direction.batch", "frame 0 alone and among others has other directions")
class Mixing(good.GoodDirection):
    def directions(self, samples: Any) -> Any:
        found = super().directions(samples)
        u = found.u + 1e-3 * found.u.mean(axis=0)
        length = np.linalg.norm(u, axis=-1, keepdims=True)
        return found._replace(u=u / np.where(length > 0, length, 1.0))


@fault("direction.mutation", "writes into its arguments")
class Rescaling(good.GoodDirection):
    def directions(self, samples: Any) -> Any:
        samples *= 1.0
        return super().directions(samples)


@fault("spectrum.runs", "1 fields of 3 frames")
class Averaging(good.GoodSpectrum):
    def fields(self, samples: Any) -> Any:
        return super().fields(samples)[:1]


@fault("spectrum.peak", "towards the talker")
class Mirrored(good.GoodSpectrum):
    def fields(self, samples: Any) -> Any:
        return super().fields(samples * np.array([1.0, -1.0, -1.0, -1.0]))


@fault("spectrum.silence", "a frame of zeros gives NaN or infinity")
class Normalised(good.GoodSpectrum):
    def fields(self, samples: Any) -> Any:
        return [good.Beam(x.T @ x / np.sum(x * x)) for x in samples]


@fault("spectrum.batch", "frame 0 alone gives another field")
class Joint(good.GoodSpectrum):
    def fields(self, samples: Any) -> Any:
        scale = np.mean(samples**2)
        return [good.Beam(x.T @ x / scale) for x in samples]


@fault("spectrum.mutation", "writes into its arguments")
class Scaling(good.GoodSpectrum):
    def fields(self, samples: Any) -> Any:
        samples *= 1.0
        return super().fields(samples)


FAULTS["pipeline.runs"] = ("pipeline", Pipeline(good.GoodFrontEnd(), Late()), "says")
GOOD: dict[str, Any] = {role: cls() for role, cls in _ROLES.items()} | {"pipeline": Pipeline(good.GoodFrontEnd(), good.GoodTracker())}
