"""Studies of Hu, Li & Jin 2014 beside its tables: they build, and the room's directions are usable."""

from __future__ import annotations

from pathlib import Path

import pytest

from sonobench import Study


@pytest.mark.parametrize("name", ["hu2014-directions", "hu2014-figures", "hu2014-noise", "hu2014-room"])
def test_the_study_builds(name: str) -> None:
    assert Study.load(name).repetitions >= 5


def test_reverberation_leaves_the_direction_within_10_degrees(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    run = Study.load("hu2014-room", repetitions=1, only=("wpf-mp",)).run(out=tmp_path / "run", in_process=True)
    assert 0 < run.board("direction-error.deg")["mean"].iloc[0] < 10
