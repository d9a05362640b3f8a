"""Small measurement-level scenes for the tests of models, births and trackers: the set-up of Chen et al. 2012 by hand."""

from __future__ import annotations

import numpy as np

from sonobench.types import Detections, Scan, Sensor, Setup, Space

MICROPHONES = np.array([[1.4, 0], [2, 0], [0, 1.4], [0, 2], [1.4, 3], [2, 3], [3, 1.4], [3, 2]])
BIRTHS = np.array([[0.5, 0, 1.5, 0.98], [0.3, 0.98, 2.8, 0.0], [0.5, 0, 1.0, 0.98]])
SIGMA_S = 125e-6
PERIOD_S = 0.032


def setup(stacked: bool = True, clutter: float = 7.0, p_d: float = 0.98, sigma_s: float = SIGMA_S, **more) -> Setup:
    """Four pairs round a room of 3 m, as one stack or one sensor a pair."""
    elements = np.c_[MICROPHONES, np.zeros(8)]
    if stacked:
        space = Space(tuple(f"tau{i}_s" for i in range(4)))
        sensors = (Sensor("stack", "walls", "tdoa", elements, space, np.arange(8).reshape(4, 2)),)
    else:
        sensors = tuple(
            Sensor(f"pair/{i}", "walls", "tdoa", elements[2 * i : 2 * i + 2], Space.of("tau_s"), np.array([[0, 1]])) for i in range(4)
        )
    values = {
        "array_names": ("walls",),
        "poses": np.eye(4)[None],
        "period_s": PERIOD_S,
        "box_m": np.array([[0.0, 0, 0], [3, 3, 3]]),
        "nominal": {"p_d": p_d, "clutter_per_scan": clutter, "delay_std_s": sigma_s, "height_m": 0.0},
    }
    return Setup(sensors=sensors, **{**values, **more})


def truth(k: int) -> np.ndarray:
    """States (n, 4) of the talkers in frame k = 1 … 100."""

    def circle(centre, start, angle, rate):
        r = 1.0
        a = start - angle
        return [centre[0] + r * np.cos(a), r * rate * np.sin(a), centre[1] + r * np.sin(a), -r * rate * np.cos(a)]

    rows = []
    share = (k - 1) / 99
    rate = np.pi / (99 * PERIOD_S)
    rows.append(circle((1.5, 1.5), np.pi, share * np.pi, rate))
    rows.append(circle((0.3, 1.8), np.pi / 2, share * np.pi, rate))
    if 10 <= k <= 90:
        rows.append(circle((1.5, 1.0), np.pi, (k - 10) / 80 * np.pi, np.pi / (80 * PERIOD_S)))
    return np.array(rows)


def delays(x: np.ndarray, c: float = 343.0) -> np.ndarray:
    """Delays (n, 4) of states (n, 4)."""
    r = np.linalg.norm(x[:, [0, 2]][:, None] - MICROPHONES, axis=-1)
    return (r[:, ::2] - r[:, 1::2]) / c


def scans(rng: np.random.Generator, stacked: bool = True, clutter: float = 7.0, p_d: float = 0.98, sigma_s: float = SIGMA_S) -> list[Scan]:
    """100 scans of the scene."""
    limit = 0.6 / 343.0
    out = []
    for k in range(1, 101):
        z = delays(truth(k))
        z = z + sigma_s * rng.standard_normal(z.shape)
        time_s = k * PERIOD_S
        if stacked:
            rows = np.r_[z[rng.random(len(z)) < p_d], rng.uniform(-limit, limit, (rng.poisson(clutter), 4))]
            rows = rng.permutation(rows)
            out.append(Scan(time_s, [True], (Detections(rows, np.zeros(len(rows), int)),)))
        else:
            parts = [np.r_[z[rng.random(len(z)) < p_d, q], rng.uniform(-limit, limit, rng.poisson(clutter))] for q in range(4)]
            rows, sensor = np.concatenate(parts)[:, None], np.repeat(np.arange(4), [len(p) for p in parts])
            out.append(Scan(time_s, [True] * 4, (Detections(rows, sensor),)))
    return out


def ospa(a: np.ndarray, b: np.ndarray, c: float = 1.5, p: float = 2.0) -> float:
    """OSPA of two sets of points."""
    from scipy.optimize import linear_sum_assignment

    n, m = len(a), len(b)
    if max(n, m) == 0:
        return 0.0
    d = np.minimum(np.linalg.norm(a[:, None] - b, axis=-1), c) ** p if n and m else np.zeros((n, m))
    rows, columns = linear_sum_assignment(d)
    return ((d[rows, columns].sum() + abs(n - m) * c**p) / max(n, m)) ** (1 / p)


def run(tracker, where: Setup, frames: list[Scan], seed: int = 0):
    """Estimates of a tracker."""
    rng = np.random.default_rng(seed)
    state = tracker.init(rng, where)
    estimates = []
    for scan in frames:
        state, estimate = tracker.step(rng, state, scan)
        estimates.append(estimate)
    return estimates


def mean_ospa(estimates) -> float:
    """Position OSPA averaged over the frames."""
    return float(np.mean([ospa(truth(k)[:, [0, 2]], e.states[:, [0, 2]]) for k, e in enumerate(estimates, 1)]))
