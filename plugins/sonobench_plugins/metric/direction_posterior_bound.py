"""How near a tracker's error of directions comes to the posterior Cramér-Rao bound of its motion model: their ratio, and the bound.

Information flows along the true path: J_k = (F J_{k−1}⁻¹ Fᵀ + Q)⁻¹ + what the snapshots of the frame tell (`direction-bound`), from a
start that is known with the deviations stated here. With the Q of a tracker it says how well one could do who believes in that Q; with a
Q of 0, how well one could do who knows that the targets move straight on. It bounds what is expected over all motions that Q allows:
on a truth that moves less than that, errors may pass below it, also those of a filter that believes in the same Q.
Source: Tichavský, Muravchik & Nehorai 1998, eq. 21 and 34; see `sonobench.filtering.bounds`.
Deviations: the expectation over paths is taken at the one true path; a nonlinear motion is linearised there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sonobench.directions import origin
from sonobench.errors import InputError, SetupError
from sonobench.filtering.bounds import posterior_covariances
from sonobench.filtering.kinematics import variances
from sonobench.geometry import angles
from sonobench.protocols import Motion, Series
from sonobench.sphere import tangents
from sonobench.types import Array, Estimate, Space, Truth
from sonobench_plugins.metric.direction_bound import DirectionBound, compared
from sonobench_plugins.motion.constant_velocity import ConstantVelocity

_POINT = ("x_m", "y_m", "z_m")
_VELOCITY = ("vx_m_s", "vy_m_s", "vz_m_s")


@dataclass(frozen=True)
class DirectionPosteriorBound:
    """Root mean square of error over posterior bound, frame by frame."""

    frame: DirectionBound = field(default_factory=DirectionBound)  #: what a frame tells, and the error that is compared
    motion: Motion = field(default_factory=lambda: ConstantVelocity(dims=3))  #: how targets are taken to move
    position_std_m: float = 1.0  #: deviation with which each coordinate of the start is known
    velocity_std_m_s: float = 1.0  #: and of its velocity
    start_s: float = 0.0  #: when the start is; a target that comes later is known so one step before it comes

    def __post_init__(self) -> None:
        if not (self.position_std_m > 0 and self.velocity_std_m_s >= 0):
            raise InputError("direction-posterior-bound: position_std_m must be above 0, velocity_std_m_s at least 0")

    def evaluate(self, truth: Truth, output: Sequence[Estimate], space: Space | None) -> Mapping[str, Series]:
        """Columns as of `direction-bound`."""
        return compared(self.frame.error, truth, output, space, self.least(truth))

    def least(self, truth: Truth) -> Array:
        """Least covariances (k, n, 2, 2) of each target's direction; 0 before it comes.

        Raises:
            SetupError: the motion model has no place in space.
        """
        model = self.motion.space
        if not set(_POINT) <= set(model.names):
            raise SetupError(
                f"direction-posterior-bound follows targets in space; the motion model has {list(model.names)}, {list(_POINT)} are needed"
            )
        start = np.diag(variances(model, self.position_std_m, self.velocity_std_m_s, "direction-posterior-bound"))
        information = self.frame.information(truth) * truth.active[..., None, None]
        found = np.zeros((*truth.exists.shape, 2, 2))
        for n in range(truth.exists.shape[1]):
            when = np.flatnonzero(truth.exists[:, n])
            if not len(when):
                continue
            k = slice(when[0], when[-1] + 1)
            H = self._slopes(truth.position[k, n] - origin(truth))
            F, Q = self._moves(truth, k, n)
            P = posterior_covariances(start, F, Q, H, information[k, n])
            found[k, n] = H @ P @ np.swapaxes(H, -1, -2)
        return found

    def _slopes(self, ray: Array) -> Array:
        """Arcs east and north per unit of the state (k, 2, d)."""
        slopes = np.zeros((len(ray), 2, len(self.motion.space)))
        slopes[..., self.motion.space.index(*_POINT)] = tangents(angles(ray)) / np.linalg.norm(ray, axis=-1)[:, None, None]
        return slopes

    def _moves(self, truth: Truth, k: slice, n: int) -> tuple[Array, Array]:
        """F and Q (k, d, d) of the step to each time, linearised at the true state."""
        states = self._states(truth, n)
        before = np.diff(truth.time_s)[k.start - 1] if k.start > 0 else truth.time_s[0] - self.start_s
        dt_s = np.concatenate([[before], np.diff(truth.time_s[k])])
        moves = [self._move(states[max(i - 1, 0)], float(dt)) for i, dt in zip(range(k.start, k.stop), dt_s, strict=True)]
        return np.array([F for F, _ in moves]), np.array([Q for _, Q in moves])

    def _states(self, truth: Truth, n: int) -> Array:
        """True states (k, d); a coordinate that the truth does not know is 0."""
        names = self.motion.space.names
        velocity = np.zeros_like(truth.position) if truth.velocity is None else truth.velocity
        known = dict(zip(_POINT + _VELOCITY, np.concatenate([truth.position[:, n], velocity[:, n]], axis=-1).T, strict=True))
        return np.stack([known.get(name, np.zeros(len(truth.time_s))) for name in names], axis=-1)

    def _move(self, x: Array, dt_s: float) -> tuple[Array, Array]:
        d = len(x)
        step = 1e-4 * np.eye(d)
        points = np.concatenate([x + step, x - step, x[None]])
        moved, spread = self.motion.moments(points, np.zeros((len(points), d, d)), np.zeros(len(points), np.int64), dt_s)
        return (moved[:d] - moved[d : 2 * d]).T / 2e-4, spread[-1]
