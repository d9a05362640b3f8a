import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from phd_linear import frozen, mixture

from sonobench.filtering.mixture import cap, empty, extract, merge, prune, take, union
from sonobench.protocols import Mixture
from sonobench.types import Space


def lines(mix):
    return Space.of(*(f"{k}_m" for k in range(mix.m.shape[1])))


def merged_by_the_table(w, m, P, distance):
    """Vo & Ma 2006, table II, as it is printed, one component at a time."""
    left = list(range(len(w)))
    out = []
    while left:
        j = max(left, key=lambda i: w[i])
        near = [i for i in left if i == j or (m[i] - m[j]) @ np.linalg.inv(P[i]) @ (m[i] - m[j]) <= distance**2]
        total = sum(w[i] for i in near)
        mean = sum(w[i] * m[i] for i in near) / total
        cov = sum(w[i] * (P[i] + np.outer(m[i] - mean, m[i] - mean)) for i in near) / total
        out.append((total, mean, cov))
        left = [i for i in left if i not in near]
    return out


@pytest.mark.parametrize("seed", range(5))
def test_merge_is_the_printed_table(seed):
    mix = mixture(np.random.default_rng(seed), 40)
    got, want = merge(mix, 2.0, lines(mix)), merged_by_the_table(mix.w, mix.m, mix.P, 2.0)
    assert 1 < len(want) < 40
    np.testing.assert_allclose(got.w, [a for a, _, _ in want], rtol=1e-12)
    np.testing.assert_allclose(got.m, [b for _, b, _ in want], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(got.P, [c for _, _, c in want], rtol=1e-10, atol=1e-12)


def moments(mix):
    mean = mix.w @ mix.m / mix.w.sum()
    second = np.einsum("j,jab->ab", mix.w, mix.P + mix.m[:, :, None] * mix.m[:, None, :]) / mix.w.sum()
    return mix.w.sum(), mean, second


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10**6), st.integers(0, 30), st.floats(0, 10))
def test_merge_keeps_mass_mean_and_second_moment(seed, n, distance):
    mix = mixture(np.random.default_rng(seed), n)
    joined = merge(mix, distance, lines(mix))
    if n:
        for a, b in zip(moments(mix), moments(joined), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)
    assert len(joined.w) <= n


def test_equal_weights_merge_in_a_stable_order():
    m = np.array([[0.0], [1.0], [2.0], [3.0]])
    mix = frozen(Mixture(np.full(4, 0.25), m, np.full((4, 1, 1), 0.3), np.zeros(4, np.int64)))
    joined = merge(mix, 2.0, lines(mix))  # 0 takes 1, then 2 takes 3
    np.testing.assert_allclose(joined.m[:, 0], [0.5, 2.5])


def test_the_candidates_own_covariance_measures_the_distance():
    m, P = np.array([[0.0], [1.0]]), np.array([[[100.0]], [[0.01]]])
    heavy_wide = Mixture(np.array([2.0, 1.0]), m, P, np.zeros(2, np.int64))
    assert len(merge(heavy_wide, 2.0, lines(heavy_wide)).w) == 2  # the narrow candidate lies 10 of its deviations away
    assert len(merge(heavy_wide._replace(w=np.array([1.0, 2.0])), 2.0, lines(heavy_wide)).w) == 1  # the wide one only .1


def test_merge_stays_within_a_mode():
    mix = Mixture(np.ones(3), np.zeros((3, 1)), np.ones((3, 1, 1)), np.array([0, 1, 0]))
    joined = merge(mix, 5.0, lines(mix))
    np.testing.assert_array_equal(joined.mode, [0, 1])
    np.testing.assert_allclose(joined.w, [2, 1])


def test_merge_takes_degenerate_covariances_and_zero_weights():
    mix = Mixture(np.zeros(3), np.array([[0.0, 0], [0, 0], [5, 0]]), np.zeros((3, 2, 2)) + np.diag([1.0, 0]), np.zeros(3, np.int64))
    joined = merge(mix, 2.0, lines(mix))
    np.testing.assert_array_equal(joined.m, [[0, 0], [5, 0]])
    assert np.isfinite(joined.P).all()


def test_merge_joins_across_the_end_of_a_periodic_coordinate():
    rng = np.random.default_rng(5)
    near = mixture(rng, 12)
    near = near._replace(m=0.2 * near.m[:, :2], P=np.ascontiguousarray(0.1 * near.P[:, :2, :2]))
    space, turned = Space.of("azimuth_rad", "vazimuth_m_s"), near.m + np.array([np.pi, 0.0])
    across = near._replace(m=turned - 2 * np.pi * (turned >= np.pi) * np.array([1, 0]))
    assert np.ptp(across.m[:, 0]) > 6
    joined, want = merge(across, 2.0, space), merge(near, 2.0, space)
    assert 1 <= len(want.w) < 12
    np.testing.assert_allclose(joined.w, want.w)
    np.testing.assert_allclose(space.residual(joined.m, want.m), np.tile([-np.pi, 0.0], (len(want.w), 1)), atol=1e-12)
    np.testing.assert_allclose(joined.P, want.P, atol=1e-12)
    line = merge(across, 2.0, lines(across))
    assert len(line.w) > len(want.w)


def test_prune_drops_at_or_below_and_keeps_order():
    mix = mixture(np.random.default_rng(0), 6)
    kept = prune(mix, float(np.sort(mix.w)[2]))
    np.testing.assert_array_equal(kept.w, mix.w[mix.w > np.sort(mix.w)[2]])


def test_cap_keeps_the_heaviest_first_of_equals_in_order():
    mix = Mixture(np.array([0.1, 0.5, 0.1, 0.5, 0.1]), np.arange(5.0)[:, None], np.ones((5, 1, 1)), np.zeros(5, np.int64))
    np.testing.assert_array_equal(cap(mix, 3).m[:, 0], [0, 1, 3])
    assert cap(mix, 5) is mix


def test_extract_counts_copies_by_rounded_weight():
    mix = Mixture(np.array([0.4, 0.51, 1.6, 2.4]), np.arange(4.0)[:, None], np.ones((4, 1, 1)), np.zeros(4, np.int64))
    np.testing.assert_array_equal(extract(mix, 0.5, True).m[:, 0], [3, 3, 2, 2, 1])
    np.testing.assert_array_equal(extract(mix, 0.5, False).m[:, 0], [3, 2, 1])


def test_empty_and_union():
    mix = mixture(np.random.default_rng(0), 3)
    joined = union(empty(4), mix, take(mix, np.array([0])))
    assert len(joined.w) == 4
    assert joined.mode.dtype == np.int64
    assert len(merge(empty(4), 2.0, lines(empty(4))).w) == len(cap(empty(4), 3).w) == len(extract(empty(4), 0.5, True).w) == 0
