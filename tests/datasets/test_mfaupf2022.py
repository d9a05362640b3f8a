"""The bundled studies of the paper on a multi-feature adaptive unscented particle filter (2022): they plan, and differ where they say."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sonobench import Study
from sonobench.components import build
from sonobench.pipeline import Pipeline
from sonobench.registry import Registry
from sonobench.scene import Scene
from sonobench.scene.truth import truth_of
from sonobench_plugins.tracker.particle_filter import ParticleFilter

REGISTRY = Registry.load()
STUDIES = ["mfaupf2022-paths", "mfaupf2022-t60", "mfaupf2022-snr", "mfaupf2022-office", "mfaupf2022-random", "mfaupf2022-tuning"]
CLIP = "p_scene.sources.talker.sound.clip"


@functools.cache
def study_of(name: str) -> Study:
    return Study.load(name)


def entry(name: str) -> Pipeline:
    return build("pipeline", study_of("mfaupf2022-paths").pipelines[name], REGISTRY)


@pytest.mark.parametrize("name", STUDIES)
def test_every_scene_pipeline_and_metric_builds(name: str) -> None:
    study = study_of(name)
    assert len(study.plan().trials) >= len(study.scenes) * study.repetitions * len(study.pipelines)


@pytest.mark.parametrize(
    ("scene", "corners"),
    [
        ("mfaupf2022-turn", [(0.0, 1.0, 1.0), (1.6 / 0.989011, 1.0, 2.6), (5.6 / 0.989011, 5.0, 2.6), (7.28, 5.0, 1.0)]),
        ("mfaupf2022-arc", [(0.0, 1.0, 2.5), (3.64, 3.0, 0.5), (7.28, 5.0, 2.5)]),
    ],
)
def test_paths_are_those_of_the_paper(scene: str, corners: list[tuple[float, float, float]]) -> None:
    truth = truth_of(Scene.load(scene, REGISTRY))
    for time_s, x, y in corners:
        k = abs(truth.time_s - time_s).argmin()
        assert truth.position[k, 0, :2] == pytest.approx((x, y), abs=0.05)


def voices(study: Study) -> set[str]:
    swept = [v for key, values in study.sweep.items() if key[-1] == "clip" for v in values]
    return set(swept) or {Scene.load(s, REGISTRY).table["sources"]["talker"]["sound"]["clip"] for s in study.scenes}


def test_nothing_was_tuned_on_what_is_measured() -> None:
    tuned = study_of("mfaupf2022-tuning")
    for name in set(STUDIES) - {"mfaupf2022-tuning"}:
        study = study_of(name)
        assert not set(tuned.scenes) & set(study.scenes)
        assert not voices(tuned) & voices(study), name
        assert study.seed not in (0, tuned.seed)


def test_entries_of_the_paths_differ_by_one_part_from_mfacv() -> None:
    base = entry("mfacv")
    assert isinstance(base.tracker, ParticleFilter)
    for name in ("mfal", "mfarw"):
        assert dataclasses.replace(entry(name).tracker, motion=base.tracker.motion) == base.tracker  # type: ignore[type-var]
    for name in ("mfal", "mfarw", "mfaupf", "mfacv-no-floor", "mfacv-floor-1", "mfacv-one-candidate"):
        assert entry(name).front_end == base.front_end
    assert entry("mfaupf").tracker == dataclasses.replace(base.tracker, proposal="unscented")
    for name, part in (
        ("mfacv-no-floor", {"floor": 0.0}),
        ("mfacv-floor-1", {"floor": 0.1}),
        ("mfacv-one-candidate", {"delays": "selected"}),
    ):
        likelihood = dataclasses.replace(base.tracker.likelihood, **part)  # type: ignore[type-var]
        assert entry(name).tracker == dataclasses.replace(base.tracker, likelihood=likelihood)
    assert entry("mfacv-frequencies").tracker == base.tracker


def test_entries_of_the_random_walks_differ_by_one_part_from_the_best() -> None:
    study = study_of("mfaupf2022-random")
    best = study.pipelines["best"]
    for name in set(study.pipelines) - {"best", "mfacv", "mfaupf", "tbd"}:
        assert len(differing(best, study.pipelines[name])) == 1, name


def differing(one: object, other: object, path: tuple[str, ...] = ()) -> set[tuple[str, ...]]:
    """Paths of components and values in which two tables differ; a component of another kind is one."""
    if not (isinstance(one, Mapping) and isinstance(other, Mapping)) or one.get("use") != other.get("use"):
        return set() if one == other else {path}
    return {p for key in {*one, *other} for p in differing(one.get(key), other.get(key), (*path, key))}


@pytest.mark.study
def test_errors_and_lost_runs_on_the_paths(tmp_path: Path) -> None:
    """60 paired runs a path, over three voices; ratios are geometric means with 95 % over the runs."""
    only = ("mfacv", "mfaupf", "mfarw", "mfacv-no-floor", "mfacv-floor-1", "best")
    run = Study.load("mfaupf2022-paths", only=only).run(out=tmp_path / "run")
    assert run.failed == 0, run.trials[["status", "exc_message"]].drop_duplicates()
    rows = run.scores[run.scores["metric"] == "run-error"].merge(run.trials, on="trial_key")
    error = rows.pivot_table(index=["scene", CLIP, "repetition"], columns="pipeline", values="value")
    print(error.groupby(level=[0, 1]).median().round(3).to_string())
    for scene, median in (("mfaupf2022-arc", 0.06), ("mfaupf2022-turn", 0.12)):
        here = error.loc[scene]
        assert len(here) == 60
        assert here["mfacv"].median() <= median
        assert (here["mfacv"] > 0.6).mean() <= 0.2
        assert here["mfaupf"].median() <= 1.3 * here["mfacv"].median()
        for name in ("mfacv", "mfaupf"):
            assert ratio(here["mfarw"], here[name])[0] > 1
        assert here["mfacv-no-floor"].median() >= 2 * here["mfacv-floor-1"].median()
        assert ratio(here["best"], here["mfacv"])[1] < 1
    clear = error[
        error.index.get_level_values(CLIP) != "librivox-male-2"
    ]  # its bins are the fewest above the noise: docs/papers/mfaupf2022.md
    assert (clear[["mfacv", "mfaupf", "best"]] <= 0.6).all(axis=None)


def ratio(one: pd.Series, other: pd.Series) -> tuple[float, float]:
    """95 % interval of the geometric mean of one / other, run by run."""
    log = np.log(one / other)
    half = 1.96 * log.std(ddof=1) / np.sqrt(len(log))
    return float(np.exp(log.mean() - half)), float(np.exp(log.mean() + half))
