"""The bundled study of labelled trackers: it plans as described; what docs/results.md says of the δ-GLMB filter holds."""

from __future__ import annotations

import numpy as np
import pytest

from sonobench import Study
from sonobench.components import build
from sonobench.pipeline import Pipeline
from sonobench.registry import Registry
from sonobench.scene import Scene
from sonobench.types import Array, Estimate, Setup, Truth
from sonobench_plugins.metric.label_switches import LabelSwitches
from sonobench_plugins.metric.ospa2 import Ospa2

REGISTRY = Registry.load()


def runs(name: str, seeds: range) -> list[tuple[Truth, list[Estimate], Pipeline]]:
    """Truth, estimates and the pipeline of a bundled pipeline on the scene, a seed each."""
    scene, pipeline = Scene.load("labelled-linear", REGISTRY), Study.load("labelled").pipelines[name]
    built = build("pipeline", pipeline, REGISTRY)
    found = []
    for seed in seeds:
        rendering = build("simulator", scene.simulator, REGISTRY).simulate(scene, seed)
        header = rendering.header.offering(built.given)
        setup = Setup.from_header(header, header.sensors, header.period_s)
        rng = np.random.default_rng(seed)
        state, estimates = built.tracker.init(rng, setup), []
        for scan in rendering.scans:
            state, estimate = built.tracker.step(rng, state, scan)
            estimates.append(estimate)
        found.append((rendering.truth, estimates, built))
    return found


def miscounts(truth: Truth, estimates: list[Estimate], settled: int) -> Array:
    """|n̂ − n| in the frames from `settled` after each change on."""
    n = truth.exists.sum(axis=1)
    changes = np.flatnonzero(np.concatenate([[True], np.diff(n) != 0]))
    since = np.array([k - changes[changes <= k].max() for k in range(len(n))])
    return np.abs(np.array([len(e.states) for e in estimates]) - n)[since >= settled].astype(float)


def test_the_study_compares_labelled_trackers_on_equal_models() -> None:
    study = Study.load("labelled")
    assert study.repetitions >= 20
    assert {"delta-glmb", "lmb", "smc-phd", "cbmember"} <= set(study.pipelines)


def test_six_targets_are_followed_under_their_labels() -> None:
    ((truth, estimates, built),) = runs("delta-glmb", range(1))
    assert miscounts(truth, estimates, 10).mean() <= 0.2
    switches = LabelSwitches(c_m=50.0).evaluate(truth, estimates, built.tracker.space)
    assert switches[""].values.sum() == 0


@pytest.mark.study
def test_the_delta_glmb_is_no_worse_than_the_labelled_particle_phd_and_counts_right() -> None:
    seeds, metric = range(20), Ospa2(c_m=100.0, window_s=10.0)
    ours, theirs = runs("delta-glmb", seeds), runs("smc-phd", seeds)
    errors = [[metric.evaluate(t, e, b.tracker.space)[""].values.mean() for t, e, b in side] for side in (ours, theirs)]
    difference = np.subtract(*errors)
    assert difference.mean() + 2 * difference.std(ddof=1) / np.sqrt(len(difference)) < 0
    assert np.mean([miscounts(t, e, 10).mean() for t, e, _ in ours]) <= 0.1
    switches = [LabelSwitches(c_m=50.0).evaluate(t, e, b.tracker.space)[""].values for t, e, b in ours]
    assert np.mean(switches) <= 0.1
