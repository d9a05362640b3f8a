"""The shipped recording: every version reads it, and replays it to the same bits."""

from __future__ import annotations

import dataclasses
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sonobench import Registry, Scene, identical, open_recording, replay
from sonobench.components import build
from sonobench.log import Recording, write_recording

INPUT_SHA = "7677a859dc537d536ca25ec537045d803c08c9aba9e3022c99254a423eea4d45"
TRUTH_SHA = "c6cc2b593c1aeebbb2a47f122d56974bc1ba5e49a038ae0820691f88d0fbda94"
CONTENT_SHA = "fe11ea467561d139fc27f13abf7c260a5b16964b4c325d4a2933db1d25f26360"


@pytest.fixture(scope="module")
def registry() -> Registry:
    return Registry.load()


@pytest.fixture(scope="module")
def golden(registry: Registry) -> Recording:
    path = registry.find_data("recordings", "golden", ".mcap")
    assert path.stat().st_size <= 1.5e6
    return open_recording(path)


def test_its_content_is_what_was_written(golden: Recording) -> None:
    assert (golden.input_sha, golden.truth_sha, golden.content_sha) == (INPUT_SHA, TRUTH_SHA, CONTENT_SHA)
    assert sum(len(b.samples) for b in golden.blocks()) == 24000
    assert golden.truth.position.shape == (30, 2, 3)


def test_its_scene_still_renders_to_nearly_the_same_sound(golden: Recording, registry: Registry) -> None:
    again = Scene.load("golden", registry).simulate(1)
    old, new = (np.concatenate([b.samples for b in r.blocks]) for r in (_held(golden), again))
    assert np.linalg.norm(old - new) < 1e-3 * np.linalg.norm(old)
    assert identical(golden.truth, again.truth)


def test_a_renamed_copy_in_another_process_gives_the_same_bits(golden: Recording, tmp_path: Path) -> None:
    assert golden.path is not None
    for k, name in enumerate(("golden.mcap", "renamed copy.mcap")):
        folder = tmp_path / str(k)
        folder.mkdir()
        shutil.copy(golden.path, folder / name)
        environment = {**os.environ, "SONOBENCH_CACHE": str(folder / "cache"), "PYTHONHASHSEED": str(k)}
        command = [sys.executable, "-m", "sonobench", "replay", name, "--pipeline", "smc-phd", "-o", "out.mcap"]
        subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True)
    assert (tmp_path / "0/out.mcap").read_bytes() == (tmp_path / "1/out.mcap").read_bytes()


def test_scrambled_truth_changes_neither_what_a_pipeline_may_read_nor_its_estimates(registry: Registry, tmp_path: Path) -> None:
    rendering = Scene.load("golden", registry).simulate(5)
    truth = rendering.truth
    scrambled = dataclasses.replace(
        truth, position=truth.position[::-1] + 1.0, label=truth.label[::-1], exists=~truth.exists, active=~truth.exists
    )
    paths = [tmp_path / "true.mcap", tmp_path / "scrambled.mcap"]
    for path, held in zip(paths, (truth, scrambled), strict=True):
        write_recording(path, rendering._replace(truth=held))
    true, false = map(open_recording, paths)
    assert true.truth_sha != false.truth_sha
    assert true.input_sha == false.input_sha
    pipeline = build("pipeline", "smc-phd", registry)
    assert identical(replay(pipeline, true), replay(pipeline, false))


@pytest.mark.parametrize("pipeline", ["ck-phd", "ek-phd", "uk-phd", "smc-phd"])
def test_its_talkers_are_tracked(golden: Recording, registry: Registry, pipeline: str) -> None:
    from sonobench.scoring import score

    built = build("pipeline", pipeline, registry)
    estimates = replay(built, golden)
    metric = build("metric", {"use": "position-error"}, registry)
    scores = {row.metric: row.value for row in score(metric, golden.truth, estimates, built.tracker.space)}
    assert scores["position-error.median"] < 0.25
    assert scores["position-error.coverage"] > 0.5


class _held:
    def __init__(self, recording: Recording) -> None:
        self.blocks = list(recording.blocks())
