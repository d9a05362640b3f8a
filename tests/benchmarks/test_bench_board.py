"""Time of a board: small ones as simulations make them by the thousand, and one of a million trials."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from board_simulation import values, write

from sonobench.board import leaderboard
from sonobench.harness import open_run


@pytest.mark.parametrize("scenarios", [10, 24])
def test_a_board_of_two_pipelines(benchmark, tmp_path, scenarios):
    write(tmp_path / "run", [values(np.random.default_rng(0), "normal", scenarios)])
    run = open_run(tmp_path / "run")
    assert len(benchmark(run.board, "m0", vs="a")) == 2


def test_a_board_of_a_million_trials(benchmark):
    trials, scores = million()
    table = benchmark.pedantic(leaderboard, (trials, scores, "ospa"), {"vs": "p0"}, rounds=3)
    assert table.attrs["units"] == 1000


def million():
    """10 pipelines × 1000 scenes × 100 repetitions."""
    n = np.arange(1_000_000)
    text = {"status": "ok", "distribution": "d", "version": "1", "given": ""}
    trials = pd.DataFrame(
        {
            "trial_key": pd.array([f"{k:032x}" for k in n], "string"),
            "pipeline": pd.array([f"p{k % 10}" for k in n], "string"),
            "scene": pd.array([f"s{k // 10 % 1000}" for k in n], "string"),
            "repetition": n // 10_000,
            "input_sha": pd.array([f"{k // 10:064x}" for k in n], "string"),
            **{name: pd.array([value] * len(n), "string") for name, value in text.items()},
        }
    ).assign(run=0, frames=100, front_end_s=0.1, tracker_s=0.1)
    common = {"metric": "ospa", "metric_sha": "", "slice": "", "unit": "m", "better": "lower", "pool": "mean"}
    scores = pd.DataFrame({"trial_key": trials["trial_key"], **{k: pd.array([v] * len(n), "string") for k, v in common.items()}})
    return trials, scores.assign(value=np.random.default_rng(0).normal(size=len(n)), weight=1.0, coverage=1.0)
