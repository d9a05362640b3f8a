"""One recursion of the Gaussian-mixture PHD filter in plain loops, one component and one row at a time (Chen et al. 2012, eq. 15 to 35)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Component = tuple[float, np.ndarray, np.ndarray]


def cubature(
    m: np.ndarray, P: np.ndarray, h: Callable[[np.ndarray], np.ndarray], R: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """ẑ, P_zz with R, P_xz by eq. 27 to 30, points drawn from the predicted Gaussian."""
    n = len(m)
    root = np.linalg.cholesky(P)
    points = [m + np.sqrt(n) * root[:, i] for i in range(n)] + [m - np.sqrt(n) * root[:, i] for i in range(n)]
    images = [h(p) for p in points]
    z_hat = sum(images) / (2 * n)
    P_zz = sum(np.outer(i - z_hat, i - z_hat) for i in images) / (2 * n) + R
    P_xz = sum(np.outer(p - m, i - z_hat) for p, i in zip(points, images, strict=True)) / (2 * n)
    return z_hat, P_zz, P_xz


def density(z: np.ndarray, mean: np.ndarray, cov: np.ndarray) -> float:
    """N(z; mean, cov)."""
    off = z - mean
    return float(np.exp(-0.5 * off @ np.linalg.solve(cov, off)) / np.sqrt(np.linalg.det(2 * np.pi * cov)))


def step(parts: list[Component], Z: np.ndarray, model: dict) -> list[Component]:
    """`model`: F, Q, h, R, p_s, p_d, kappa (a function of z), born and spawned (lists of (weight, offset or mean, variance)), prune, merge, most."""
    F, Q, p_d = model["F"], model["Q"], model["p_d"]
    moved = [(w, F @ m, F @ P @ F.T + Q) for w, m, P in parts]
    prior = [(model["p_s"] * w, m, P) for w, m, P in moved]  # eq. 19 to 22
    prior += [(b * w, m + offset, P + V) for b, offset, V in model["spawned"] for w, m, P in moved]  # eq. 17
    prior += list(model["born"])  # eq. 18
    after = [((1 - p_d) * w, m, P) for w, m, P in prior]
    for z in Z:
        rows = []
        for w, m, P in prior:
            z_hat, P_zz, P_xz = cubature(m, P, model["h"], model["R"])
            W = P_xz @ np.linalg.inv(P_zz)
            rows.append((p_d * w * density(z, z_hat, P_zz), m + W @ (z - z_hat), P - W @ P_zz @ W.T))
        total = model["kappa"](z) + sum(w for w, _, _ in rows)
        after += [(w / total, m, P) for w, m, P in rows]
    return reduced([a for a in after if a[0] > model["prune"]], model["merge"], model["most"])


def reduced(parts: list[Component], distance: float, most: int) -> list[Component]:
    """Vo & Ma 2006, table II: heaviest first, the candidate's own covariance, stable."""
    left = list(range(len(parts)))
    out = []
    while left:
        j = max(left, key=lambda i: (parts[i][0], -i))
        near = [i for i in left if (parts[i][1] - parts[j][1]) @ np.linalg.solve(parts[i][2], parts[i][1] - parts[j][1]) <= distance**2]
        w = sum(parts[i][0] for i in near)
        m = sum(parts[i][0] * parts[i][1] for i in near) / w
        P = sum(parts[i][0] * (parts[i][2] + np.outer(parts[i][1] - m, parts[i][1] - m)) for i in near) / w
        out.append((w, m, P))
        left = [i for i in left if i not in near]
    return sorted(out, key=lambda a: -a[0])[:most]
