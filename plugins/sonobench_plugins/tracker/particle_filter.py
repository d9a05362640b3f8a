"""A particle filter of one target that is there: bootstrap, or with an unscented Kalman filter in every particle as its proposal.

`proposal = "prior"`: particles move as the motion model draws them, and are weighed by the likelihood. `proposal = "unscented"`: the rows
that the likelihood trusts (`focused`) update the Gaussian that a particle is predicted as, by sigma points; the particle is drawn from the
result and weighed by likelihood × p(x | previous) / q(x). That Gaussian is the motion's noise about a particle that is where it is, which
makes q the best proposal there is where the measurement is linear; `covariance = "carried"` hands each particle's posterior covariance on,
as van der Merwe et al. and the paper do, though it counts what the spread of the particles says already: where it is much wider than the
motion's noise nearly all weights vanish. A share `prior_share` of the particles is drawn from the motion all the same, q being the mixture
of both, so that no weight exceeds likelihood / share where the rows were false (a defensive mixture).

The update is robust: with v the innovation, S its covariance and µ = min(1, √(tr S / vᵀv)), a residual that is larger than expected raises
the predicted covariance by 1 / µ, so that the gain grows and the target is caught up with (`robust = "raise"`). `"printed"` multiplies it by
µ instead, as eq. 36 to 38 have it, which lowers the gain although the text wants it raised; `"none"` is the plain filter.
Source: Gordon, Salmond & Smith 1993 (bootstrap); van der Merwe et al. 2000, "The unscented particle filter"; Yang, He & Xu 2001 (adaptive
factors); Hesterberg 1995, "Weighted average importance sampling and defensive mixture distributions"; "Multi-feature adaptive unscented
particle filter" (in Chinese; Chinese Journal of Scientific Instrument 43, 2022), eq. 15 to 20 and 32 to 44.
Deviations: R in eq. 40 and S in eq. 36 where they are missing; the posterior covariance is that of the gain in use. Particles beyond the
room are set back to its walls, and have no weight unless all are. Weights that all vanish are forgotten (info `lost`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal, cast

import numpy as np

from sonobench.errors import SetupError
from sonobench.filtering.gaussian import definite, gain, log_gaussian, root, symmetric
from sonobench.filtering.kinematics import position_columns
from sonobench.filtering.particles import gathered
from sonobench.filtering.resampling import RESAMPLERS, Resampling
from sonobench.filtering.steps import adapts, elapsed, initial, pose_of
from sonobench.protocols import Birth, BoundLikelihood, BoundMeasurement, Focused, Likelihood, Motion, State, Transform
from sonobench.types import Array, Estimate, Floats, Ints, Scan, Setup, Space
from sonobench_plugins.birth.given import Given
from sonobench_plugins.likelihood.multi_feature import MultiFeature
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.transform.unscented import Unscented


@dataclass(frozen=True, slots=True, eq=False)
class ParticleState:
    """Even particles x (N, d), mode (N,), covariances P (N, d, d) where they are carried; memory of an adaptive motion."""

    time_s: float
    heard_s: float
    x: Array
    P: Array | None
    mode: Ints
    memory: State
    likelihood: BoundLikelihood
    setup: Setup


@dataclass(frozen=True)
class ParticleFilter:
    """Particles of one target whose start is known."""

    motion: Motion = field(default_factory=ConstantVelocity)  #: how the target moves
    likelihood: Likelihood = field(default_factory=MultiFeature)  #: what scans say of it
    birth: Birth = field(default_factory=lambda: Given("starts", 1.0, 0.25, 0.5, once=1))  #: where it starts: its components at the start
    particles: int = 300  #: number of particles
    proposal: Literal["prior", "unscented"] = "prior"  #: where particles are drawn from
    robust: Literal["raise", "printed", "none"] = "raise"  #: what a large residual does to the gain, when unscented
    covariance: Literal["motion", "carried"] = "motion"  #: of a particle's prediction, when unscented
    prior_share: float = 0.1  #: share of particles that are drawn from the motion all the same, when unscented
    transform: Transform = field(default_factory=Unscented)  #: sigma points, when unscented
    resampling: Resampling = "residual"  #: systematic, stratified or residual

    def __post_init__(self) -> None:
        if self.proposal not in ("prior", "unscented") or self.robust not in ("raise", "printed", "none"):
            raise ValueError(
                f"proposal is {self.proposal!r} and robust {self.robust!r}; 'prior' or 'unscented', and 'raise', 'printed' or 'none' are needed"
            )
        if self.covariance not in ("motion", "carried"):
            raise ValueError(f"covariance is {self.covariance!r}; 'motion' or 'carried' is needed")
        if not 0 <= self.prior_share < 1:
            raise ValueError(f"prior_share is {self.prior_share}; 0 up to 1 is needed")
        if self.particles < 1 or self.resampling not in RESAMPLERS:
            raise ValueError(
                f"particles is {self.particles} and resampling {self.resampling!r}; at least 1, and one of {sorted(RESAMPLERS)} are needed"
            )

    @property
    def space(self) -> Space:
        """The motion model's."""
        return self.motion.space

    def init(self, rng: np.random.Generator, setup: Setup) -> ParticleState:
        """Particles where the birth knows of a target at the setup's start.

        Raises:
            SetupError: a model does not fit the setup or this filter, or nothing is known of the start.
        """
        model = self.likelihood.bind(self.space, setup)
        position_columns(self.space, "particle-filter")
        if self.proposal == "unscented" and self.motion.n_modes != 1:
            raise SetupError(
                f"particle-filter with proposal = 'unscented' draws in one motion mode; {type(self.motion).__name__} has {self.motion.n_modes}: "
                "use proposal = 'prior'"
            )
        memory = self.birth.start(self.space, setup, None)  # type: ignore[arg-type]  # a start that is known is not measured
        known = initial(self.birth, memory, len(self.space))
        if not len(known.w):
            raise SetupError(
                f"particle-filter begins where its birth says that a target exists; {type(self.birth).__name__} knows of none: "
                'use { use = "given", name = "starts", once = 1 } and give the pipeline given = ["starts"]'
            )
        if self.proposal == "unscented":
            self._refuse_degenerate(known.m[:1], setup.period_s or 0.1)
        of = RESAMPLERS["systematic"](rng, known.w, self.particles)
        x = known.m[of] + np.einsum("nij,nj->ni", root(known.P)[of], rng.standard_normal((self.particles, len(self.space))))
        P = known.P[of] if self.proposal == "unscented" and self.covariance == "carried" else None
        return ParticleState(setup.start_s, setup.start_s, x, P, known.mode[of], None, model, setup)

    def _refuse_degenerate(self, x: Array, dt_s: float) -> None:
        moved, _ = self.motion.moments(x, np.zeros((1, *2 * x.shape[1:])), np.zeros(1, np.int64), dt_s)
        if not np.isfinite(self.motion.log_density(moved + 1e-3, x, np.zeros(1, np.int64), dt_s)).all():
            raise SetupError(
                f"particle-filter with proposal = 'unscented' divides by the density of the motion; that of {type(self.motion).__name__} is zero "
                "but on a line: use one whose noise moves every coordinate, such as constant-velocity"
            )

    def step(self, rng: np.random.Generator, state: ParticleState, scan: Scan) -> tuple[ParticleState, Estimate]:
        """Propose, weigh, report, resample; a scan that says nothing only moves particles."""
        dt_s = elapsed(state.time_s, scan)
        prior, spread = self.motion.moments(state.x, self._covariances(state), state.mode, dt_s, state.memory)
        focus = self._focused(prior, state.likelihood, scan)
        moved, log_w = self._proposed(rng, state, scan, focus, (prior, symmetric(spread)))
        x = moved.x
        if focus is not None:
            log_w = log_w + focus.log_ratio(x)
        x, log_w = self._within(x, log_w, state.setup)
        lost = not np.isfinite(log_w.max())
        w = np.full(len(x), 1.0 / len(x)) if lost else np.exp(log_w - log_w.max())
        w = w / w.sum()
        mean, cov = gathered(x, w)
        memory, heard_s = state.memory, state.heard_s
        if focus is not None and not lost:
            heard_s = scan.time_s
            if adapts(self.motion):
                memory = cast(Any, self.motion).adapt(memory, prior.mean(axis=0), mean, heard_s - state.heard_s)
        info = {"effective": 1.0 / float(w @ w), "rows": float(len(focus.rows)) if focus else 0.0, "lost": float(lost)}
        estimate = Estimate(scan.time_s, mean[None], symmetric(cov)[None], np.zeros(1, np.int64), np.ones(1), 1.0, info)
        of = RESAMPLERS[self.resampling](rng, w, self.particles)
        P = None if moved.P is None else moved.P[of]
        after = replace(state, time_s=scan.time_s, heard_s=heard_s, x=x[of], P=P, mode=moved.mode[of], memory=memory)
        return after, estimate

    def _proposed(
        self, rng: np.random.Generator, state: ParticleState, scan: Scan, focus: Focused | None, predicted: tuple[Array, Array]
    ) -> tuple[ParticleState, Array]:
        """Particles of this scan, and log p(x | previous) / q(x) (N,)."""
        dt_s, (prior, spread) = elapsed(state.time_s, scan), predicted
        if self.proposal == "prior" or focus is None or not focus.rows or dt_s == 0:
            x, mode = self.motion.sample(rng, state.x, state.mode, dt_s, state.memory)
            return replace(state, x=x, mode=mode, P=None if state.P is None else spread), np.zeros(len(x))
        m, P = self._conditioned(prior, spread, focus, state, scan)
        factor = root(definite(P))
        x = m + np.einsum("nij,nj->ni", factor, rng.standard_normal(m.shape))
        if self.prior_share > 0:
            drawn, _ = self.motion.sample(rng, state.x, state.mode, dt_s, state.memory)
            x = np.where(rng.random((len(x), 1)) < self.prior_share, drawn, x)
        log_p = self.motion.log_density(x, state.x, state.mode, dt_s, state.memory)
        with np.errstate(divide="ignore"):
            log_q = np.log1p(-self.prior_share) + log_gaussian(x - m, factor @ np.swapaxes(factor, -1, -2))
            log_q = np.logaddexp(log_q, np.log(self.prior_share) + log_p)
        return replace(state, x=x, P=None if state.P is None else P), log_p - log_q

    def _covariances(self, state: ParticleState) -> Array:
        d = len(self.space)
        return np.zeros((len(state.x), d, d)) if state.P is None else state.P

    def _focused(self, prior: Array, likelihood: BoundLikelihood, scan: Scan) -> Focused | None:
        if hasattr(likelihood, "focused"):
            focus: Focused | None = likelihood.focused(prior, np.full(len(prior), 1.0 / len(prior)), scan)
            return focus
        if likelihood.log_ratio(prior[:1], scan) is None:
            return None
        return Focused(lambda at: np.asarray(likelihood.log_ratio(at, scan)))

    def _conditioned(self, m: Array, P: Array, focus: Focused, state: ParticleState, scan: Scan) -> tuple[Array, Array]:
        """Every particle's Gaussian (N, d), (N, d, d) given the trusted rows, stacked (eq. 32 to 44)."""
        from scipy.linalg import block_diag

        model = focus.measurement
        if model is None:
            return m, P
        stack = _Stack(model, tuple((q, pose_of(state.setup, scan, q)) for q, _, _ in focus.rows))
        z_hat, spread, cross = self.transform.measure(m, P, stack, 0)  # type: ignore[arg-type]  # all that a transform asks of one
        v = stack.residual(np.concatenate([z for _, z, _ in focus.rows]), z_hat, 0)
        R = block_diag(*(R for _, _, R in focus.rows))
        mu = np.minimum(np.sqrt(np.trace(spread + R, axis1=-2, axis2=-1) / np.maximum(np.sum(v * v, axis=-1), 1e-300)), 1.0)
        scale = {"raise": 1.0 / mu, "printed": mu, "none": np.ones_like(mu)}[self.robust][:, None, None]
        S, cross, P = scale * spread + R, scale * cross, scale * P
        K = gain(cross, S)
        return m + np.einsum("nij,nj->ni", K, v), symmetric(P - K @ S @ np.swapaxes(K, -1, -2))

    def _within(self, x: Array, log_w: Array, setup: Setup) -> tuple[Array, Array]:
        """Particles beyond the room set back to its walls, without weight unless all of them are."""
        if setup.box_m is None:
            return x, log_w
        columns = position_columns(self.space, "particle-filter")
        low, high = setup.box_m[:, : len(columns)]
        inside = ((x[:, columns] >= low) & (x[:, columns] <= high)).all(axis=1)
        if inside.all():
            return x, log_w
        back = x.copy()
        back[:, columns] = np.clip(x[:, columns], low, high)
        return back, np.where(inside, log_w, -np.inf) if inside.any() else log_w


@dataclass(frozen=True, eq=False)
class _Stack:
    """Several sensors' measurements as one, for transforms; each row is (sensor, its pose)."""

    model: BoundMeasurement
    rows: tuple[tuple[int, Array | None], ...]

    def h(self, x: Floats, q: int, pose: Array | None = None) -> Floats:
        return np.concatenate([self.model.h(x, s, at) for s, at in self.rows], axis=-1)

    def jacobian(self, x: Floats, q: int, pose: Array | None = None) -> Floats:
        return np.concatenate([self.model.jacobian(x, s, at) for s, at in self.rows], axis=-2)

    def residual(self, z: Floats, z_hat: Floats, q: int) -> Floats:
        out, at = [], 0
        for s, _ in self.rows:
            own = slice(at, at + self.model.R(s).shape[0])
            out.append(self.model.residual(z[..., own], z_hat[..., own], s))
            at = own.stop
        return np.concatenate(out, axis=-1)
