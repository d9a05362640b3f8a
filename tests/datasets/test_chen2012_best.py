"""The best pipeline on the scenes of chen2012: within its bar, and chosen on other scenes than those that measure it."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sonobench import Study
from sonobench.types import Array
from sonobench_plugins.trajectory.wander import Wander

FULL = 'ospa[c_m=1.5,components=["x_m","vx_m_s","y_m","vy_m_s"],p=2.0]'
MEASURING, TUNING = ("chen2012-best", "chen2012-paths"), ("chen2012-tuning",)


def scores(name: str, folder: Path, repetitions: int, only: tuple[str, ...] = (), in_process: bool = False) -> pd.DataFrame:
    """Full-state OSPA by scene and repetition (rows) and pipeline (columns)."""
    run = Study.load(name, repetitions=repetitions, only=only).run(out=folder / name, in_process=in_process)
    assert run.failed == 0, run.trials[["status", "exc_message"]].drop_duplicates()
    rows = run.scores[run.scores["metric"] == FULL].merge(run.trials[["trial_key", "pipeline", "scene", "repetition"]], on="trial_key")
    return rows.pivot_table(index=["scene", "repetition"], columns="pipeline", values="value")


def walks(names: tuple[str, ...]) -> tuple[set[int], list[Array]]:
    """The studies' seeds of random walks, and where each of their speakers is a second after its start."""
    sources = {s.name: s.scene for n in names for s in Study.load(n).plan().sources}
    every = [source.trajectory for scene in sources.values() for source in scene.sources.values()]
    return {w.seed for w in every if isinstance(w, Wander)}, [np.asarray(w.position(np.array([1.0]))[0]) for w in every]


def test_tuning_and_measuring_share_no_scene_seed_or_walk() -> None:
    tuning, measuring = [Study.load(n) for n in TUNING], [Study.load(n) for n in MEASURING]
    assert not {s for t in tuning for s in t.scenes} & {s for m in measuring for s in m.scenes}
    assert not {t.seed for t in tuning} & {m.seed for m in measuring}
    (their_seeds, theirs), (our_seeds, ours) = walks(TUNING), walks(MEASURING)
    assert len(our_seeds) == 36
    assert not their_seeds & our_seeds
    assert min(np.linalg.norm(a - b) for a, b in itertools.product(theirs, ours)) > 0.01


def test_told_births_are_where_the_walks_begin() -> None:
    for source in Study.load("chen2012-paths").plan().sources:
        for told, one in zip(source.scene.given_arrays["births"], source.scene.sources.values(), strict=True):
            begin, later = one.trajectory.position(np.array([0.0, 1e-6]))
            np.testing.assert_allclose(told[[0, 2]], begin[:2], atol=1e-4)
            speed = np.linalg.norm(later - begin)
            np.testing.assert_allclose(told[[1, 3]] / 0.98, (later - begin)[:2] / speed, atol=1e-3)


def test_the_best_pipeline_is_within_the_bar_on_two_renderings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    assert scores("chen2012-best", tmp_path, 2, ("chen2012-best",), in_process=True)["chen2012-best"].mean() <= 0.30


@pytest.mark.study
def test_the_best_pipeline_is_within_the_bar_on_the_papers_scene(tmp_path: Path) -> None:
    full = scores("chen2012-best", tmp_path, 100)
    print(full.mean().sort_values().to_string())
    assert full["chen2012-best"].mean() <= 0.50
    assert full["chen2012-best-untold"].mean() <= 0.50
    assert (full["chen2012-best"] < full["chen2012-ck-corrected"]).mean() > 0.95


@pytest.mark.study
def test_the_best_pipeline_is_best_on_every_random_path(tmp_path: Path) -> None:
    full = scores("chen2012-paths", tmp_path, 5).groupby("scene").mean()
    print(full.round(3).to_string())
    assert len(full) == 12
    assert (full["chen2012-best"] < full["chen2012-ck-corrected"] - 0.1).all()
    assert full["chen2012-best"].mean() <= 0.50
