"""States of positions and velocities, and linear Gaussian motion of independent, identical axes (x, vx, y, vy, …)."""

from __future__ import annotations

import numpy as np

from sonobench.errors import SetupError
from sonobench.filtering.gaussian import log_degenerate, root
from sonobench.types import Array, Space

_AXES = ("x", "y", "z")


def kinematic_space(dims: int) -> Space:
    """x_m vx_m_s y_m vy_m_s [z_m vz_m_s].

    Raises:
        ValueError: dims is not 2 or 3.
    """
    if dims not in (2, 3):
        raise ValueError(f"dims is {dims}; a motion model moves in 2 or 3 dimensions")
    return Space.of(*(name for a in _AXES[:dims] for name in (f"{a}_m", f"v{a}_m_s")))


def position_columns(space: Space, who: str) -> list[int]:
    """Columns of x_m, y_m and, where there is one, z_m.

    Raises:
        SetupError: the space has no planar position.
    """
    if not {"x_m", "y_m"} <= set(space.names):
        raise SetupError(f"{who} places targets in the room and needs x_m and y_m; the state space is {list(space.names)}")
    return space.index(*(n for n in ("x_m", "y_m", "z_m") if n in space.names))


#: spread of a turn rate of which nothing is known: who walks 1 m/s on a circle of 1 m turns by 1 rad/s
TURN_STD_RAD_S = 1.0


def variances(space: Space, position_std_m: float, velocity_std_m_s: float, who: str) -> Array:
    """Variances (d,) of a state space of positions (…_m), velocities (…_m_s) and turn rates (…_rad_s, TURN_STD_RAD_S).

    Raises:
        SetupError: a coordinate is none of these.
    """
    std = {"m": position_std_m, "m_s": velocity_std_m_s, "rad_s": TURN_STD_RAD_S}
    units = [n.split("_", 1)[1] for n in space.names]
    if not set(units) <= set(std):
        raise SetupError(f"{who} spreads positions in m, velocities in m/s and turn rates in rad/s; the state space is {list(space.names)}")
    return np.array([std[u] ** 2 for u in units])


def per_axis(block: Array, dims: int) -> Array:
    """The block-diagonal (2 dims, 2 dims) matrix that repeats one axis's (2, 2) block."""
    out = np.zeros((2 * dims, 2 * dims))
    for axis in range(dims):
        out[2 * axis : 2 * axis + 2, 2 * axis : 2 * axis + 2] = block
    return out


def linear_moments(x: Array, P: Array, F: Array, Q: Array) -> tuple[Array, Array]:
    """F m and F P Fᵀ + Q of Gaussians (n, d), (n, d, d)."""
    return x @ F.T, F @ P @ F.T + Q


def linear_sample(rng: np.random.Generator, x: Array, F: Array, Q: Array) -> Array:
    """A draw of N(F x, Q) for each particle (n, d); Q may be degenerate."""
    return np.asarray(x @ F.T + rng.standard_normal(x.shape) @ root(Q).T)


def linear_log_density(x1: Array, x0: Array, F: Array, Q: Array) -> Array:
    """log N(x1; F x0, Q) (n,), −inf off the support of a degenerate Q (density on the support, see `log_degenerate`)."""
    magnitude = np.max(np.abs(x1), axis=-1, initial=0.0) + np.max(np.abs(x0), axis=-1, initial=0.0)
    return log_degenerate(x1 - x0 @ F.T, Q, magnitude)
