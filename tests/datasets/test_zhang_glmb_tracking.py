"""Five sources on one vector sensor: what docs/results.md says of the tracks."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from direction_targets import drawn, snapshots

from sonobench import Study
from sonobench.components import build
from sonobench.pipeline import Pipeline, scans_of, track
from sonobench.registry import Registry
from sonobench.scene import Scene
from sonobench.testing import fixtures
from sonobench.types import Estimate, Scan, Space, Truth
from sonobench_plugins.front_end.avs import Avs
from sonobench_plugins.metric.fragmentation import Fragmentation
from sonobench_plugins.metric.label_switches import LabelSwitches
from sonobench_plugins.metric.ospa_direction import OspaDirection

REGISTRY = Registry.load()
GATE_RAD = np.radians(10.0)


def pipeline(name: str) -> Pipeline:
    return build("pipeline", Study.load("zhang-glmb-five").pipelines[name], REGISTRY)


def five(built: Pipeline, seed: int) -> tuple[Truth, list[Estimate]]:
    """Truth and estimates of a rendering of the scene."""
    scene = Scene.load("zhang-glmb-five", REGISTRY)
    rendering = build("simulator", scene.simulator, REGISTRY).simulate(scene, seed)
    recording = fixtures.MemoryRecording(rendering.header, tuple(rendering.blocks))
    setup, scans = scans_of(built.front_end, recording)
    return rendering.truth, track(built.tracker, setup, scans, np.random.default_rng(seed))


def judged(truth: Truth, estimates: list[Estimate], space: Space) -> tuple[float, float, int, float]:
    """Mean OSPA (degrees), label switches, labels reported, labels that never were near a target."""
    ospa = OspaDirection(p=1.0, c_deg=5.0).evaluate(truth, estimates, space)[""].values.mean()
    switches = LabelSwitches(c_m=GATE_RAD).evaluate(truth, estimates, space)[""].values.sum()
    strays = Fragmentation(c_m=GATE_RAD).evaluate(truth, estimates, space)["strays"].values.sum()
    return ospa, switches, len({int(n) for e in estimates for n in e.labels}), strays


def drawn_run(built: Pipeline, seed: int, n: int, least_deg: tuple[float, float], frames: int) -> tuple[Truth, list[Estimate]]:
    """Truth and estimates of drawn sources, without a recording."""
    assert isinstance(built.front_end, Avs)
    assert built.front_end.spectrum is not None
    rng = np.random.default_rng([seed, int(least_deg[0])])
    truth = drawn(rng, n, *least_deg, frames)
    fields = [built.front_end.spectrum.fields(snapshots(rng, truth, k))[0] for k in range(frames)]
    scans = [Scan(float(t), np.zeros(1, bool), (), {"spectrum": one}) for t, one in zip(truth.time_s, fields, strict=True)]
    setup = dataclasses.replace(fixtures.setup("directions"), period_s=1.0)
    return truth, track(built.tracker, setup, scans, np.random.default_rng(seed))


def test_three_sources_are_three_labels_on_cumulants_and_not_on_covariances() -> None:
    runs = [drawn_run(pipeline(name), 1, 3, (50, 70), 12) for name in ("cum-glmb", "cov-glmb")]
    (ospa, switches, labels, strays), (worse, *_) = (judged(*run, pipeline("cum-glmb").tracker.space) for run in runs)
    assert ospa <= 2.0  # nobody is reported in the first two frames, which cost 5 each
    assert (switches, labels, strays) == (0, 3, 0)
    assert worse > ospa + 1


@pytest.mark.study
def test_over_twenty_seeds_cumulants_follow_five_sources_and_covariances_fail() -> None:
    for name in ("cum-glmb", "cum-enumerated", "cum-one-model"):
        built = pipeline(name)
        found = np.array([judged(*five(built, seed), built.tracker.space) for seed in range(20)])
        print(name, "OSPA, switches, labels, strays", found.mean(axis=0).round(3), "five labels", np.mean(found[:, 2] == 5))
        assert found[:, 0].mean() <= 1.6
        assert found[:, 1].sum() == 0
        assert np.mean(found[:, 2] == 5) >= 0.7
        assert found[:, 3].mean() <= 0.2
    built = pipeline("cov-glmb")
    assert np.mean([judged(*five(built, seed), built.tracker.space)[0] for seed in range(4)]) > 4


@pytest.mark.study
@pytest.mark.parametrize(
    ("name", "low", "high", "most"),
    [
        ("cum-glmb", 35, 50, 3.5),
        ("cum-glmb", 20, 35, 4.0),
        ("cum-glmb", 10, 20, 4.0),
        ("gls-glmb", 35, 50, 2.0),
        ("gls-glmb", 20, 35, 2.8),
        ("gls-glmb", 10, 20, 3.3),
    ],
)
def test_random_scenes_by_least_separation(name: str, low: float, high: float, most: float) -> None:
    built = pipeline(name)
    found = np.array([judged(*drawn_run(built, seed, 5, (low, high), 25), built.tracker.space) for seed in range(20)])
    print(f"{name} {low}-{high}°: OSPA, switches, labels, strays", found.mean(axis=0).round(2), "five labels", np.mean(found[:, 2] == 5))
    assert found[:, 0].mean() <= most
