"""Rendering of vector sensors: five sources over 50 s at 10 kHz as snapshots, and what three more channels cost the image method."""

import numpy as np
import pytest

from sonobench.acoustics.image_sources import build_lattice
from sonobench.acoustics.path_render import impulse_responses
from sonobench.acoustics.vector_responses import vector_responses
from sonobench.registry import Registry
from sonobench.scene import Scene
from sonobench.types import read_only


@pytest.mark.parametrize("held", [True, False])
def test_five_sources_over_50_s(benchmark, held):
    scene = Scene.load("zhang-glmb-five", Registry.load(), {"simulator": {"held": held}})
    benchmark.pedantic(scene.simulate, args=(1,), rounds=3, warmup_rounds=1)


@pytest.mark.parametrize("respond", [impulse_responses, vector_responses])
def test_responses_of_a_room(benchmark, respond):
    lattice = build_lattice([5.0, 4.0, 3.0], np.full(6, 0.8), max_order=15)
    at, sensor = read_only([[1.0, 1.2, 1.4]]), read_only([[3.9, 2.9, 1.7]])
    benchmark.pedantic(respond, args=(lattice, at, sensor, 16000.0, 343.0, 8000), rounds=5, warmup_rounds=1)
