"""Small truths and outputs for the tests of scoring, metrics and pictures."""

from __future__ import annotations

import numpy as np

from sonobench.types import Estimate, Space, Truth

XY = Space.of("x_m", "y_m")


def truth(position, exists=None, active=None, period_s=1.0, time_s=None, **more) -> Truth:
    """Position (k, n, 2 or 3); everybody exists and sounds unless said."""
    position = np.asarray(position, float)
    if position.shape[-1] == 2:
        position = np.concatenate([position, np.full((*position.shape[:-1], 1), 1.5)], axis=-1)
    k, n = position.shape[:2]
    exists = np.ones((k, n), bool) if exists is None else np.asarray(exists, bool).reshape(k, n)
    return Truth(
        time_s=np.arange(k) * period_s if time_s is None else time_s,
        label=np.arange(n),
        position=position,
        exists=exists,
        active=exists if active is None else np.asarray(active, bool).reshape(k, n),
        period_s=period_s,
        **more,
    )


def estimates(states, time_s=None, period_s=1.0) -> list[Estimate]:
    """One Estimate for each (n, d) of `states`."""
    times = np.arange(len(states)) * period_s if time_s is None else time_s
    return [Estimate(time_s=t, states=np.asarray(s, float)) for t, s in zip(times, states, strict=True)]


def sets(x, y, d=2):
    """A truth of one instant with points x (n, d), an output of one estimate with points y (m, d), and their space."""
    x, y = np.asarray(x, float).reshape(-1, d), np.asarray(y, float).reshape(-1, d)
    return truth(x[None]), estimates([y]), Space(("x_m", "y_m", "z_m")[:d])
