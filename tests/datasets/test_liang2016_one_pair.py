"""One microphone pair and the echoes of two walls, section 5.5 of Liang 2016: what its scenes, pipelines and studies are and show."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache
from pathlib import Path

import echo_scans
import numpy as np
import pandas as pd
import pytest

from sonobench import Registry, Scene, Study
from sonobench.pipeline import track
from sonobench.scene.truth import truth_of
from sonobench.types import Array
from sonobench_plugins.birth.room import Room
from sonobench_plugins.measurement.tdoa_images import TdoaImages
from sonobench_plugins.metric.ospa import ospa
from sonobench_plugins.tracker.smc_phd import ParticlePhd

REGISTRY = Registry.load()
TUNING = "liang2016-tuning"
MEASURING = ("liang2016-one", "liang2016-one-std", "liang2016-two", "liang2016-two-tones", "liang2016-two-snr")
TUNING_STUDIES = (TUNING, "liang2016-tuning-pairs")
OSPA = "ospa[c_m=1.0,p=2.0]"
SOUNDS = ("white", "tones", "speech")


@cache
def study_of(name: str) -> Study:
    return Study.load(name)


@cache
def loaded(study: str) -> list[Scene]:
    """The scenes of a study, without its sweep."""
    return [Scene.load(name, REGISTRY) for name in study_of(study).scenes]


def places(study: str) -> list[Array]:
    """Where every source of a study is a second after its start, on the floor."""
    every = [source.trajectory for scene in loaded(study) for source in scene.sources.values()]
    return [np.asarray(t.position(np.array([1.0]))[0, :2]) for t in every]


def _distances(states: Array) -> Array:
    """(2, n) of the two talkers of `echo_scans` to estimates (n, 4)."""
    off = echo_scans.TALKERS[:, None, [0, 2]] - states[None][..., [0, 2]]
    return np.asarray(np.linalg.norm(off, axis=-1))


def clips(study: str) -> set[str]:
    tables = [s["sound"] for scene in loaded(study) for s in scene.table["sources"].values()]
    return {t["clip"] for t in tables if "clip" in t}


@pytest.mark.parametrize("sound", SOUNDS)
@pytest.mark.parametrize("pairs", ["", "-pairs"])
def test_two_sources_exist_in_the_printed_frames_at_the_printed_places(sound: str, pairs: str) -> None:
    truth = truth_of(Scene.load(f"liang2016-two-{sound}{pairs}", REGISTRY))
    frames = np.round(truth.time_s / 0.128).astype(int)
    np.testing.assert_array_equal(frames[truth.exists[:, 0]], np.arange(1, 26))
    np.testing.assert_array_equal(frames[truth.exists[:, 1]], np.arange(10, 31))
    np.testing.assert_array_equal(truth.position[0], [[1.0, 1.0, 1.8], [2.0, 2.0, 1.8]])


def test_the_pipeline_of_the_thesis_has_its_settings() -> None:
    table = {e.name: e.table for e in study_of("liang2016-one").plan().entries}["md-phat"]
    front_end, tracker = table["front_end"], table["tracker"]
    assert (front_end["relative"], front_end["max_peaks"], front_end["frame_s"]) == (0.25, 3, 1024 / 8000)
    assert (tracker["motion"]["rate_hz"], tracker["motion"]["v_rms_m_s"], tracker["p_s"]) == (10.0, 1.0, 1 - 0.01)
    assert (tracker["particles"], tracker["born_particles"], tracker["birth"]["weight"]) == (500, 100, 0.05)
    measurement = tracker["measurement"]
    assert (measurement["p_d"], measurement["p_d_echo"], 1 + 2 * len(measurement["walls"])) == (0.9, 0.4, 5)


@pytest.mark.parametrize("name", [*MEASURING, *TUNING_STUDIES])
def test_a_study_is_planned_without_fault(name: str) -> None:
    plan = study_of(name).plan()
    assert plan.trials
    assert name in TUNING_STUDIES or len(plan.trials) // len(plan.entries) >= 16


def test_tuning_and_measuring_share_no_seed_place_or_voice() -> None:
    for name in MEASURING:
        assert study_of(name).seed not in {study_of(t).seed for t in TUNING_STUDIES}
        assert not clips(name) & clips(TUNING)
        assert min(np.linalg.norm(a - b) for a, b in itertools.product(places(name), places(TUNING))) > 0.05


@pytest.mark.study
def test_one_pair_follows_a_walking_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    file = tmp_path / "short.toml"
    file.write_text(
        'scenes = ["liang2016-one-white"]\nrepetitions = 2\nseed = 5199\nmetrics = ["position-error"]\n'
        "[pipelines]\nliang2016-md-phat = {}\n[sweep]\nscene.duration_s = [3.072]\n"
    )
    run = Study.load(file).run(out=tmp_path / "run", in_process=True)
    assert run.failed == 0, run.trials[["status", "exc_message"]]
    scores = run.scores.groupby("metric")["value"].max()
    assert scores["position-error.median"] < 0.1
    assert run.scores.groupby("metric")["value"].min()["position-error.coverage"] > 0.6


def test_echoes_place_talkers_whom_direct_delays_of_one_pair_cannot() -> None:
    where = echo_scans.setup(clutter=1.0)
    model = echo_scans.five_modes(where)
    scans = [replace(echo_scans.scan_of(model, where, 7, seed), time_s=0.1 * (seed + 1)) for seed in range(12)]
    errors = {}
    for walls in (("x0", "x1"), ()):
        measurement = TdoaImages(reach_s=echo_scans.REACH_S, walls=walls)
        tracker = ParticlePhd(measurement=measurement, birth=Room(weight=0.2, per_axis=3), multiplicity=False)
        found = track(tracker, where, scans, np.random.default_rng(1))
        errors[walls] = np.mean([ospa(_distances(e.states), 1.0, 2.0)[0] for e in found[4:]])
    assert errors["x0", "x1"] < 0.25
    assert errors[()] > 0.6


def scores(name: str, folder: Path, metric: str, repetitions: int | None = None, only: tuple[str, ...] = ()) -> pd.DataFrame:
    """A metric's values by scene, swept setting of it and repetition (rows) and pipeline (columns) of a study whose every trial is ok."""
    run = Study.load(name, repetitions=repetitions, only=only).run(out=folder / name)
    assert run.failed == 0, run.trials[["status", "exc_message"]].drop_duplicates()
    swept = [c for c in run.trials.columns if c.startswith("p_scene.")]
    trials = run.trials.assign(**{c: run.trials[c].map(str) for c in swept if run.trials[c].dtype == object})
    rows = run.scores[run.scores["metric"] == metric].merge(
        trials[["trial_key", "pipeline", "scene", "repetition", *swept]], on="trial_key"
    )
    return rows.pivot_table(index=["scene", *swept, "repetition"], columns="pipeline", values="value")


@pytest.mark.study
@pytest.mark.xdist_group("liang2016-one-pair")
def test_the_order_of_figure_5_16_for_noise_and_speech(tmp_path: Path) -> None:
    every = scores("liang2016-two", tmp_path, OSPA)
    mean = every.groupby("scene").mean()
    print(mean.round(3).to_string())
    assert (every.groupby("scene").size() >= 16).all()
    white, speech = mean.loc["liang2016-two-white-pairs"], mean.loc["liang2016-two-speech-pairs"]
    assert white["md-iphat"] < white["md-phat"] - 0.1
    assert white["md-phat"] < white["nu"] - 0.1
    assert speech["md-phat"] < speech["nu"] - 0.1
    assert abs(speech["md-iphat"] - speech["md-phat"]) < 0.1  # where the thesis's order does not hold
    assert (mean["ms-joint"] < mean["ms-iterated"]).all()
    assert (mean["md-tuned"] < np.minimum(mean["md-phat"], mean["md-iphat"]) - 0.05).all()


@pytest.mark.study
@pytest.mark.xdist_group("liang2016-one-pair")
def test_the_order_of_figure_5_16_for_tones(tmp_path: Path) -> None:
    every = scores("liang2016-two-tones", tmp_path, OSPA)
    mean = every.mean()
    print(mean.round(3).to_string())
    assert len(every) >= 16
    assert mean["md-iphat"] < mean["md-phat"]
    assert mean["md-phat"] < mean["nu"] - 0.1
    assert mean["ms-joint"] < mean["ms-iterated"]
    assert mean["md-tuned"] < min(mean["md-phat"], mean["md-iphat"]) - 0.05


@pytest.mark.study
@pytest.mark.xdist_group("liang2016-one-pair")
def test_one_pair_places_a_walking_source_of_noise_within_ten_centimetres(tmp_path: Path) -> None:
    only = ("md-phat", "md-tuned")
    error = scores("liang2016-one", tmp_path, "position-error.median", 8, only).loc["liang2016-one-white"].groupby(level=0).median()
    found = scores("liang2016-one", tmp_path, "position-error.coverage", 8, only).loc["liang2016-one-white"].groupby(level=0).mean()
    print(error.round(3).to_string(), found.round(3).to_string(), sep="\n")
    audible = error.index.astype(float) >= 5
    assert audible.sum() == 3
    assert (error.to_numpy()[audible] <= 0.10).all()
    assert (found.to_numpy()[audible] >= 0.8).all()
