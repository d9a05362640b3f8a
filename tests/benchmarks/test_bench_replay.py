"""Replay of recordings through shipped pipelines, in times real time: decoding, front end and tracker apart, and all together.

The shipped recording `golden`, and one that is rendered of the main job's first scene (six pairs, 8 kHz, 8 s).
"""

from __future__ import annotations

import pytest
from bench_clock import in_turn, seconds

from sonobench import Registry, Scene, open_recording
from sonobench.components import build
from sonobench.log import write_recording
from sonobench.pipeline import generator, replay, scans_of, track


@pytest.fixture(scope="module")
def registry():
    return Registry.load()


@pytest.fixture(scope="module", params=["golden", "quickstart-1"])
def recording(request, registry, tmp_path_factory):
    """(recording on disk, seconds that rendering took or None)."""
    if request.param == "golden":
        return open_recording(registry.find_data("recordings", "golden", ".mcap")), None
    path = tmp_path_factory.mktemp("replay") / "quickstart-1.mcap"
    scene, made = Scene.load("quickstart-1", registry), []
    scene.simulate(1)  # compiles
    rendering_s = seconds(lambda: made.append(scene.simulate(0)))
    write_recording(path, made[0])
    return open_recording(path), rendering_s


@pytest.mark.parametrize("name", ["ck-phd", "ck-phd-pairs", "smc-phd"])
def test_replay_of_a_recording(benchmark, registry, recording, name):
    stored, rendering_s = recording
    pipeline = build("pipeline", name, registry, "bench")
    path, duration_s = stored.path, stored.header.duration_s
    setup, scans = scans_of(pipeline.front_end, stored)
    header, blocks = stored.header, list(stored.blocks())

    def decoding():
        fresh = open_recording(path)
        return fresh.header, sum(len(b.samples) for b in fresh.blocks())

    def front_end():
        _, state = pipeline.front_end.open(header)
        for block in blocks:
            state, _ = pipeline.front_end.step(state, block)
        pipeline.front_end.flush(state)

    def tracker():
        track(pipeline.tracker, setup, scans, generator("", 0))

    def whole():
        replay(pipeline, open_recording(path))

    parts = dict(
        zip(
            ("decoding", "front end", "tracker", "whole replay, hash of the input included"),
            in_turn(7, decoding, front_end, tracker, whole),
            strict=True,
        )
    )
    benchmark.pedantic(whole, rounds=3)
    benchmark.extra_info |= {f"{k} (times real time)": duration_s / s for k, s in parts.items()}
    benchmark.extra_info |= {
        "front end (ms a scan)": 1e3 * parts["front end"] / len(scans),
        "tracker (ms a scan)": 1e3 * parts["tracker"] / len(scans),
    }
    if rendering_s is not None:
        benchmark.extra_info["rendering (times real time)"] = duration_s / rendering_s
