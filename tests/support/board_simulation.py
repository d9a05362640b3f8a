"""Simulated runs with no true difference, boarded through real run folders: how often intervals cover and letters err.

Two pipelines, 10 repetitions of each scenario. A value is the scenario's level (normal, .1) plus the repetition's own noise
(normal, .5), and for the second pipeline the scenario's true difference, of mean 0 and deviation 1, whose law is studied.
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from sonobench.harness import open_run, run_folder
from sonobench.harness.rows import TRIAL_COLUMNS

REPETITIONS = 10
LAWS = {
    "normal": lambda rng, n: rng.normal(size=n),
    "heavy tails (t, 5 degrees of freedom)": lambda rng, n: rng.standard_t(5, size=n) / np.sqrt(5 / 3),
    "skewed (exponential)": lambda rng, n: rng.exponential(size=n) - 1,
    "strongly skewed (log-normal)": lambda rng, n: (rng.lognormal(size=n) - np.exp(0.5)) / np.sqrt((np.e - 1) * np.e),
    "normal, scenes × 2 swept values, half of the variance the scene's": lambda rng, n: (
        (np.repeat(rng.normal(size=n // 2), 2) + rng.normal(size=n)) / np.sqrt(2)
    ),
}


class Measured(NamedTuple):
    """Shares of the boards: interval of the difference covers 0, letters separate, the mean's interval covers, warnings."""

    draws: int
    coverage: float
    false_alarms: float
    mean_coverage: float
    warned_skew: float
    warned_alike: float


def study(folder: Path, law: str, scenarios: int, draws: int, seed: int = 1) -> Measured:
    """Board `draws` simulated runs; each folder holds a batch of them as so many metrics."""
    rng = np.random.default_rng([seed, scenarios, list(LAWS).index(law)])
    settings = 2 if "swept" in law else 1
    found: list[tuple[bool, ...]] = []
    while len(found) < draws:
        size = min(50, draws - len(found))
        path = folder / f"{scenarios}-{list(LAWS).index(law)}-{len(found)}"
        write(path, [values(rng, law, scenarios) for _ in range(size)], settings)
        run = open_run(path)
        found += [_read(run.board(metric, vs="a")) for metric in run.metrics]
    return Measured(draws, *np.mean(found, axis=0).tolist())


def values(rng: np.random.Generator, law: str, scenarios: int) -> np.ndarray:
    """(2 pipelines, scenarios, repetitions); the first one's true mean is .5, the second's too."""
    level = 0.5 + 0.1 * rng.normal(size=(1, scenarios, 1))
    difference = np.stack([np.zeros(scenarios), LAWS[law](rng, scenarios)])[:, :, None]
    return level + difference + 0.5 * rng.normal(size=(2, scenarios, REPETITIONS))


def write(path: Path, draws: list[np.ndarray], settings: int = 1) -> None:
    """A run folder, as a run writes it, with one metric a draw."""
    path.mkdir(parents=True)
    labels = [f"m{k}" for k in range(len(draws))]
    column = "p_scene.noise.snr_db"
    run_folder.prepare(path, {"study": {"name": "simulated"}, "metrics": labels, "swept": [column]}, {})
    blank = {name: {"string": "", "bool": False, "int64": 0, "float64": np.nan}[dtype] for name, dtype in TRIAL_COLUMNS.items()}
    pipelines, scenarios, repetitions = draws[0].shape
    trials, keys = [], []
    for p, s, r in itertools.product(range(pipelines), range(scenarios), range(repetitions)):
        keys.append(f"{'abcdefgh'[p]}/{s}/{r}")
        own = {"trial_key": keys[-1], "pipeline": "abcdefgh"[p], "scene": f"room{s // settings:02d}", column: 10.0 * (s % settings)}
        trials.append(blank | own | {"repetition": r, "status": "ok", "frames": 100, "tracker_s": 0.1, "distribution": "simulated"})
    common = {"metric_sha": "", "slice": "", "weight": 1.0, "unit": "m", "better": "lower", "pool": "mean", "coverage": 1.0}
    scores = pd.concat(
        [pd.DataFrame({"trial_key": keys, "metric": m, "value": v.ravel(), **common}) for m, v in zip(labels, draws, strict=True)]
    )
    run_folder.write_tables(path, [(t, []) for t in trials], {column: [10.0 * k for k in range(settings)]})
    run_folder.write_scores(path, scores.to_dict("records"))


def _read(board: pd.DataFrame) -> tuple[bool, ...]:
    rows = board.set_index("pipeline")
    a, b = rows.loc["a"], rows.loc["b"]
    notes = " ".join(board.attrs["notes"])
    separated = not set(a["tie"]) & set(b["tie"])
    assert separated == (b["diff_p"] < 0.05)
    return b["diff_low"] <= 0 <= b["diff_high"], separated, b["low"] <= 0.5 <= b["high"], "skewed" in notes, "times as large" in notes
