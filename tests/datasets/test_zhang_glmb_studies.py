"""The bundled studies of Figures 4 to 10 of Zhang et al. and of random scenes: they plan, compare like with like, and show what docs/papers/zhang_glmb.md says."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from sonobench import Run, Study
from sonobench.components import build
from sonobench.geometry import angles, unit_vector
from sonobench.registry import Registry
from sonobench.scene import Scene
from sonobench.scene.truth import truth_of

REGISTRY = Registry.load()
STUDIES = ["zhang-glmb-two", "zhang-glmb-snr", "zhang-glmb-sigma", "zhang-glmb-three", "zhang-glmb-random"]
SNR, UNEQUAL = ("scene", "noise", "snr_db"), ("scene", "noise", "velocity_db")


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


def _run(name: str, only: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, **swept: list[float]) -> Run:
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    study = Study.load(name, only=only)
    return dataclasses.replace(study, sweep={("scene", "noise", k): tuple(v) for k, v in swept.items()}).run(out=tmp_path / "run")


def _means(run: Run, metric: str) -> dict[str, float]:
    return run.board(metric).set_index("pipeline")["mean"].to_dict()
