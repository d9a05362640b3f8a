"""Who a particle belongs to: names are given, kept, split and merged."""

import numpy as np
import pytest

from sonobench.filtering.labels import UNLABELLED, Place, relabelled
from sonobench.filtering.particles import Cloud, clustered, k_means, labelled

PLACE = Place([0, 2], 0.5, 0.5)


def cloud(*parts, seed=0, std=0.05):
    """Particles of (state, mass, label) triples, 200 each, read-only."""
    rng = np.random.default_rng(seed)
    x = np.concatenate([np.asarray(m, float) + std * rng.standard_normal((200, 4)) for m, _, _ in parts])
    w, label = (np.repeat([p[i] for p in parts], 200) for i in (1, 2))
    made = Cloud(np.log(w / 200), x, np.zeros(len(x), np.int64), label)
    for array in made:
        array.flags.writeable = False
    return made


def named(made, following=10):
    return relabelled(np.random.default_rng(0), made, PLACE, following)


def masses(made):
    return {int(n): round(float(np.exp(made.log_w)[made.label == n].sum()), 6) for n in np.unique(made.label)}


def test_born_particles_are_named_where_they_weigh_enough_and_only_there():
    after, following = named(cloud(([1, 0, 1, 0], 0.9, -1), ([4, 0, 4, 0], 0.3, -1), ([8, 0, 1, 0], 0.8, -1)))
    assert following == 12
    assert masses(after) == {UNLABELLED: 0.3, 10: 0.9, 11: 0.8}


def test_born_particles_near_a_target_are_its_own_unless_they_weigh_more():
    after, following = named(cloud(([1, 0, 1, 0], 0.8, 3), ([1.1, 0, 1, 0], 0.2, -1)))
    assert (masses(after), following) == ({3: 1.0}, 10)
    after, following = named(cloud(([1, 3, 1, 0], 0.05, 3), ([1.1, 0, 1, 0], 0.9, -1)))
    assert (masses(after), following) == ({3: 0.05, 10: 0.9}, 11)


def test_a_label_of_two_targets_is_split_and_the_heavier_keeps_it():
    after, following = named(cloud(([1, 0, 1, 0], 0.8, 3), ([4, 0, 4, 0], 1.0, 3)))
    assert (masses(after), following) == ({3: 1.0, 10: 0.8}, 11)


def test_two_labels_on_one_target_become_the_older():
    assert masses(named(cloud(([1, 0, 1, 0], 0.4, 7), ([1, 0, 1, 0], 0.6, 3)))[0]) == {3: 1.0}


def test_two_targets_that_cross_keep_their_labels_even_where_one_is_missed():
    crossing = cloud(([1, 2, 1, 0], 0.05, 3), ([1, -2, 1, 0], 1.0, 4))
    assert masses(named(crossing)[0]) == {3: 0.05, 4: 1.0}
    beside = cloud(([1, 0, 1, 0], 0.9, 3), ([1, 0, 1, 0], 0.95, 4))
    assert masses(named(beside)[0]) == {3: 0.9, 4: 0.95}


@pytest.mark.filterwarnings("error")
def test_targets_of_a_particle_each_are_one_only_at_one_place():
    label = np.array([3, 4])
    for off, names in ((0.0, {3}), (0.1, {3, 4})):
        two = Cloud(np.log([0.3, 0.4]), np.array([[1.0, 0, 0, 0], [1.0 + off, 0, 0, 0]]), np.zeros(2, np.int64), label)
        assert set(named(two)[0].label) == names


def test_weights_and_states_are_left_alone():
    before = cloud(([1, 0, 1, 0], 1.9, 3), ([4, 0, 4, 0], 0.9, -1))
    after, _ = named(before)
    assert all(a is b for a, b in zip(before[:3], after[:3], strict=True))
    assert named(cloud(([0, 0, 0, 0], 0.1, -1)))[1] == 10
    empty = Cloud(np.zeros(0), np.zeros((0, 4)), np.zeros(0, np.int64), np.zeros(0, np.int64))
    assert len(named(empty)[0].label) == 0


def test_targets_are_the_labels_that_weigh_enough():
    found, names = labelled(cloud(([1, 0, 1, 0], 0.9, 5), ([4, 0, 4, 0], 0.4, 2), ([8, 0, 1, 0], 0.8, 0), ([2, 0, 2, 0], 3.0, -1)), 0.5)
    np.testing.assert_array_equal(names, [0, 5])
    np.testing.assert_allclose(found.w, [0.8, 0.9])
    np.testing.assert_allclose(found.m, [[8, 0, 1, 0], [1, 0, 1, 0]], atol=0.02)
    np.testing.assert_allclose(found.P, np.broadcast_to(0.05**2 * np.eye(4), (2, 4, 4)), atol=1e-3)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_k_means_is_the_best_partition_of_a_few_particles(n):
    """Against every assignment of seven weighted points to n clusters."""
    rng = np.random.default_rng(n)
    x, w = rng.standard_normal((7, 2)), rng.random(7)

    def cost(of):
        return sum(np.sum(w[of == c] @ (x[of == c] - np.average(x[of == c], axis=0, weights=w[of == c])) ** 2) for c in np.unique(of))

    every = np.array(np.meshgrid(*[range(n)] * 7)).reshape(7, -1).T
    assert min(cost(k_means(np.random.default_rng(s), x, w, n)) for s in range(4)) == pytest.approx(min(map(cost, every)))


def test_clusters_are_as_many_as_the_weights_round_to():
    two = cloud(([1, 0, 1, 0], 0.9, 0), ([4, 0, 4, 0], 1.2, 0))
    found = clustered(np.random.default_rng(0), two, [0, 2])
    np.testing.assert_allclose(sorted(found.w), [0.9, 1.2])
    np.testing.assert_allclose(found.m[np.argsort(found.w)][:, 0], [1, 4], atol=0.02)
    assert len(clustered(np.random.default_rng(0), cloud(([0, 0, 0, 0], 0.4, 0)), [0, 2]).w) == 0
    same = Cloud(np.log(np.full(3, 0.9)), np.ones((3, 4)), np.zeros(3, np.int64))
    assert len(clustered(np.random.default_rng(0), same, [0, 2]).w) == 1
