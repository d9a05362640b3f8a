"""The image-method simulator, against pyroomacoustics and by itself."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from sonobench.acoustics.image_sources import build_lattice
from sonobench.acoustics.path_render import LEAD, impulse_responses
from sonobench.components import build
from sonobench.errors import InputError, TableError
from sonobench.protocols import Simulator
from sonobench.registry import Registry
from sonobench.scene import Scene
from sonobench.types import identical
from sonobench_plugins.simulator.image_method import ImageMethod


@pytest.fixture(scope="module")
def registry():
    return Registry.load([])


def scene_of(registry, simulator="image-method", **overrides):
    table = {
        "name": "corner",
        "simulator": simulator,
        "duration_s": 1.2,
        "rate_hz": 8000.0,
        "room": {"size_m": [3.0, 3.0, 2.5], "reflections": [0.85, 0.8, 0.25, 0.4, 0.6, 0.1]},
        "arrays": {"wall": {"elements_m": [[0.1, 1.4, 1.5], [0.1, 1.6, 1.5]], "pairs": [[0, 1]]}},
        "sources": {
            "anna": {
                "sound": {"use": "white"},
                "trajectory": {"use": "line", "from_m": [1.0, 1.0, 1.5], "to_m": [2.0, 2.0, 1.5], "speed_m_s": 1.0},
                "intervals": [[0.1, 0.8]],
            }
        },
    }
    return Scene.from_table({**table, **overrides}, registry)


def samples(rendering):
    return np.concatenate([block.samples for block in rendering.blocks]).astype(float)


def away(a, b):
    return np.linalg.norm(a - b) / np.linalg.norm(b)


def pra_responses(box, walls, order, positions, mics, rate_hz):
    """(k, M) responses of pyroomacoustics, its high-pass off, with the 1 / (4 pi) that it leaves out."""
    pra = pytest.importorskip("pyroomacoustics")
    names = ("west", "east", "south", "north", "floor", "ceiling")
    before = pra.constants.get("rir_hpf_enable")
    pra.constants.set("rir_hpf_enable", False)
    try:
        materials = {n: pra.Material(energy_absorption=1 - w * w) for n, w in zip(names, walls, strict=True)}
        room = pra.ShoeBox(box, fs=rate_hz, materials=materials, max_order=order)
        room.set_sound_speed(343.0)
        room.add_microphone_array(np.array(mics).T)
        for position in positions:
            room.add_source(position)
        room.compute_rir()
    finally:
        pra.constants.set("rir_hpf_enable", before)
    return [[np.asarray(room.rir[m][k]) / (4 * np.pi) for m in range(len(mics))] for k in range(len(positions))]


@pytest.mark.parametrize("order", [1, 10, 17])
def test_responses_agree_with_pyroomacoustics(order):
    box, walls = np.array([3.0, 3.0, 2.5]), (0.85, 0.8, 0.25, 0.4, 0.6, 0.1)
    rng = np.random.default_rng(7)
    positions, mics = rng.uniform(0.3, box - 0.3, (10, 3)), rng.uniform(0.3, box - 0.3, (2, 3))
    theirs = pra_responses(box, walls, order, positions, mics, 8000)
    length = max(len(r) for row in theirs for r in row) + 40
    ours = impulse_responses(build_lattice(box, walls, order), positions, mics, 8000.0, 343.0, length)
    late = 40 - LEAD  # their responses begin 40 samples before time zero, ours LEAD
    padded = np.array([[np.pad(r, (0, length - len(r))) for r in row] for row in theirs])
    assert away(ours[..., : length - late], padded[..., late:]) <= 3e-3


def test_it_is_a_simulator_that_can_be_built_pickled_and_printed(registry):
    component = build(Simulator, {"use": "image-method", "max_order": 3}, registry, "here:")
    assert component == ImageMethod(max_order=3) == pickle.loads(pickle.dumps(component))
    assert "max_order=3" in repr(component)


def test_the_same_seed_gives_the_same_bits_and_another_seed_others(registry):
    scene = scene_of(registry)
    a, b, c = scene.simulate(3), scene.simulate(3), scene.simulate(4)
    assert identical(tuple(a.blocks), tuple(b.blocks))
    assert identical(a.truth, b.truth)
    assert not identical(tuple(a.blocks), tuple(c.blocks))


def test_walls_without_reflection_are_free_field(registry):
    size = [3.0, 3.0, 2.5]
    dead = samples(scene_of(registry, room={"size_m": size, "reflections": [0.0] * 6}).simulate(1))
    free = {k: v for k, v in scene_of(registry).table.items() if k != "room"}
    assert away(dead, samples(Scene.from_table(free, registry).simulate(1))) <= 1e-6


def test_pruning_changes_the_recording_by_less_than_it_says(registry):
    whole = samples(scene_of(registry, {"use": "image-method", "prune_db": -110.0}).simulate(1))
    for prune_db in (-40.0, -70.0):
        pruned = samples(scene_of(registry, {"use": "image-method", "prune_db": prune_db}).simulate(1))
        assert 20 * np.log10(away(pruned, whole)) <= prune_db


def test_halving_the_path_step_changes_little(registry):
    coarse = samples(scene_of(registry).simulate(1))
    fine = samples(scene_of(registry, {"use": "image-method", "path_step_m": 0.005}).simulate(1))
    assert 20 * np.log10(away(coarse, fine)) <= -60.0


def test_nearly_lossless_walls_are_refused_with_the_scenes_name(registry):
    scene = scene_of(registry, room={"size_m": [3.0, 3.0, 2.5], "reflections": [0.9995] * 6})
    with pytest.raises(InputError, match=r"corner.*max_order"):
        scene.simulate(1)


@pytest.mark.parametrize("field", [{"max_order": -1}, {"prune_db": 0.0}, {"prune_db": float("nan")}, {"path_step_m": 0.0}])
def test_impossible_parameters_are_refused(registry, field):
    with pytest.raises(TableError, match=next(iter(field))):
        scene_of(registry, {"use": "image-method", **field})


def test_isolated_recordings_without_noise_add_up_to_the_mixed_one(registry):
    table = {**scene_of(registry).table["sources"]}
    table["carlo"] = {"sound": {"use": "pink"}, "trajectory": {"use": "still", "position_m": [2.0, 1.0, 1.2]}}
    mixed = scene_of(registry, sources=table).simulate(2)
    apart = scene_of(registry, {"use": "image-method", "isolated": True}, sources=table).simulate(2)
    heard = {a.name: np.concatenate([b.samples for b in apart.blocks if b.array == a.name]) for a in apart.header.arrays}
    assert list(heard) == ["wall/anna", "wall/carlo"]
    np.testing.assert_allclose(heard["wall/anna"] + heard["wall/carlo"], samples(mixed), atol=1e-6)
