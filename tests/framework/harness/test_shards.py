"""Parts of a plan on several machines, boards of several runs, and what a run would do."""

from __future__ import annotations

import json
import shutil

import pandas as pd
import pytest
from harness_study import STUDY, write_study

from sonobench.cli import main
from sonobench.errors import InputError
from sonobench.harness import open_run, run_study
from sonobench.harness.progress import Silent
from sonobench.scene.study import Study

TWO = STUDY.replace("guesser = {}", 'guesser = {}\nother = { use = "guesser", tracker = { spread_m = 0.3 } }')
KEY = ["trial_key", "metric", "slice"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    write_study(tmp_path, TWO)
    return tmp_path


def run(**options):
    return run_study(Study.load("tiny.toml"), in_process=True, display=Silent(), **options)


@pytest.fixture
def told(capsys):
    def call(*arguments):
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main(list(map(str, arguments)))
        assert ended.value.code in (0, None), capsys.readouterr().err
        return capsys.readouterr().out

    return call


@pytest.mark.parametrize("count", [2, 3, 4])
def test_shards_are_disjoint_by_recording_and_together_the_plan(folder, count):
    plan = Study.load("tiny.toml").plan()
    parts = [plan.shard(k + 1, count) for k in range(count)]
    assert sorted(t.trial_key for p in parts for t in p) == sorted(t.trial_key for t in plan)
    recordings = [{(t.scene, t.seed) for t in p} for p in parts]
    assert sum(map(len, recordings)) == len(set.union(*recordings)) == 4
    assert max(map(len, recordings)) - min(map(len, recordings)) <= 1


def test_boards_of_all_shards_are_the_board_of_the_whole_run(folder):
    whole = run()
    shards = [run(shard=(k, 3)) for k in (1, 2, 3)]
    assert [s.path.name for s in shards] == ["tiny-1of3", "tiny-2of3", "tiny-3of3"]
    assert sum(len(s.trials) for s in shards) == len(whole.trials)
    joined = open_run("tiny-1of3", "tiny-2of3", "tiny-3of3")
    a, b = (r.scores.sort_values(KEY, ignore_index=True) for r in (whole, joined))
    pd.testing.assert_frame_equal(a, b, check_exact=True)
    columns = ["pipeline", "mean", "low", "high", "trials"]
    pd.testing.assert_frame_equal(whole.board()[columns], joined.board()[columns], rtol=1e-12)


def test_a_board_says_which_shards_are_missing(folder, told):
    for k in (1, 2, 3):
        run(shard=(k, 4))

    def said(*runs, **options):
        return [n for n in open_run(*runs).board(**options).attrs["notes"] if "missing" in n]

    rest = "missing: this board is of the other shards' recordings alone."
    assert said("tiny-1of4") == [f"! 2/4, 3/4 and 4/4 of study tiny are {rest}"]
    assert said("tiny-1of4", "tiny-3of4", "tiny-2of4") == [f"! 4/4 of study tiny is {rest}"]
    assert told("board", "tiny-1of4", "--by", "scene").count("2/4, 3/4 and 4/4 of study tiny are missing") == 1
    assert "of study tiny are missing" in told("board", "tiny-1of4", "--attribute", "tracker")
    run(shard=(4, 4))
    assert said(*(f"tiny-{k}of4" for k in (1, 2, 3, 4))) == []
    run()
    assert said("tiny", "tiny-1of4") == []


def test_shards_of_another_seed_or_with_other_pipelines_are_missing_on_their_own(folder):
    run(shard=(1, 2)), run(shard=(2, 2))
    study = Study.load("tiny.toml", only=["guesser"], seed=5)
    run_study(study, shard=(2, 2), out="seeded", in_process=True, display=Silent())
    notes = open_run("tiny-1of2", "tiny-2of2", "seeded").board().attrs["notes"]
    assert [n.partition(" of study")[0] for n in notes if "missing" in n] == ["! 1/2"]


def test_the_same_shard_twice_is_refused_where_a_scene_changed_between_them(folder):
    run(shard=(1, 2), out="a"), run(shard=(1, 2), out="b")
    assert len(open_run("a", "b").trials) == 4
    scene = folder / "one.toml"
    scene.write_text(scene.read_text().replace("p_d = 0.9", "p_d = 0.8"))
    run(shard=(1, 2), out="c")
    with pytest.raises(InputError, match=r"a and \S+c are both shard 1/2 of study tiny, but 4 trials are in one of them only"):
        open_run("a", "b", "c").board()


@pytest.mark.parametrize(("shard", "said"), [((0, 4), "from 1 to 4"), ((5, 4), "from 1 to 4"), ((5, 5), "has 4 recordings")])
def test_shards_that_are_not_there_are_refused(folder, shard, said):
    with pytest.raises(InputError, match=said):
        run(shard=shard)
    assert not (folder / "runs").exists()


def test_runs_that_differ_in_a_trial_or_in_a_metric_are_no_board(folder):
    first, second = run(out="a"), run(out="b")
    scores = second.scores.assign(value=second.scores["value"] + 0.5)
    scores.to_parquet(second.path / "scores.parquet", index=False)
    with pytest.raises(InputError, match="different results"):
        open_run("a", "b").board()
    write_study(folder, TWO.replace('"distance"', '{ use = "distance", better_at_zero = false }').replace('"tiny"', '"other"'))
    other = run(out="c")
    with pytest.raises(InputError, match=r"distance.*different settings"):
        open_run("a", "c").board()
    assert len(open_run(first.path, first.path).trials) == len(other.trials)


def _rendering_is_told_by_the_scene_then_by_its_simulator(folder, ask, told):
    costs = sorted((folder / "cache/costs").glob("*.json"))
    shutil.rmtree(folder / "cache/recordings")
    for path, per_s in zip(costs, (100.0, 300.0), strict=True):
        path.write_text(json.dumps(json.loads(path.read_text()) | {"per_s": per_s}))
    seconds = {100.0 * 1.0 * 2 + 300.0 * 1.5 * 2, 300.0 * 1.0 * 2 + 100.0 * 1.5 * 2}  # scenes of 1 and 1.5 s, two repetitions
    assert ask()["forecast"]["render_seconds"] in seconds
    assert "to render), from what it took before" in told("run", "tiny.toml", "--dry-run")
    scene = folder / "two.toml"
    scene.write_text(scene.read_text().replace("duration_s = 1.5", "duration_s = 2.5"))
    changed = ask()["forecast"]
    assert changed["render_seconds"] in {per_s * 1.0 * 2 + 200.0 * 2.5 * 2 for per_s in (100.0, 300.0)}
    scene.write_text(scene.read_text().replace("p_d = 0.9", "p_d = 0.8"))
    assert ask()["forecast"]["unrendered"] == ["two"]
    assert "unknown, since none has run yet: rendering two" in told("run", "tiny.toml", "--dry-run")


def test_a_dry_run_counts_what_is_there_and_writes_nothing(folder, told):
    def ask(*more):
        return json.loads(told("run", "tiny.toml", "--jobs", 2, "--dry-run", "--json", *more))

    before = ask()
    assert not (folder / "runs").exists()
    assert len(before["trials"]) == 8
    assert before["forecast"] == {
        "trials": 8,
        "finished": 0,
        "to_run": 8,
        "to_score": 0,
        "recordings": 4,
        "to_render": 4,
        "front_ends": None,
        "seconds": None,
        "unknown": ["guesser", "other"],
        "render_seconds": None,
        "unrendered": ["one", "two"],
        "jobs": 2,
    }
    assert "time: unknown, none of this has run yet" in told("run", "tiny.toml", "--dry-run")
    run()
    journal = (folder / "runs/tiny/journal.jsonl").read_bytes()
    after = ask()["forecast"]
    assert (after["finished"], after["to_run"], after["to_render"], after["seconds"]) == (8, 0, 0, 0.0)
    assert ask("--shard", "1/4")["forecast"]["trials"] == 2
    more = ask("--repetitions", "3")["forecast"]
    assert (more["finished"], more["to_run"], more["to_render"], more["recordings"]) == (8, 4, 2, 6)
    assert more["seconds"] > 0
    assert more["render_seconds"] > 0
    shutil.rmtree(folder / "cache/scans")
    (folder / "runs/tiny/estimates").rename(folder / "gone")
    lost = ask()["forecast"]
    assert (lost["finished"], lost["to_run"], lost["to_render"], lost["front_ends"]) == (0, 8, 0, 4)
    assert (folder / "runs/tiny/journal.jsonl").read_bytes() == journal
    assert "about" in told("run", "tiny.toml", "--dry-run")
    _rendering_is_told_by_the_scene_then_by_its_simulator(folder, ask, told)
    fresh = ask("--fresh")["forecast"]
    assert (fresh["to_run"], fresh["unknown"]) == (8, [])
