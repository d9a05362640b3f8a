"""The bundled studies of Figures 4 to 10 of Zhang et al. and of random scenes: they plan, compare like with like, and show what docs/papers/zhang_glmb.md says."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from sonobench import Study
from sonobench.components import build
from sonobench.geometry import angles, unit_vector
from sonobench.registry import Registry
from sonobench.scene import Scene
from sonobench.scene.truth import truth_of

REGISTRY = Registry.load()
STUDIES = ["zhang-glmb-two", "zhang-glmb-snr", "zhang-glmb-sigma", "zhang-glmb-three", "zhang-glmb-random"]


@pytest.mark.parametrize("name", STUDIES)
def test_every_scene_pipeline_and_metric_builds(name: str) -> None:
    study = Study.load(name)
    assert len(study.plan().trials) >= len(study.scenes) * study.repetitions * len(study.pipelines)
    assert study.repetitions >= 10
    assert {"cum-glmb", "cov-glmb"} <= set(study.pipelines)


@pytest.mark.parametrize(("one", "other"), [("zhang-cum-amms-glmb", "zhang-cum-cbmember"), ("zhang-cov-glmb", "zhang-cbmember")])
def test_the_cbmember_pipelines_differ_by_the_filter_alone(one: str, other: str) -> None:
    a, b = (build("pipeline", {"use": name}, REGISTRY) for name in (one, other))
    assert a.front_end == b.front_end
    for part in ("motion", "likelihood", "birth", "p_s", "particles"):
        assert getattr(a.tracker, part) == getattr(b.tracker, part)


def test_covariances_and_cumulants_find_the_number_of_sources_by_one_rule() -> None:
    for name, table in Study.load("zhang-glmb-two").pipelines.items():
        spectrum = build("pipeline", table, REGISTRY).front_end.spectrum
        if not name.startswith("gls"):
            assert spectrum.order == ("threshold" if name.endswith("threshold") else "error")


@pytest.mark.parametrize(("low", "high"), [(35, 50), (20, 35), (10, 20)])
@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_least_separations_of_the_random_scenes(low: int, high: int, number: int) -> None:
    truth = truth_of(Scene.load(f"zhang-glmb-random-{low}-{number}", REGISTRY))
    u = unit_vector(angles(truth.position))
    cosines = np.einsum("kia,kja->kij", u, u)[:, *np.triu_indices(5, 1)]
    assert truth.exists.shape == (25, 5)
    assert truth.exists.all()
    assert low <= np.degrees(np.arccos(np.clip(cosines, -1, 1))).min() < high


def _means(name: str, metric: str, only: tuple[str, ...], noise: dict[str, float], folder: Path) -> dict[str, float]:
    """Mean of each pipeline over six renderings in one noise."""
    study = Study.load(name, repetitions=6, only=only)
    run = dataclasses.replace(study, sweep={("scene", "noise", key): (value,) for key, value in noise.items()}).run(out=folder)
    return dict(run.board(metric).set_index("pipeline")["mean"])


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "run"


@pytest.mark.study
def test_figure_4_depends_on_the_order_rule_and_on_the_width_of_peaks(folder: Path) -> None:
    names = ("cum-glmb", "cum-cbmember", "cov-glmb", "cov-narrow", "cov-glmb-threshold", "cum-glmb-threshold")
    ospa = _means("zhang-glmb-two", "ospa-direction", names, {"velocity_db": 0.0}, folder)
    assert ospa["cum-glmb"] == pytest.approx(ospa["cum-cbmember"], abs=0.01)
    assert ospa["cum-glmb"] < 1.0 < ospa["cov-glmb"] < 2.0
    assert ospa["cov-narrow"] < ospa["cum-glmb"]
    assert 1.5 < ospa["cum-glmb-threshold"] < ospa["cov-glmb-threshold"]


@pytest.mark.study
@pytest.mark.parametrize(
    ("snr_db", "velocity_db", "better"),
    [(0.0, 0.0, "cov-narrow"), (10.0, 0.0, "cov-narrow"), (0.0, -8.45, "cum-glmb"), (10.0, -8.45, "cum-glmb")],
)
def test_figure_5_is_the_other_way_round_in_equal_noise(snr_db: float, velocity_db: float, better: str, folder: Path) -> None:
    names = ("cum-glmb", "cov-narrow")
    error = _means("zhang-glmb-snr", "direction-error.deg", names, {"snr_db": snr_db, "velocity_db": velocity_db}, folder)
    (other,) = set(names) - {better}
    assert error[better] < 0.7 * error[other]
