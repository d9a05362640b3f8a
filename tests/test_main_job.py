"""The main job on seeds that nobody tried: real speech in rooms, tracked well enough to be believed, newcomers on the board.

One repetition of the quickstart here; `-m study` runs it on three further seeds and two repetitions.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
from readme import write_files


def quickstart(folder: Path, seed: int, *options: str) -> tuple[Path, subprocess.CompletedProcess[str]]:
    out = folder / "run"
    environment = {**os.environ, "SONOBENCH_CACHE": str(folder / "cache")}
    command = [sys.executable, "-m", "sonobench", "run", "quickstart", "--seed", str(seed), "--out", str(out), *options]
    return out, subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=900)


def check_bars(out: Path) -> None:
    from sonobench import open_run

    run = open_run(out)
    ospa = run.board("ospa").set_index("pipeline")["mean"]
    means = {m: run.board(f"position-error.{m}").set_index("pipeline")["mean"] for m in ("median", "coverage", "false")}
    best = ospa.idxmin()
    assert means["median"][best] <= 0.25
    assert means["coverage"][best] >= 0.7
    assert means["false"][best] <= 0.3
    assert ospa[best] <= 0.6 * min(ospa["nobody"], ospa["room-centre"])


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    folder = tmp_path_factory.mktemp("main-job")
    write_files(folder)
    newcomers = ["--plugin", "floor_phat.py", "--also", "mine", "--plugin", "loudest.py", "--also", "loudest"]
    entries = [e for name in ("ck-phd", "nobody", "room-centre", "mine", "loudest") for e in ("--only", name)]
    return quickstart(folder, 987654321, "--repetitions", "1", *newcomers, *entries)


def test_the_best_pipeline_tracks_on_a_seed_never_tried(finished: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    out, done = finished
    assert done.returncode == 0, done.stderr
    check_bars(out)


def test_newcomers_stand_on_the_quickstarts_board(finished: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    _, done = finished
    for name in ("mine", "loudest", "ck-phd", "nobody", "room-centre"):
        assert f" {name} " in done.stdout


def test_a_newcomers_tracker_of_one_talker_already_beats_both_baselines(finished: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    from sonobench import open_run

    ospa = open_run(finished[0]).board("ospa").set_index("pipeline")["mean"]
    assert ospa["loudest"] < 0.9 * min(ospa["nobody"], ospa["room-centre"])


def test_every_planned_trial_is_a_row(finished: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    out, _ = finished
    trials = pd.read_parquet(out / "trials.parquet")
    assert len(trials) == 10 * 5
    assert set(trials["status"]) == {"ok"}
    study = json.loads((out / "study.json").read_text())
    assert study


def test_pictures_of_best_median_and_worst_trials_are_written(finished: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    out, _ = finished
    command, environment = (
        [sys.executable, "-m", "sonobench", "report", str(out)],
        {**os.environ, "SONOBENCH_CACHE": str(out.parent / "cache")},
    )
    done = subprocess.run(command, cwd=out.parent, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    pictures = [Path(line) for line in done.stdout.splitlines()]
    assert len(pictures) >= 5
    assert all(p.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n" for p in pictures)


@pytest.mark.study
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_whole_quickstart_holds_its_bars_in_two_minutes(tmp_path: Path, seed: int) -> None:
    begin = time.monotonic()
    out, done = quickstart(tmp_path, seed)
    elapsed_s = time.monotonic() - begin
    assert done.returncode == 0, done.stderr
    check_bars(out)
    print(f"seed {seed}: {elapsed_s:.0f} s\n{done.stdout}")
