"""Engines compared on the main job's own trials; needs a machine with two processors and nothing else to do."""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path

import pytest

from sonobench.harness import run_study
from sonobench.harness.progress import Silent
from sonobench.scene.study import Study

SCENES = ", ".join(f'"quickstart-{k}"' for k in range(1, 11))
HEAD = f"scenes = [{SCENES}]\nrepetitions = 2\n"
OSPA = 'metrics = [{ use = "ospa", c_m = 1.0, p = 1.0, targets = "active" }]\n'
PIPELINES = ("ck-phd", "ek-phd", "uk-phd", "smc-phd", "ck-phd-pairs")
TRIALS = 10 * 2 * len(PIPELINES) * 2


def seconds(folder: Path, **engine) -> float:
    """Wall clock of all trials, recordings rendered before, scans not."""
    shutil.rmtree(folder / "cache/scans", ignore_errors=True)
    begin = time.perf_counter()
    finished = run_study(Study.load(folder / "many.toml"), out=folder / "run", fresh=True, display=Silent(), **engine)
    elapsed = time.perf_counter() - begin
    assert len(finished.trials) == TRIALS
    assert not finished.failed
    return elapsed


@pytest.mark.study
def test_two_workers_do_nearly_twice_as_much_as_one_and_a_dask_cluster_of_two_as_much_as_they(tmp_path, monkeypatch, capsys):
    pytest.importorskip("distributed", reason="the Dask engine needs the extra `dask`")
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    (tmp_path / "render.toml").write_text(f"{HEAD}{OSPA}[pipelines]\nnobody = {{}}\n")
    swept = "".join(f"pipelines.{name}.tracker.p_s = [0.95, 0.99]\n" for name in PIPELINES)
    (tmp_path / "many.toml").write_text(
        f"{HEAD}{OSPA}[pipelines]\n" + "".join(f"{name} = {{}}\n" for name in PIPELINES) + f"[sweep]\n{swept}"
    )
    run_study(Study.load(tmp_path / "render.toml"), out=tmp_path / "rendered", jobs=2, display=Silent())
    took: dict[str, list[float]] = {"one": [], "two": [], "dask": []}
    options = {"one": {"jobs": 1}, "two": {"jobs": 2}, "dask": {"jobs": 2, "engine": "dask"}}
    for name in ("two", "dask", "one", "dask", "two"):  # interleaved: the machine's mood changes, and the first one compiles
        took[name].append(seconds(tmp_path, **options[name]))
    one, two, dask = (min(values) for values in took.values())
    with capsys.disabled():
        print(
            f"\n{TRIALS} trials: one worker {one:.0f} s, two {two:.0f} s ({one / two:.2f} times), a Dask cluster of two {dask:.0f} s "
            f"({dask / two - 1:+.0%}); load {os.getloadavg()[0]:.1f}"
        )
    assert one >= 1.8 * two
    assert dask <= 1.15 * two
