"""A Gaussian filter of one target: predict, choose a row, update; its moments pass through motion and measurement as the parts say.

With `transform = "linearised"` it is the extended Kalman filter, with "unscented" the unscented, with "cubature" the cubature filter.
Several process noises may be tried side by side: `process_scales` runs one filter for each multiple of the motion model's Q, and
what is reported is their mixture, each weighed by how probable it found the innovations so far (multiple-model adaptive
estimation). So Q need not be known, and follows a target that begins or ceases to manoeuvre within some 1 / `switching` periods.
Source: Hu, Li & Jin 2014, eq. 15 to 28; Arasaratnam & Haykin 2009; Magill 1965, "Optimal adaptive estimation of sampled stochastic
processes"; Li & Bar-Shalom 1996, "Multiple-model estimation with variable structure" (lower bounds on weights).
Deviations: of several rows the most probable is taken, or the one that scores highest; a scan without a row, or in which no sensor
was searched, only predicts. A target is never given up.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, cast

import numpy as np

from sonobench.filtering.evidence import Rows, noise_of, rows_of, searched
from sonobench.filtering.gaussian import gain, log_gaussian, symmetric
from sonobench.filtering.steps import adapts, bound, elapsed, initial, pose_of
from sonobench.protocols import Birth, BoundMeasurement, Measurement, Mixture, Motion, State, Transform
from sonobench.types import Array, Estimate, Scan, Setup, Space
from sonobench_plugins.birth.from_directions import FromDirections
from sonobench_plugins.measurement.direction import Direction
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.transform.cubature import Cubature


@dataclass(frozen=True, slots=True, eq=False)
class FilterState:
    """Gaussians m (J, d), P (J, d, d) with weights (J,), one for each process noise; None while the target is yet to be found.

    `heard_s` is when a row was last taken, `motion` the memory of a motion that adapts.
    """

    time_s: float
    heard_s: float
    weight: Array
    m: Array | None
    P: Array | None
    memory: State
    motion: State
    measurement: BoundMeasurement
    setup: Setup


@dataclass(frozen=True)
class GaussianFilter:
    """Kalman recursion of one target and one motion mode."""

    motion: Motion = field(default_factory=lambda: ConstantVelocity(dims=3))  #: how the target moves
    measurement: Measurement = field(default_factory=Direction)  #: what sensors measure of it
    transform: Transform = field(default_factory=Cubature)  #: how moments pass through the measurement
    birth: Birth = field(
        default_factory=FromDirections
    )  #: where it starts: the heaviest component that exists at the start, else the heaviest born
    choice: Literal["nearest", "score"] = "nearest"  #: of several rows the most probable one, or that of the highest score
    gate: float | None = None  #: Mahalanobis distance from the heaviest filter's prediction beyond which no row is taken; None: any
    process_scales: tuple[float, ...] = (1.0,)  #: multiples of the motion's Q that are tried side by side; one is the plain filter
    switching: float = 0.01  #: share of the weights that is spread evenly each period (scan, where there is none), with several

    def __post_init__(self) -> None:
        if self.choice not in ("nearest", "score"):
            raise ValueError(f"choice is {self.choice!r}; 'nearest' or 'score' is needed")
        if not self.process_scales or not all(s >= 0 for s in self.process_scales):
            raise ValueError(f"process_scales is {self.process_scales}; one or more of at least 0 are needed")
        if not 0 <= self.switching <= 1:
            raise ValueError(f"switching is {self.switching}; 0 to 1 is needed")
        if self.gate is not None and not self.gate > 0:
            raise ValueError(f"gate is {self.gate}; above 0 is needed")

    @property
    def space(self) -> Space:
        """The motion model's."""
        return self.motion.space

    def init(self, rng: np.random.Generator, setup: Setup) -> FilterState:
        """The target where the birth knows of one at the setup's start.

        Raises:
            SetupError: a model does not fit the setup or this filter.
        """
        model = bound(self.motion, self.measurement, setup, "iterated", "gaussian-filter", adaptive=True)
        memory = self.birth.start(self.space, setup, model)
        m, P = self._begun(initial(self.birth, memory, len(self.space)))
        return FilterState(setup.start_s, setup.start_s, self._even(), m, P, memory, None, model, setup)

    def step(self, rng: np.random.Generator, state: FilterState, scan: Scan) -> tuple[FilterState, Estimate]:
        """Predict and, with every sensor that was searched, update; or look for the target."""
        dt_s, heard = elapsed(state.time_s, scan), searched(scan, state.measurement.sensors)
        memory, motion, heard_s, weight, m, P = state.memory, state.motion, state.heard_s, state.weight, state.m, state.P
        begun = m is None or P is None
        if m is None or P is None:
            heard_s = scan.time_s
            if heard:
                nobody = Mixture(
                    np.zeros(0), np.zeros((0, len(self.space))), np.zeros((0,) + 2 * (len(self.space),)), np.zeros(0, np.int64)
                )
                memory, born = self.birth.propose(rng, memory, scan, nobody)
                m, P = self._begun(born)
        else:
            m, P = self._predict(m, P, dt_s, motion)
            weight = self._forget(weight, dt_s, state.setup.period_s)
        if m is not None and P is not None and not (begun and self.birth.uses_scan):  # the scan that proposed it must not confirm it too
            prior = weight, m, P
            for q in heard:
                weight, m, P = self._update((weight, m, P), state, scan, q)
            if m is not prior[1]:
                heard_s = scan.time_s
                if adapts(self.motion):
                    before, now = self._mean(*prior[:2]), self._mean(weight, m)
                    motion = cast(Any, self.motion).adapt(motion, before, now, heard_s - state.heard_s)
        after = FilterState(scan.time_s, heard_s, weight, m, P, memory, motion, state.measurement, state.setup)
        return after, self._estimate(scan.time_s, weight, m, P)

    def _even(self) -> Array:
        return np.full(len(self.process_scales), 1.0 / len(self.process_scales))

    def _begun(self, known: Mixture) -> tuple[Array | None, Array | None]:
        """One copy of the heaviest component for each process noise."""
        if len(known.w) == 0:
            return None, None
        heaviest = int(np.argmax(known.w))
        m, P, copies = known.m[heaviest], known.P[heaviest], len(self.process_scales)
        return np.tile(m, (copies, 1)), np.tile(P, (copies, 1, 1))

    def _predict(self, m: Array, P: Array, dt_s: float, memory: State) -> tuple[Array, Array]:
        """The motion's moments, with each filter's multiple of the Q that a state known exactly would get."""
        mode, scale = np.zeros(len(m), np.int64), np.array(self.process_scales)
        moved, spread = self.motion.moments(m, P, mode, dt_s, memory)
        if (scale == 1.0).all():
            return moved, spread
        Q = self.motion.moments(m, np.zeros_like(P), mode, dt_s, memory)[1]
        return moved, spread + (scale - 1.0)[:, None, None] * Q

    def _forget(self, weight: Array, dt_s: float, period_s: float | None) -> Array:
        kept = (1.0 - self.switching) ** (1.0 if period_s is None else dt_s / period_s)
        return kept * weight + (1.0 - kept) * self._even()

    def _update(self, prior: tuple[Array, Array, Array], state: FilterState, scan: Scan, q: int) -> tuple[Array, Array, Array]:
        """Each filter and its weight given the chosen row of a sensor, or as they were where none is taken."""
        weight, m, P = prior
        z_hat, spread, cross = self.transform.measure(m, P, state.measurement, q, pose_of(state.setup, scan, q))
        rows = _whole(rows_of(scan, q, z_hat.shape[-1]))
        if not len(rows.z):
            return prior
        noise = noise_of(state.measurement, scan, q, rows, np.arange(len(rows.z)), z_hat)
        residual = state.measurement.residual(rows.z, z_hat[:, None, :], q)
        S = np.broadcast_to(spread[:, None] + noise, (*residual.shape, residual.shape[-1]))
        log_weighted = np.log(np.maximum(weight, np.finfo(float).tiny))[:, None] + log_gaussian(residual, S)
        row = self._chosen(rows, log_weighted)
        lead = int(np.argmax(weight))
        if self.gate is not None and residual[lead, row] @ np.linalg.solve(S[lead, row], residual[lead, row]) > self.gate**2:
            return prior
        K = gain(cross, S[:, row])
        mean = m + (K @ residual[:, row, :, None])[..., 0]
        share = np.exp(log_weighted[:, row] - log_weighted[:, row].max())
        return share / share.sum(), mean, symmetric(P - K @ S[:, row] @ np.swapaxes(K, -1, -2))

    def _chosen(self, rows: Rows, log_weighted: Array) -> int:
        """The row of the highest score, else (and among equal ones) the one that the filters together find most probable."""
        found = np.logaddexp.reduce(log_weighted, axis=0)
        if self.choice == "score" and rows.score is not None:
            found = np.where(rows.score == rows.score.max(), found, -np.inf)
        return int(np.argmax(found))

    def _mean(self, weight: Array, m: Array) -> Array:
        lead = m[int(np.argmax(weight))]  # what is periodic averages by its differences from one of them
        return np.asarray(lead + weight @ self.space.residual(m, lead))

    def _estimate(self, time_s: float, weight: Array, m: Array | None, P: Array | None) -> Estimate:
        """Mean and covariance of the filters' mixture."""
        d = len(self.space)
        if m is None or P is None:
            return Estimate(time_s, np.zeros((0, d)), np.zeros((0, d, d)), np.zeros(0, np.int64), np.zeros(0), 0.0)
        mean = self._mean(weight, m)
        off = self.space.residual(m, mean)
        cov = np.einsum("j,jab->ab", weight, P + off[:, :, None] * off[:, None, :])
        info = {f"weight_{j}": float(w) for j, w in enumerate(weight)} if len(weight) > 1 else {}
        return Estimate(time_s, mean[None], symmetric(cov)[None], np.zeros(1, np.int64), np.ones(1), 1.0, info)


def _whole(rows: Rows) -> Rows:
    """The rows that hold all components."""
    keep = rows.valid.all(axis=1)
    if keep.all():
        return rows
    R, score = (None if a is None else a[keep] for a in (rows.R, rows.score))
    return Rows(rows.z[keep], R, rows.valid[keep], score)
