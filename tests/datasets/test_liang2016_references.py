"""The times that Liang 2016 prints stand on the boards of its studies."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from sonobench import Study
from sonobench.board import render

SMC = ("pipelines", "smc", "tracker")
SNR = ("scene", "noise", "snr_db")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))


def test_table_4_1_stands_beside_the_cost_of_the_particle_filter(tmp_path: Path) -> None:
    study = Study.load("liang2016-smc", repetitions=1)
    small = dataclasses.replace(study, sweep={(*SMC, "particles"): (200,), (*SMC, "born_particles"): (100,)})
    run = small.run(out=tmp_path / "run", in_process=True)
    (row,) = run.board("cardinality").to_dict("records")
    assert row["ref_ms_per_frame.liang2016"] == pytest.approx(23040.6124e3 / 100 / 50)
    assert row["ms_per_frame"] < row["ref_ms_per_frame.liang2016"]
    text = render(run.board())
    assert "4608.1" in text
    assert "ms/frame printed in Table 4-1 of Liang 2016" in text


def test_table_3_2_stands_beside_the_cost_of_delay_estimators_at_the_ratios_that_it_has(tmp_path: Path) -> None:
    study = Study.load("liang2016-delays", repetitions=1, only=("cc", "iphat"))
    small = dataclasses.replace(study, scenes=study.scenes[:1], sweep={SNR: (0, 5)})
    run = small.run(out=tmp_path / "run", in_process=True)
    board = run.board("delay-error.gross", by="snr_db").set_index(["p_scene.noise.snr_db", "pipeline"])["ref_ms_per_frame.liang2016"]
    assert board[0, "cc"] == pytest.approx(33.602)
    assert board.notna().sum() == 1
    assert "liang2016 prints no ms/frame to stand here" in render(run.board("delay-error.gross"))
