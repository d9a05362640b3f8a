"""Monte-Carlo figures of directions from cumulants and from covariances; `-s` prints the table of docs/papers/zhang_glmb.md."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from vector_sources import errors, heard, spread

from sonobench_plugins.direction.covariance_peaks import CovariancePeaks
from sonobench_plugins.direction.cumulant_peaks import CumulantPeaks
from sonobench_plugins.direction.gls import Gls

_RUNS = 200
_METHODS = {
    "covariance-peaks": CovariancePeaks(),
    "cumulant-peaks": CumulantPeaks(),
    "cumulant-gls": Gls(noise="any"),
    "gls": Gls(),
}


def _told(method, samples):
    found = method.directions(samples[None])
    return found.u[0][found.valid[0]]


def _off(m: int, noise: str, apart_deg: float = 35.0, names=tuple(_METHODS)) -> dict[str, np.ndarray]:
    """Errors (runs, m) in degrees by method, the number of sources known; the same sound for all."""
    rng = np.random.default_rng([m, sorted(["equal", "unequal", "non-uniform", "correlated"]).index(noise)])
    methods = {n: dataclasses.replace(_METHODS[n], order="given", sources=min(m, _METHODS[n].most)) for n in names}
    off: dict[str, list[np.ndarray]] = {n: [] for n in names}
    for _ in range(_RUNS):
        u = spread(rng, m, apart_deg)
        samples = heard(rng, u, noise=noise)
        for name, method in methods.items():
            off[name].append(errors(u, _told(method, samples)))
    return {n: np.array(e) for n, e in off.items()}


def _print(m: int, noise: str, off: dict[str, np.ndarray]) -> None:
    cells = [f"{n} {np.median(e):.2f}, {np.sqrt((e**2).mean()):.2f}, {(e.max(axis=1) < 10).mean():.3f}" for n, e in off.items()]
    print(f"\n{m} {noise} (median, rms, all within 10°): " + "; ".join(cells))


@pytest.mark.study
@pytest.mark.parametrize("m", [1, 2, 3, 5])
def test_in_equal_noise_two_are_within_a_degree_and_five_are_found(m):
    off = _off(m, "equal")
    _print(m, "equal", off)
    if m == 2:
        assert all(np.sqrt((e**2).mean()) < 1 for e in off.values())
    if m == 5:
        assert (off["cumulant-peaks"].max(axis=1) < 10).mean() >= 0.55
        assert (off["gls"].max(axis=1) < 10).mean() >= 0.55
        assert np.median(off["gls"]) < np.median(off["cumulant-peaks"])


@pytest.mark.study
@pytest.mark.parametrize("apart_deg", [20.0, 10.0])
def test_of_five_closer_sources_a_fit_finds_more_than_a_subspace(apart_deg):
    off = _off(5, "equal", apart_deg, ("cumulant-peaks", "cumulant-gls", "gls"))
    _print(5, f"at least {apart_deg:g} degrees apart", off)
    assert np.median(off["gls"]) < np.median(off["cumulant-peaks"])


@pytest.mark.study
@pytest.mark.parametrize("noise", ["unequal", "non-uniform", "correlated"])
@pytest.mark.parametrize("m", [1, 2, 3])
def test_in_other_noise_cumulants_go_on_and_covariances_do_not(m, noise):
    off = _off(m, noise)
    _print(m, noise, off)
    assert np.median(off["cumulant-gls"]) < np.median(off["cumulant-peaks"])
    if m > 1 or noise != "unequal":  # one source under isotropic velocity noise is on an axis of it
        assert np.median(off["cumulant-peaks"]) < np.median(off["covariance-peaks"])


@pytest.mark.study
@pytest.mark.parametrize("m", [0, 1, 2, 3, 4, 5, 6])
def test_rules_for_the_number_of_sources(m):
    rng = np.random.default_rng(m)
    rules = {f"peaks {r}": CumulantPeaks(order=r) for r in ("threshold", "gap", "error")} | {"gls fit": Gls()}
    counts: dict[str, list[int]] = {n: [] for n in rules}
    for _ in range(_RUNS):
        samples = heard(rng, spread(rng, m, 30 if m == 6 else 35))
        for name, method in rules.items():
            counts[name].append(len(_told(method, samples)))
    right = {n: float(np.mean(np.array(c) == m)) for n, c in counts.items()}
    print(f"\n{m}: " + ", ".join(f"{n} {v:.3f}" for n, v in right.items()))
    assert right["gls fit"] >= max(right["peaks gap"], right["peaks threshold"]) - 0.03


@pytest.mark.study
@pytest.mark.parametrize("m", [2, 3, 5])
def test_the_covariance_of_a_fit_is_that_of_its_error(m):
    from sonobench.signal.direction_fit import tangent

    rng = np.random.default_rng(m)
    method, nees = Gls(order="given", sources=m), []
    for _ in range(_RUNS):
        u = spread(rng, m, 35)
        fit = method.fits(heard(rng, u)[None])[0]
        nearest = np.argmax(u @ fit.u.T, axis=0)
        off = np.einsum("mi,mij->mj", u[nearest] - fit.u, tangent(fit.u))
        nees += list(np.einsum("mi,mij,mj->m", off, np.linalg.inv(fit.R), off))
    print(f"\n{m}: NEES (2 degrees) median {np.median(nees):.2f} (1.39), mean {np.mean(nees):.2f}")
    assert 1.0 < np.median(nees) < 2.0
