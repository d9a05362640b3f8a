"""Four pairs (section 5.3 of Liang 2016) and track before detect: what their scenes, pipelines and studies are and show."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from sonobench import Registry, Scene, Setup, Study
from sonobench.components import build
from sonobench.pipeline import track
from sonobench.scene.truth import truth_of
from sonobench.types import Detections, Scan
from sonobench_plugins.metric.ospa import Ospa

REGISTRY = Registry.load()
OSPA = "ospa"


def tracker_of(entry: str) -> Any:
    table = {e.name: e.table for e in Study.load("liang2016-pairs-scans").plan().entries}[entry]
    return build("tracker", table["tracker"], REGISTRY)


def scores(name: str, folder: Path, metric: str) -> pd.DataFrame:
    """A metric's values by swept value and repetition (rows) and pipeline (columns) of a study whose every trial is ok."""
    run = Study.load(name).run(out=folder / name)
    assert run.failed == 0, run.trials[["status", "exc_message"]].drop_duplicates()
    swept = [c for c in run.trials.columns if c.startswith("p_scene.")]
    rows = run.scores[run.scores["metric"] == metric].merge(run.trials[["trial_key", "pipeline", "repetition", *swept]], on="trial_key")
    return rows.pivot_table(index=[*swept, "repetition"], columns="pipeline", values="value")


@pytest.mark.parametrize("name", ["liang2016-pairs", "liang2016-pairs-scans"])
def test_the_targets_exist_in_the_printed_frames_and_begin_at_the_printed_places(name: str) -> None:
    truth = truth_of(Scene.load(name, REGISTRY))
    frames = np.round(truth.time_s / 0.128).astype(int)
    np.testing.assert_array_equal(frames[truth.exists[:, 0]], np.arange(1, 31))
    np.testing.assert_array_equal(frames[truth.exists[:, 1]], np.arange(21, 46))
    for target, (k, start) in enumerate([(0, [1.0, 1.0]), (20, [2.5, 0.5])]):
        assert np.linalg.norm(truth.position[k, target, :2] - start) < 0.2 * 0.128 + 1e-6


def test_the_source_of_the_single_pair_comes_and_goes() -> None:
    truth = truth_of(Scene.load("liang2016-tbd", REGISTRY))
    frames = np.round(truth.time_s / 0.128).astype(int)
    np.testing.assert_array_equal(frames[truth.exists[:, 0]], np.arange(9, 51))


@pytest.mark.parametrize(("measured", "tuning"), [("liang2016-pairs", "liang2016-tuning-pairs"), ("liang2016-tbd", "liang2016-tuning-tbd")])
def test_parameters_are_chosen_on_other_walks_times_and_voices(measured: str, tuning: str) -> None:
    a, b = (Scene.load(name, REGISTRY).table["sources"] for name in (measured, tuning))
    for one in a.values():
        for other in b.values():
            assert one["trajectory"]["seed"] != other["trajectory"]["seed"]
            assert one["trajectory"]["start_m"] != other["trajectory"]["start_m"]
            assert one["intervals"] != other["intervals"]
            assert one["sound"].get("clip", "one") != other["sound"].get("clip", "another")


@pytest.mark.parametrize("name", ["liang2016-pairs", "liang2016-pairs-scans", "liang2016-tbd"])
def test_a_study_is_planned_with_at_least_sixteen_renderings(name: str) -> None:
    study = Study.load(name)
    assert study.plan().trials
    assert study.repetitions >= 16


def test_the_printed_numbers_are_those_of_both_updates() -> None:
    for name in ("liang2016-ms-iterated", "liang2016-ms-joint"):
        tracker = {e.name: e.table for e in Study.load("liang2016-pairs").plan().entries}[name]["tracker"]
        assert (tracker["particles"], tracker["born_particles"], tracker["birth"]["weight"], tracker["p_s"]) == (500, 100, 0.05, 0.99)
        assert tracker["measurement"]["p_d"] == 1 - 0.25


def rendered(seed: int, scans: int) -> tuple[Setup, list[Scan], Any]:
    made = Scene.load("liang2016-pairs-scans", REGISTRY).simulate(seed)
    return Setup.from_header(made.header, made.header.sensors, made.header.period_s), list(made.scans)[:scans], made.truth


def test_all_pairs_at_once_find_targets_that_one_after_the_other_lose() -> None:
    error = {}
    for entry in ("ms-iterated", "ms-joint"):
        for seed in (1, 2):
            setup, scans, truth = rendered(seed, 30)
            tracker = tracker_of(entry)
            found = track(tracker, setup, scans, np.random.default_rng(seed))
            error[entry, seed] = np.mean(Ospa(c_m=1.0, p=2.0).evaluate(truth, found, tracker.space)[""].values[:30])
    for seed in (1, 2):
        assert error["ms-joint", seed] < error["ms-iterated", seed] - 0.05


def test_the_joint_update_does_not_ask_which_pair_comes_first() -> None:
    setup, scans, _ = rendered(3, 4)
    order = np.array([2, 0, 3, 1])
    to = np.argsort(order)  # where each sensor is now
    turned = dataclasses.replace(setup, sensors=tuple(setup.sensors[q] for q in order))
    moved = [Scan(s.time_s, s.searched[order], tuple(Detections(g.z, to[g.sensor]) for g in s.detections)) for s in scans]
    means = {}
    for entry in ("ms-joint", "ms-iterated"):
        tracker = tracker_of(entry)
        means[entry] = [
            np.array([e.count for e in track(tracker, a, b, np.random.default_rng(0))], float) for a, b in ((setup, scans), (turned, moved))
        ]
    np.testing.assert_allclose(means["ms-joint"][0], means["ms-joint"][1], rtol=1e-3)
    assert not np.allclose(means["ms-iterated"][0], means["ms-iterated"][1], rtol=1e-3)


@pytest.mark.study
def test_joint_beats_iterated_without_sound_at_every_clutter(tmp_path: Path) -> None:
    found = scores("liang2016-pairs-scans", tmp_path, OSPA)
    difference = (found["ms-joint"] - found["ms-iterated"]).groupby(level=0)
    assert (difference.mean() + 3 * difference.sem() < -0.05).all(), difference.mean()


@pytest.mark.study
def test_track_before_detect_halves_the_median_error_of_the_detecting_filters(tmp_path: Path) -> None:
    found = scores("liang2016-tbd", tmp_path, "position-error.median").groupby(level=0).mean()
    loud = found[found.index >= 5]
    for peer in ("liang2016-md-phat", "liang2016-md-tuned"):
        assert (loud["liang2016-tbd"] <= 0.5 * loud[peer]).all(), loud
    assert (loud["liang2016-md-phat"] <= 0.10).all()
