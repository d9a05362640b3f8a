"""The images of a box: how many, how strong, which may go."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from sonobench.acoustics.fractional_delay import windowed_sinc
from sonobench.acoustics.image_sources import build_lattice, free_field
from sonobench.acoustics.path_render import LEAD, impulse_responses

BOX = np.array([3.0, 2.8, 2.5])
WALLS = np.array([0.85, 0.6, 0.25, 0.7, 0.4, -0.3])
BOX.flags.writeable = WALLS.flags.writeable = False


def images_of(lattice, source):
    """(i, 4) x, y, z and amplitude of each image that a lattice keeps."""
    rows = []
    for ix, iy, first, end in lattice.runs:
        for iz in range(first, end):
            at = [lattice.sign[a, i] * source[a] + lattice.offset_m[a, i] for a, i in enumerate((ix, iy, iz))]
            rows.append([*at, lattice.amplitude[0, ix] * lattice.amplitude[1, iy] * lattice.amplitude[2, iz]])
    return np.array(rows)


def mirrored(source, order):
    """The same by mirroring at walls, image after image: {(x, y, z) rounded: amplitude}."""
    found = {tuple(np.round(source, 9)): 1.0}
    front = dict(found)
    for _ in range(order):
        new = {}
        for (at, a), (axis, side) in itertools.product(front.items(), itertools.product(range(3), range(2))):
            image = list(at)
            image[axis] = round(2 * side * BOX[axis] - image[axis], 9)
            new.setdefault(tuple(image), a * WALLS[2 * axis + side])
        front = {at: a for at, a in new.items() if at not in found}
        found |= front
    return found


@pytest.mark.parametrize(("order", "count"), [(0, 1), (1, 7), (10, 1561), (17, 7175), (40, 88641)])
def test_number_of_images_per_order_is_the_closed_form(order, count):
    assert count == (2 * order + 1) * (2 * order**2 + 2 * order + 3) // 3
    assert build_lattice(BOX, WALLS, order, -math.inf).images == count


def test_images_are_those_of_repeated_mirroring_at_the_walls():
    source = np.array([0.7, 1.9, 1.1])
    expected = mirrored(source, 4)
    got = {tuple(np.round(row[:3], 9)): row[3] for row in images_of(build_lattice(BOX, WALLS, 4, -math.inf), source)}
    assert got.keys() == expected.keys()
    assert all(got[at] == pytest.approx(expected[at], rel=1e-12) for at in expected)


def test_absorbing_walls_leave_the_source_alone():
    lattice = build_lattice(BOX, np.zeros(6))
    assert lattice.images == free_field().images == 1
    np.testing.assert_array_equal(images_of(lattice, [1.0, 2.0, 2.2]), [[1.0, 2.0, 2.2, 1.0]])


@pytest.mark.parametrize("prune_db", [-50.0, -70.0])
@pytest.mark.parametrize("walls", [(0.85, 0.85, 0.25, 0.25, 0.25, 0.25), (0.6, 0.6, 0.6, 0.6, 0.6, 0.6), (0.9, 0.2, 0.9, 0.2, 0.5, 0.5)])
def test_what_is_pruned_stays_below_the_stated_level_for_every_position(walls, prune_db):
    rng = np.random.default_rng(3)
    positions, mics = rng.uniform(0.05, BOX - 0.05, (12, 3)), rng.uniform(0.05, BOX - 0.05, (2, 3))
    whole, pruned = build_lattice(BOX, walls, 30, -math.inf), build_lattice(BOX, walls, 30, prune_db)
    a, b = (impulse_responses(lattice, positions, mics, 8000.0, 343.0, 6000).astype(float) for lattice in (whole, pruned))
    error = 10 * np.log10(((a - b) ** 2).sum(axis=-1) / (a**2).sum(axis=-1))
    assert pruned.images < whole.images / 2
    assert error.max() <= prune_db


def test_without_an_order_pruning_alone_ends_the_response():
    walls = np.full(6, 0.6)
    rng = np.random.default_rng(4)
    positions, mics = rng.uniform(0.1, BOX - 0.1, (5, 3)), rng.uniform(0.1, BOX - 0.1, (2, 3))
    whole, pruned = build_lattice(BOX, walls, 40, -math.inf), build_lattice(BOX, walls, prune_db=-60.0)
    a, b = (impulse_responses(lattice, positions, mics, 8000.0, 343.0, 6000).astype(float) for lattice in (whole, pruned))
    assert (10 * np.log10(((a - b) ** 2).sum(axis=-1) / (a**2).sum(axis=-1))).max() <= -60.0


def test_no_image_lies_beyond_the_reach():
    lattice = build_lattice(BOX, WALLS, 12)
    rng = np.random.default_rng(5)
    for source, mic in rng.uniform(0, BOX, (20, 2, 3)):
        assert np.linalg.norm(images_of(lattice, source)[:, :3] - mic, axis=1).max() <= lattice.reach_m


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"box_m": [3, 0, 2], "reflections": WALLS}, "lengths above 0"),
        ({"box_m": [3, np.nan, 2], "reflections": WALLS}, "lengths above 0"),
        ({"box_m": BOX, "reflections": [1.1, 0, 0, 0, 0, 0]}, r"\[-1, 1\]"),
        ({"box_m": BOX, "reflections": [np.nan, 0, 0, 0, 0, 0]}, r"\[-1, 1\]"),
        ({"box_m": BOX, "reflections": WALLS[:4]}, "reflections has shape"),
        ({"box_m": BOX, "reflections": np.ones(6)}, "give max_order"),
        ({"box_m": BOX, "reflections": np.full(6, 0.999)}, "max_order"),
        ({"box_m": BOX, "reflections": [0.99999, 0.99999, 0, 0, 0, 0]}, "max_order"),
        ({"box_m": BOX, "reflections": WALLS, "max_order": 400, "prune_db": -math.inf}, "max_order"),
        ({"box_m": BOX, "reflections": WALLS, "max_order": -1}, "is the least"),
        ({"box_m": BOX, "reflections": WALLS, "prune_db": 3.0}, "below 0"),
    ],
)
def test_impossible_rooms_are_refused_with_a_remedy(arguments, said):
    with pytest.raises(ValueError, match=said):
        build_lattice(**arguments)


def test_responses_are_the_sum_of_the_images():
    source, mic = np.array([0.7, 1.9, 1.1]), np.array([2.2, 0.4, 1.6])
    lattice = build_lattice(BOX, WALLS, 6, -math.inf)
    images = images_of(lattice, source)
    d = np.linalg.norm(images[:, :3] - mic, axis=1)
    n = np.arange(1500) - LEAD
    expected = (windowed_sinc(n - d[:, None] / 343.0 * 16000.0) * (images[:, 3] / (4 * np.pi * d))[:, None]).sum(axis=0)
    got = impulse_responses(lattice, source[None], mic[None], 16000.0, 343.0, 1500)[0, 0]
    assert np.linalg.norm(got - expected) <= 3e-5 * np.linalg.norm(expected)
