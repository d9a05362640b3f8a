"""A finished run of any size, invented: the journal that a study would have left, with an empty file for each output."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from harness_study import write_study

from sonobench.harness.cache import Cache
from sonobench.harness.environment import environment_id
from sonobench.harness.journal import Journal, encoded
from sonobench.harness.session import Session
from sonobench.scene.study import Study

PIPELINES = 10
SCENES = 2

_COSTS = {"wall_s": 0.25, "cpu_s": 0.2, "front_end_s": 0.05, "tracker_s": 0.15, "frames": 100, "real_time_factor": 0.02, "peak_mb": 210.5}


def study_of(folder: Path, trials: int) -> Study:
    """A study in `folder` of so many trials: two scenes, ten pipelines, as many repetitions as it takes."""
    entries = "\n".join(f'guesser{k} = {{ use = "guesser", tracker = {{ spread_m = {(k + 1) / 10} }} }}' for k in range(PIPELINES))
    repetitions = trials // (SCENES * PIPELINES)
    text = f'plugins = ["plugin.py"]\nscenes = ["one.toml", "two.toml"]\nrepetitions = {repetitions}\nmetrics = ["distance"]\n[pipelines]\n{entries}\n'
    return Study.load(write_study(folder, text))


def finished_run(folder: Path, trials: int) -> Path:
    """Write the study and its run's folder; every trial is ok and scored, one in a thousand failed."""
    study = study_of(folder, trials)
    planned = study.plan()
    run = folder / "run"
    (run / "estimates").mkdir(parents=True)
    (run / "logs").mkdir()
    (run / "study.json").write_text('{"schema": 1}')
    session = Session(planned, _plugins(study), run, Cache(folder / "cache"), Journal(run / "journal.jsonl"), environment_id(), print)
    rng = np.random.default_rng(0)
    with (run / "journal.jsonl").open("wb") as file:
        for number, take in enumerate(session._takes()):
            input_sha, truth_sha = f"{number:064x}", f"{number + 1:064x}"
            _write(file, recording={take.key: (input_sha, truth_sha)})
            for trial in take.trials:
                row = session._reuse.planned(trial, take) | {"input_sha": input_sha, "truth_sha": truth_sha}
                row["estimate_key"] = session._codes.estimate_key(trial.entry, input_sha, trial.run)
                if rng.random() < 1e-3:
                    row |= {"status": "error", "exc_type": "RuntimeError", "exc_message": "as told"}
                else:
                    path = f"estimates/{row['estimate_key']}.mcap"
                    (run / path).touch()
                    row |= _COSTS | {"status": "ok", "estimates_path": path}
                _write(file, trial=row)
                score = {"metric": "distance", "slice": "", "value": rng.gamma(2.0) + int(trial.pipeline[-1]), "weight": 10.0, "unit": "m"}
                rows = [score | {"better": "lower", "pool": "mean", "coverage": 1.0}]
                _write(file, trial_key=trial.trial_key, scores={key: {"rows": rows} for _, key in session._reuse.score_keys(trial, row)})
    return run


def _plugins(study: Study) -> dict[str, str]:
    return {str(p.path): p.version for p in study.registry.plugins if p.path is not None}


def _write(file, **line) -> None:
    file.write(encoded(line))
