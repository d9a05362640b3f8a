"""The compiled loops over particles against the same in NumPy."""

import numpy as np
import pytest

from sonobench.filtering import particle_kernels as kernels
from sonobench.filtering.gaussian import log_gaussian
from sonobench.filtering.phd import log_densities


@pytest.mark.parametrize("spread", [1.0, 300.0])
def test_log_shares_and_their_sums_are_numpys(spread):
    rng = np.random.default_rng(0)
    joint, log_clutter, missed = spread * rng.standard_normal((40, 6)), rng.standard_normal(6), spread * rng.standard_normal(40)
    joint[:, 2] = log_clutter[2] = -np.inf  # a row that nothing explains
    joint[3], missed[3] = -np.inf, -np.inf  # a particle without weight
    evidence = np.logaddexp(np.logaddexp.reduce(joint, axis=0), log_clutter)
    want = joint - np.where(np.isneginf(evidence), 0.0, evidence)
    got, after = joint.copy(), missed.copy()
    kernels.log_share(got, log_clutter)
    np.testing.assert_allclose(got, want, rtol=1e-13, atol=1e-13)
    kernels.add_logs(after, got)
    np.testing.assert_allclose(after, np.logaddexp.reduce(np.column_stack([missed, want]), axis=1), rtol=1e-13, atol=1e-13)


def test_masses_within_a_radius_are_numpys():
    rng = np.random.default_rng(1)
    x, w, centres = rng.random((200, 3)), rng.random(200), rng.random((7, 3))
    got = np.full(7, np.nan)
    kernels.masses(x, w, np.ascontiguousarray(centres.T), 0.25, got)
    near = np.sum((x[:, None] - centres) ** 2, axis=-1) <= 0.25
    np.testing.assert_allclose(got, w @ near, rtol=1e-13)


@pytest.mark.parametrize("noises", [1, 5], ids=["one noise", "a noise a row"])
def test_particles_share_the_noise(noises):
    rng = np.random.default_rng(2)
    A = rng.standard_normal((1, noises, 3, 3))
    S, residual = A @ np.swapaxes(A, -1, -2) + 0.1 * np.eye(3), rng.standard_normal((9, 5, 3))
    np.testing.assert_allclose(log_densities(residual, S), log_gaussian(residual, S), rtol=1e-11)


def test_totals_of_rows_are_numpys():
    log = 40 * np.random.default_rng(3).standard_normal((200, 4)) - 60
    log[:, 1] = -np.inf
    got = np.zeros(4)
    kernels.row_totals(log, got)
    np.testing.assert_allclose(got, np.exp(log).sum(axis=0), rtol=1e-12)
