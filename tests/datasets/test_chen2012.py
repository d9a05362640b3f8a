"""The bundled studies of Chen, Chen, Yin & Hou 2012: they plan as described; paper mode is at the printed level at 25 dB."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import pytest
from chen2012_runs import ARE, FULL, PLACE, measured

from sonobench import Registry, Study
from sonobench.scene.reference import Reference

LITERAL = ("ek-phd", "uk-phd", "ck-phd")
SWEPT = {
    "chen2012-snr": "delay_std_s",
    "chen2012-t60": "delay_std_s",
    "chen2012-time": "delay_std_s",
    "chen2012-p-d": "p_d",
    "chen2012-clutter": "clutter_per_scan",
    "chen2012-period": "period_s",
}


@pytest.mark.parametrize("name", SWEPT)
def test_a_study_plans_its_paired_runs_of_the_literal_filters_and_a_corrected_one(name: str) -> None:
    study = Study.load(name)
    assert study.repetitions >= 100
    assert {*LITERAL, "ck-corrected"} <= set(study.pipelines)
    ((path, values),) = study.sweep.items()
    assert path[-1] == SWEPT[name]
    assert study.metrics[0] == {"use": "ospa", "p": 2.0, "c_m": 1.5, "components": ["x_m", "vx_m_s", "y_m", "vy_m_s"]}
    assert {"use": "ospa", "p": 2.0, "c_m": 1.5} in study.metrics
    assert len(Study.load(name, repetitions=2).plan().trials) == 2 * len(values) * len(study.pipelines)


def test_every_printed_delay_error_is_swept_by_the_study_of_its_table() -> None:
    printed = Reference.load("chen2012", Registry.load(()))
    for table in printed.tables:
        study = Study.load("chen2012-snr" if table.table in ("Table 2", "Table 3") else "chen2012-t60")
        ((path, swept),) = study.sweep.items()
        assert table.at == {".".join(path): swept}
        assert set(table.values) <= set(study.pipelines)


def test_no_plugin_pipeline_scene_or_study_knows_a_printed_number() -> None:
    printed = Reference.load("chen2012", Registry.load(()))
    numbers = {f"{value:.4f}".lstrip("0") for table in printed.tables for own in table.values.values() for value in own}
    assert len(numbers) > 40
    data = Path(str(files("sonobench_datasets")))
    sources = [p for room in ("pipelines", "scenes", "studies") for p in (data / room).glob("*.toml")]
    plugins = list(Path(str(files("sonobench_plugins"))).rglob("*.py"))
    sources += plugins
    assert len(plugins) > 40
    found = [(p.name, n) for p in sources for n in numbers if n in p.read_text()]
    assert not found
    assert not [p.name for p in plugins if "scene.reference" in p.read_text()]


def test_paper_mode_is_at_the_printed_level_at_25_db(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    mean = measured("chen2012-time", tmp_path, 6, in_process=True, only=("ck-phd", "ck-corrected")).mean()
    assert mean[FULL, "ck-phd"] == pytest.approx(0.884, abs=0.05)
    assert mean[ARE, "ck-phd"] == pytest.approx(0.302, abs=0.10)
    assert mean[FULL, "ck-corrected"] <= 0.76
    assert mean[ARE, "ck-corrected"] <= 0.08
    assert mean[PLACE, "ck-corrected"] < mean[PLACE, "ck-phd"] < mean[FULL, "ck-phd"]
