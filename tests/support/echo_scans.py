"""One pair of microphones that hears two talkers directly and by two walls, as in Liang 2016, section 5.5, with particles about them."""

from __future__ import annotations

import numpy as np

from sonobench.types import Detections, Scan, Sensor, Setup, Space
from sonobench_plugins.measurement.tdoa_images import BoundTdoaImages, TdoaImages

SPACE = Space.of("x_m", "vx_m_s", "y_m", "vy_m_s")
TALKERS = np.array([[1.0, 0, 1.0, 0], [2.0, 0, 2.0, 0]])
REACH_S = 0.012


def setup(pairs: int = 1, clutter: float = 3.0, std_s: float = 5e-5) -> Setup:
    """The thesis's pairs, the first or all four, in its room."""
    ends = np.array(
        [[[1.25, 0.01], [1.75, 0.01]], [[0.01, 1.25], [0.01, 1.75]], [[1.25, 2.99], [1.75, 2.99]], [[2.99, 1.25], [2.99, 1.75]]]
    )
    elements = np.concatenate([ends, np.full((4, 2, 1), 1.8)], axis=-1)
    return Setup(
        sensors=tuple(Sensor(f"pair-{q}", "a", "tdoa", elements[q], Space.of("tau_s"), np.array([[0, 1]])) for q in range(pairs)),
        array_names=("a",),
        poses=np.eye(4)[None],
        c_m_s=344.0,
        box_m=np.array([[0.0, 0, 0], [3, 3, 2.5]]),
        nominal={"p_d": 0.9, "clutter_per_scan": clutter, "delay_std_s": std_s, "height_m": 1.8},
    )


def five_modes(where: Setup) -> BoundTdoaImages:
    """Direct, and by the walls at x = 0 and x = 3 m."""
    return TdoaImages(reach_s=REACH_S).bind(SPACE, where)


def cloud(n: int, seed: int = 0, born: float = 0.2) -> tuple[np.ndarray, np.ndarray]:
    """log weights (n,) and particles (n, 4): about both talkers within 8 cm, and `born` of them anywhere with weight .05 in all."""
    rng = np.random.default_rng(seed)
    spread = round(born * n)
    near = TALKERS[rng.integers(2, size=n - spread)] + rng.normal(0, 0.08, (n - spread, 4))
    anywhere = np.c_[rng.uniform(0, 3, spread), np.zeros(spread), rng.uniform(0, 3, spread), np.zeros(spread)]
    log_w = np.concatenate([np.full(n - spread, np.log(2 / (n - spread))), np.full(spread, np.log(0.05 / max(spread, 1)))])
    return log_w, np.concatenate([near, anywhere])


def scan_of(model: BoundTdoaImages, where: Setup, rows: int, seed: int = 0) -> Scan:
    """`rows` rows of every sensor: modes of the talkers that are detected, strongest first, and clutter over what may be heard."""
    rng = np.random.default_rng(seed)
    parts = []
    for q in model.sensors:
        true = model.h(TALKERS, q)[..., 0].T.ravel()  # direct ones first
        heard = true[rng.random(len(true)) < np.repeat([0.9, 0.4, 0.4, 0.4, 0.4], 2)[: len(true)]][:rows]
        noisy = heard + model.delay_std_s * rng.standard_normal(len(heard))
        parts.append(np.concatenate([noisy, rng.uniform(-REACH_S, REACH_S, rows - len(noisy))]))
    sensor = np.repeat(np.array(model.sensors), rows)
    return Scan(0.1, np.ones(len(where.sensors), bool), (Detections(np.concatenate(parts)[:, None], sensor),))
