"""The exact PHD update for targets that cause several detections in a scan: factors of particles, without listing partitions.

A target at x causes through each of L modes at most one detection, with probability p_l(x) and density g_l(z | x). With D
the predicted intensity, kappa the clutter's, and L_W(x) the likelihood of the set W of detections (the sum over all ways to
give its members to modes), each particle's weight is multiplied by

    Π_l (1 − p_l(x)) + Σ_W L_W(x) Z(S∖W) / Z(S),      Z(∅) = 1,      Z(T) = Σ_{W ⊆ T, W ∋ lowest(T)} d_W Z(T∖W),
    d_W = ∫ L_W D + [W = {z}] kappa(z),

S being the scan. Z sums over all partitions of a set at once, so nothing is divided by d_W. Several sensors jointly are the
same update: a sensor is a mode (or several) that has density 0 at the other sensors' detections.

Source: Mahler 2009, "PHD filters for nonstandard targets, I: extended targets" (the sum over partitions); Liang 2016, eq. 5-26
to 5-34 (modes), where it is printed with the partitions listed. That costs Bell(m); this costs what the scan's ambiguity
makes necessary, at most O(N L m 2^m + 3^m).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sonobench.filtering.evidence import noise_of, rows_of
from sonobench.filtering.phd import log_intensity, patterns
from sonobench.filtering.steps import pose_of
from sonobench.protocols import BoundMeasurement
from sonobench.types import Array, Bools, Floats, Ints, Scan, Setup

MOST_ROWS = 62  # a set of rows is the bits of one integer
DENSE_ROWS = 18  # of a group for which all subsets are cheaper than a table of those reached
_COARSER, _COARSEST = 100.0, 1e-4
_VALUES, _SETS = 1 << 20, 1 << 14  # likelihoods of particles' sets that are held, and sets
_WAYS = 1 << 25  # of which most fall to the cut on the way


class Factors(NamedTuple):
    """What one scan does to particles.

    Attributes:
        factor: (N,) that each weight is multiplied by.
        missed: (N,) the part of it of targets that caused no detection.
        explained: (N, m) the part of it in which row z is one of the target's detections (a target may have several, so
            that these add up to more than `factor`), where it was asked for; else (N, 0).
        sets: how many sets W took part.
        cut: the cut that was used; above the one asked for where the scan was too ambiguous.
        left_out: rows that were taken for clutter, since not even the coarsest cut could do with all: those least likely a
            target's. More than 62 are never updated jointly.
    """

    factor: Array
    missed: Array
    explained: Array
    sets: int
    cut: float
    left_out: int = 0


def evidence(x: Array, scan: Scan, measurement: BoundMeasurement, setup: Setup, sensors: tuple[int, ...]) -> tuple[Array, Array, Array]:
    """What `factors` needs of a scan and particles x (N, d), for several sensors jointly: their modes and rows follow one another.

    Returns:
        log_pg (N, L, m), −inf where mode and row are of different sensors; log_miss (N, L); log_kappa (m,).
    """
    blocks, log_miss, log_kappa = [], [], []
    for q in sensors:
        z_hat = measurement.h(x, q, pose_of(setup, scan, q))  # (N, L, dz)
        rows = rows_of(scan, q, z_hat.shape[-1])
        p_d = measurement.p_d(x, q, scan)
        with np.errstate(divide="ignore"):
            log_p, log_q = np.log(p_d), np.log1p(-p_d)
        log_g, kappa = np.empty((*z_hat.shape[:2], len(rows.z))), np.empty(len(rows.z))
        for which, valid in patterns(rows):
            noise = noise_of(measurement, scan, q, rows, which, z_hat.reshape(-1, z_hat.shape[-1]))[..., valid, :][..., valid]
            noise = noise.reshape(*z_hat.shape[:2], *noise.shape[1:]) if noise.ndim == 4 else noise.reshape(-1, *noise.shape[-2:])
            residual = measurement.residual(rows.z[which], z_hat[:, :, None], q)[..., valid]  # (N, L, m, dz)
            log_g[:, :, which] = _log_gaussian(residual, noise)
            kappa[which] = log_intensity(measurement, rows.z[which], q, valid)
        blocks.append(log_p[:, :, None] + log_g)
        log_miss.append(log_q)
        log_kappa.append(kappa)
    log_pg = np.full((len(x), sum(b.shape[1] for b in blocks), sum(b.shape[2] for b in blocks)), -np.inf)
    mode = row = 0
    for block in blocks:
        log_pg[:, mode : mode + block.shape[1], row : row + block.shape[2]] = block
        mode, row = mode + block.shape[1], row + block.shape[2]
    return log_pg, np.concatenate(log_miss, axis=1), np.concatenate(log_kappa)


def _log_gaussian(residual: Floats, noise: Array) -> Array:
    """log N(residual; 0, noise) of (…, m, dz) and (…, m, dz, dz) or (m or 1, dz, dz)."""
    try:
        factor = np.linalg.cholesky(noise)
    except np.linalg.LinAlgError:
        raise ValueError("a measurement noise is singular; give the measurement a noise above zero") from None
    whitening = np.broadcast_to(np.linalg.inv(factor), (*noise.shape[:-3], residual.shape[-2], *noise.shape[-2:]))
    white = np.einsum("...mi,...mji->...mj", residual, whitening)
    log_det = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
    return np.asarray(-0.5 * np.einsum("...j,...j->...", white, white) - log_det - 0.5 * residual.shape[-1] * math.log(2 * math.pi))


def factors(
    log_w: Floats,
    log_pg: Floats,
    log_miss: Floats,
    log_kappa: Floats,
    cut: float = 1e-6,
    most_work: int = 1 << 20,
    explain: bool = False,
) -> Factors:
    """Update factors of particles.

    Args:
        log_w: (N,) log weights of the predicted intensity.
        log_pg: (N, L, m) log of p_l(x) g_l(z | x); −inf where a mode cannot cause a row.
        log_miss: (N, L) log of 1 − p_l(x).
        log_kappa: (m,) log clutter intensity at the rows.
        cut: alternatives that are less probable than this share of the one without them are left out: a particle's use of a row
            beside leaving it to clutter, and a set's joint origin beside separate ones. 0 is exact.
        most_work: steps of the recursion for Z in one group of rows that hang together (a million take some 10 ms); where that does
            not do, the cut is raised up to 1e-4, then the least likely third of the rows is left out; the answer says both.
        explain: work out `explained`.

    Raises:
        ValueError: shapes that do not fit, or numbers beyond float64.
    """
    log_w, log_pg, log_miss, log_kappa = (np.asarray(a, np.float64) for a in (log_w, log_pg, log_miss, log_kappa))
    if log_pg.ndim != 3 or log_w.shape != log_pg.shape[:1] or log_miss.shape != log_pg.shape[:2] or log_kappa.shape != log_pg.shape[2:]:
        raise ValueError(f"log_w {log_w.shape}, log_miss {log_miss.shape} and log_kappa {log_kappa.shape} do not fit log_pg {log_pg.shape}")
    n, _, m = log_pg.shape
    q = np.exp(log_miss)
    missed = q.prod(axis=1)
    explained = np.zeros((n, m if explain else 0))
    a, kappa, used = _scaled(log_w, log_pg, log_kappa, q, cut)
    if n == 0 or len(used) == 0:
        return Factors(missed, missed, explained, 0, cut)
    likeliest, room, w = np.argsort(kappa, kind="stable"), min(len(used), MOST_ROWS), np.exp(log_w)  # scaled: the share of clutter
    while True:
        kept = np.sort(likeliest[:room])
        solved = _solve(w, np.ascontiguousarray(a[:, :, kept]), q, kappa[kept], cut, most_work, explain)
        if solved is not None:
            break
        room = max(2 * room // 3, 1)
    factor, own, sets, cut = solved
    left_out, used = len(used) - room, used[kept]
    if not np.isfinite(factor).all():
        raise ValueError("particles' weights spread over too many decades for float64; resample, or drop the lightest")
    if explain:
        explained[:, used] = own
    return Factors(factor, missed, explained, sets, cut, left_out)


def _scaled(log_w: Array, log_pg: Array, log_kappa: Array, q: Array, cut: float) -> tuple[Array, Array, Ints]:
    """p g and kappa over each row's predicted intensity and clutter, and the rows that a particle may cause.

    Scaled so, a row's intensity is 1, and products over rows stay within float64.
    """
    n, modes, m = log_pg.shape
    with np.errstate(divide="ignore", invalid="ignore"):
        joint = (log_w[:, None, None] + log_pg).reshape(n * modes, m)
        top = np.max(joint, axis=0, initial=-np.inf)
        top = np.where(np.isfinite(top), top, 0.0)
        share = np.exp(joint - top).reshape(log_pg.shape)
        log_scale = np.logaddexp(np.log(share.sum(axis=(0, 1))) + top, log_kappa)
        known = np.isfinite(log_scale)
        a = share * np.where(known, np.exp(top - log_scale), 0.0) * np.exp(-log_w)[:, None, None]
        lost = np.isneginf(log_w)  # a particle without weight still has a factor
        a[lost] = np.exp(log_pg[lost] - log_scale)
        kappa = np.where(known, np.exp(log_kappa - log_scale), 0.0)
    used = np.flatnonzero((a > cut * q[:, :, None] * kappa).any(axis=(0, 1))).astype(np.int64)
    return np.ascontiguousarray(a[:, :, used]), kappa[used], used


def _solve(w: Array, a: Array, q: Array, kappa: Array, cut: float, most_work: int, explain: bool) -> tuple[Array, Array, int, float] | None:
    """factor, explained, number of sets and the cut used; None where not even the coarsest does."""
    from sonobench.filtering import multidetection_kernels as kernels

    others = np.stack([np.delete(q, l, axis=1).prod(axis=1) for l in range(q.shape[1])], axis=1)
    alone = kappa + np.einsum("nlm,nl->m", a, w[:, None] * others)
    last = a.shape[2] == 1
    while True:
        starts = np.zeros(0, np.int64)
        if last or _ways(a, q, alone, cut) <= _WAYS:
            starts, which, value, masks, tau = kernels.likelihoods(w, a, q, alone, cut, max(_VALUES, 16 * len(w)), _SETS)
        if len(starts):
            ratio, sets = _ratios(masks, tau, kappa, cut, most_work)
            if sets:
                factor, explained = kernels.summed(starts, which, value, masks, ratio, len(kappa) if explain else 0)
                return factor, explained, sets, cut
        if cut >= _COARSEST and not last:
            return None
        cut = min(max(cut * _COARSER, 1e-8), max(cut, _COARSEST))


def _ways(a: Array, q: Array, alone: Array, cut: float) -> float:
    """How many ways particles have to give rows to modes, rows shared by modes counted twice; a bound of what is to be held."""
    choices = np.count_nonzero(a >= np.maximum(cut * q[:, :, None] * alone, np.finfo(float).tiny), axis=2)
    return float(np.prod(1.0 + choices, axis=1).sum())


def _ratios(masks: Ints, tau: Array, kappa: Array, cut: float, most_work: int) -> tuple[Array, int]:
    """Z(S∖W) / Z(S) of each set (1 for the empty one, 0 for those left out), and how many took part; 0 if that took too much work."""
    from sonobench.filtering import multidetection_kernels as kernels

    m = len(kappa)
    bits = (masks[:, None] >> np.arange(m)) & 1 == 1
    size = bits.sum(axis=1)
    d = tau.copy()
    alone = np.zeros(m)
    single = np.flatnonzero(size == 1)
    row = bits[single].argmax(axis=1)
    d[single] += kappa[row]
    alone[row] = d[single]
    lone = np.setdiff1d(np.arange(m), row)  # rows that no particle causes alone still may be clutter
    alone[lone] = kappa[lone]
    with np.errstate(divide="ignore"):
        separate = np.where(bits, np.log(alone), 0.0).sum(axis=1)
        kept = (size == 1) | ((size > 1) & (np.log(d) >= separate + (np.log(cut / len(d)) if cut > 0 else -np.inf)) & (d > 0))
    ratio = np.zeros(len(masks))
    ratio[size == 0] = 1.0
    for group in _groups(bits[kept & (size > 1)], m):
        mine = np.flatnonzero(kept & bits[:, group].any(axis=1))
        own = np.ascontiguousarray(bits[mine][:, group])
        extra = [k for k, z in enumerate(group) if z in lone]
        local = np.concatenate([(own << np.arange(len(group))).sum(axis=1), [1 << k for k in extra]]).astype(np.int64)
        weight = np.concatenate([d[mine], kappa[group[extra]]])
        solve = kernels.partitions_dense if len(group) <= DENSE_ROWS else kernels.partitions_sparse
        found = solve(local, weight, len(group), most_work)
        if len(found) == 0:
            return ratio, 0
        ratio[mine] = found[: len(mine)]
    return ratio, int(kept.sum())


def _groups(bits: Bools, m: int) -> list[Ints]:
    """Rows that sets of several rows connect, each group in an order in which neighbours hang together."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components, reverse_cuthill_mckee

    near = bits.astype(float).T @ bits.astype(float) if len(bits) else np.zeros((m, m))
    count, label = connected_components(csr_array(near), directed=False)
    groups = []
    for g in range(count):
        rows = np.flatnonzero(label == g)
        order = reverse_cuthill_mckee(csr_array(near[np.ix_(rows, rows)]), symmetric_mode=True) if len(rows) > 2 else np.arange(len(rows))
        groups.append(rows[order].astype(np.int64))
    return groups
