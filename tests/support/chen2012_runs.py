"""Runs of the bundled chen2012 studies as one table."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from sonobench import Study

FULL, ARE, PLACE = "full", "are", "place"  # OSPA of the full state, average relative error, OSPA of positions
_NAMES = {
    'ospa[c_m=1.5,components=["x_m","vx_m_s","y_m","vy_m_s"],p=2.0]': FULL,
    "cardinality.are": ARE,
    "ospa[c_m=1.5,p=2.0]": PLACE,
}


def measured(name: str, folder: Path, repetitions: int, in_process: bool = False, only: tuple[str, ...] = ()) -> pd.DataFrame:
    """Scores by swept value and repetition (rows), and by score and pipeline (columns) of a study whose every trial is ok."""
    run = Study.load(name, repetitions=repetitions, only=only).run(out=folder / name, in_process=in_process)
    trials = run.trials
    assert run.failed == 0, trials[["status", "exc_message"]].drop_duplicates()
    (swept,) = (c for c in trials.columns if c.startswith("p_scene."))
    scores = run.scores.assign(score=run.scores["metric"].map(_NAMES)).dropna(subset="score")
    rows = scores.merge(trials[["trial_key", "pipeline", "repetition", swept]], on="trial_key")
    return rows.pivot_table(index=[swept, "repetition"], columns=["score", "pipeline"], values="value").rename_axis(["at", "repetition"])
