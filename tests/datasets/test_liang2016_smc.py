"""The bundled studies of Liang 2016, section 4.3 and Figure 5-1: they plan as described; the study shows what docs/papers/liang2016-smc.md says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sonobench import Study

SWEPT = {
    "liang2016-smc": {"particles": [200, 400, 600, 1000], "born_particles": [50, 100, 150, 200]},
    "liang2016-smc-p-d": {"p_d": [0.5, 0.7, 0.9, 0.95, 0.99]},
    "liang2016-labels": {},
}


@pytest.mark.parametrize("name", SWEPT)
def test_a_study_plans_a_hundred_runs_of_the_printed_settings(name: str) -> None:
    study = Study.load(name)
    assert study.repetitions >= 100
    assert study.metrics[0] == {"use": "ospa", "p": 2.0, "c_m": 50.0}
    assert {path[-1]: list(values) for path, values in study.sweep.items()} == SWEPT[name]


def ospa(name: str, folder: Path, repetitions: int, only: tuple[str, ...] = ()) -> pd.DataFrame:
    """OSPA by repetition and swept value (rows) and by pipeline (columns)."""
    run = Study.load(name, repetitions=repetitions, only=only).run(out=folder / name, in_process=True)
    assert run.failed == 0, run.trials[["status", "exc_message"]].drop_duplicates()
    swept = [c for c in run.trials.columns if c.startswith("p_scene.")]
    rows = run.scores[run.scores["metric"].isin(["ospa", "ospa[c_m=50.0,p=2.0]"])].merge(
        run.trials[["trial_key", "pipeline", "repetition", *swept]], on="trial_key"
    )
    return rows.pivot_table(index=[*swept, "repetition"], columns="pipeline", values="value")


def paired(difference: pd.Series) -> tuple[float, float]:
    """Mean and half its 95 % interval."""
    return float(difference.mean()), float(1.98 * difference.std(ddof=1) / np.sqrt(len(difference)))


@pytest.mark.study
def test_labels_beat_k_means_and_rows_are_as_good_as_labels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    found = ospa("liang2016-labels", tmp_path, 100, ("labels", "k-means", "measurement"))
    mean, half = paired(found["k-means"] - found["labels"])
    assert mean - half > 0
    mean, half = paired(found["measurement"] - found["labels"])
    assert abs(mean) - half < 0.25


@pytest.mark.study
def test_ospa_falls_with_the_probability_of_detection(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    means = ospa("liang2016-smc-p-d", tmp_path, 100, ("smc",)).groupby(level=0).mean()["smc"].to_numpy()
    assert (np.diff(means) < 0).all()


@pytest.mark.study
def test_ospa_falls_with_the_number_of_particles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    means = ospa("liang2016-smc", tmp_path, 100).mean()
    by_number = [means[[c for c in means.index if f"[particles={n}," in c]].mean() for n in (200, 400, 600, 1000)]
    assert by_number[0] > by_number[1] > by_number[3]
