"""How near a tracker of directions comes to the posterior Cramér-Rao bound of a motion of angles, of one model or several.

J_k = (F̄ J_{k−1}⁻¹ F̄ᵀ + Q̄)⁻¹ + Hᵀ I H along the true path, from a start that is known with the deviations stated here. Where the motion has
several modes, F̄ and Q̄ are those of the one model with the same first two moments, each mode weighing what its chain, uniform at the
start, makes it weigh: what the models disagree about counts as process noise. I is what the snapshots of the frame tell of one source
that sounds alone (`direction-bound`).
Source: Zhang et al., "Cum-AMMS-GLMB", section 4.1; Tichavský, Muravchik & Nehorai 1998, eq. 21 and 34; Hernandez, Ristic, Farina, Sathyan &
Kirubarajan 2005 (best-fitting Gaussian); see `sonobench.filtering.bounds`.
Deviations: the paper's formulas are lost in its text. Other sources that sound at the same time are taken as known, so with several the
bound is optimistic. Rates and accelerations of the true state, on which Q̄ depends, are differences of the true angles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from sonobench.directions import origin
from sonobench.errors import InputError, SetupError
from sonobench.filtering.bounds import best_fitting, posterior_covariances
from sonobench.geometry import angles
from sonobench.protocols import Motion, Series
from sonobench.types import Array, Estimate, Space, Truth
from sonobench_plugins.metric.direction_bound import DirectionBound, compared
from sonobench_plugins.motion.bearing_velocity import BearingVelocity

_STEP = 1e-4


@dataclass(frozen=True)
class BearingPosteriorBound:
    """Root mean square of error over posterior bound, frame by frame."""

    frame: DirectionBound = field(default_factory=DirectionBound)  #: what a frame tells, and the error that is compared
    motion: Motion = field(default_factory=BearingVelocity)  #: how directions are taken to move; an imm, for several models
    angle_std_deg: float = 30.0  #: deviation with which each angle is known one step before a target comes
    rate_std_deg_s: float = 1.0  #: and each rate
    acceleration_std_deg_s2: float = 0.05  #: and each acceleration, where the motion has some
    start_s: float = 0.0  #: when the first step begins

    def __post_init__(self) -> None:
        if not (self.angle_std_deg > 0 and self.rate_std_deg_s >= 0 and self.acceleration_std_deg_s2 >= 0):
            raise InputError("bearing-posterior-bound: angle_std_deg must be above 0, the other deviations at least 0")

    def evaluate(self, truth: Truth, output: Sequence[Estimate], space: Space | None) -> Mapping[str, Series]:
        """Columns as of `direction-bound`."""
        return compared(self.frame.error, truth, output, space, self.least(truth))

    def least(self, truth: Truth) -> Array:
        """Least covariances (k, n, 2, 2) of each target's direction, arcs east and north; 0 where it does not exist.

        Raises:
            SetupError: the motion is not one of angles.
        """
        space = self.motion.space
        if space.names[0] != "azimuth_rad" or {n.split("_")[0] for n in space.names} != {"azimuth", "elevation"}:
            raise SetupError(
                f"bearing-posterior-bound follows angles; the motion model has {list(space.names)} (direction-posterior-bound takes positions)"
            )
        information = self.frame.information(truth) * truth.active[..., None, None]
        found = np.zeros((*truth.exists.shape, 2, 2))
        for n in range(truth.exists.shape[1]):
            when = np.flatnonzero(truth.exists[:, n])
            if len(when):
                k = slice(int(when[0]), int(when[-1]) + 1)
                found[k, n] = self._along(truth, k, np.asarray(angles(truth.position[:, n] - origin(truth))), information[k, n])
        return found

    def _along(self, truth: Truth, k: slice, z: Array, information: Array) -> Array:
        """Least covariances (k, 2, 2) along the angles z of all times, in the stretch k."""
        space = self.motion.space
        states = _states(space, truth.time_s, z)
        before = np.diff(truth.time_s)[k.start - 1] if k.start > 0 else truth.time_s[0] - self.start_s
        steps = np.concatenate([[before], np.diff(truth.time_s[k])])
        std = {"rad": self.angle_std_deg, "s": self.rate_std_deg_s, "s2": self.acceleration_std_deg_s2}
        P = np.diag([np.radians(std[name.rsplit("_", 1)[1]]) ** 2 for name in space.names])
        modes = np.full(self.motion.n_modes, 1.0 / self.motion.n_modes)
        found = np.empty((len(steps), 2, 2))
        for i, dt_s in enumerate(steps):
            at = states[max(k.start + i - 1, 0)]
            F, Q, turn = self._moves(at, float(dt_s))
            modes = modes @ turn
            mean, noise = best_fitting(F, Q, modes, at, P)
            H = np.zeros((1, 2, len(space)))
            columns = space.index("azimuth_rad", "elevation_rad")
            H[0, 0, columns[0]], H[0, 1, columns[1]] = np.cos(z[k.start + i, 1]), 1.0
            P = posterior_covariances(P, mean[None], noise[None], H, information[i : i + 1])[0]
            found[i] = H[0] @ P @ H[0].T
        return found

    def _moves(self, x: Array, dt_s: float) -> tuple[Array, Array, Array]:
        """F and Q (modes, d, d), linearised at x, and the modes' transition (modes, modes)."""
        d, n = len(x), self.motion.n_modes
        step = _STEP * np.eye(d)
        points = np.concatenate([x + step, x - step, x[None]])
        none, zero = np.zeros((len(points), d, d)), np.zeros(len(points), np.int64)
        if n == 1:
            m, C = (np.asarray(a)[:, None] for a in self.motion.moments(points, none, zero, dt_s))
            turn = np.ones((1, 1))
        else:
            branches = cast(Any, self.motion).branches
            _, m, C = branches(points, none, zero, dt_s)
            turn = np.asarray(branches(np.tile(x, (n, 1)), none[:n], np.arange(n), dt_s)[0])
        F = np.moveaxis(self.motion.space.residual(m[:d], m[d : 2 * d]) / (2 * _STEP), 0, -1)
        return np.asarray(F), np.asarray(C[-1]), turn


def _states(space: Space, time_s: Array, z: Array) -> Array:
    """True states (k, d) of angles (k, 2): rates and accelerations by differences; 0 where there is but one time."""
    columns: dict[str, Array] = {}
    for axis, angle in zip(("azimuth", "elevation"), (np.unwrap(z[:, 0]), z[:, 1]), strict=True):
        rate = np.gradient(angle, time_s) if len(time_s) > 1 else np.zeros(1)
        columns |= {f"{axis}_rad": angle, f"{axis}_rad_s": rate}
        columns[f"{axis}_rad_s2"] = np.gradient(rate, time_s) if len(time_s) > 1 else np.zeros(1)
    return np.stack([columns[name] for name in space.names], axis=-1)
