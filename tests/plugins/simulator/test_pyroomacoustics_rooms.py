"""The pyroomacoustics simulator renders what ours renders."""

from __future__ import annotations

import numpy as np
import pytest

from sonobench.errors import InputError
from sonobench.registry import Registry
from sonobench.scene import Scene

pra = pytest.importorskip("pyroomacoustics")


@pytest.fixture(scope="module")
def registry():
    return Registry.load([])


def rendered(registry, simulator, **overrides):
    still = {"use": "still", "position_m": [2.2, 0.7, 1.1]}
    line = {"use": "line", "from_m": [1.0, 1.0, 1.5], "to_m": [1.5, 1.5, 1.5], "speed_m_s": 1.0}
    table = {
        "name": "corner",
        "simulator": simulator,
        "duration_s": 0.8,
        "rate_hz": 8000.0,
        "room": {"size_m": [3.0, 3.0, 2.5], "reflections": [0.85, 0.8, 0.25, 0.4, 0.6, 0.1]},
        "arrays": {"wall": {"elements_m": [[0.1, 1.4, 1.5], [0.1, 1.6, 1.5]], "pairs": [[0, 1]]}},
        "sources": {
            "anna": {"sound": {"use": "pink"}, "trajectory": line, "intervals": [[0.1, 0.6]]},
            "bert": {"sound": {"use": "white"}, "trajectory": still, "intervals": [[0.0, 0.7]]},
        },
    }
    table = {k: v for k, v in {**table, **overrides}.items() if v is not None}
    rendering = Scene.from_table(table, registry).simulate(5)
    return np.concatenate([block.samples for block in rendering.blocks]).astype(float)


@pytest.mark.parametrize("room", ["box", None])
def test_both_image_methods_render_the_same_recording(registry, room):
    overrides = {} if room else {"room": None}
    ours = rendered(registry, {"use": "image-method", "max_order": 8, "prune_db": -80.0}, **overrides)
    theirs = rendered(registry, {"use": "pyroomacoustics", "max_order": 8}, **overrides)
    assert np.linalg.norm(ours - theirs) <= 5e-3 * np.linalg.norm(ours)  # −46 dB: their table of 20 sincs a sample


def test_its_global_settings_are_left_as_they_were(registry):
    before = {name: pra.constants.get(name) for name in ("rir_hpf_enable", "num_threads")}
    rendered(registry, {"use": "pyroomacoustics", "max_order": 1})
    assert {name: pra.constants.get(name) for name in before} == before


def test_rates_that_are_no_whole_numbers_are_refused_with_a_remedy(registry):
    with pytest.raises(InputError, match="use image-method"):
        rendered(registry, "pyroomacoustics", rate_hz=8000.5)
