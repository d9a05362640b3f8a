"""The table of keys, on a plugin package, through the public API: what is edited, and what runs again for it."""

from __future__ import annotations

import json

import pytest
from harness_zoo import Zoo

from sonobench.harness import open_run


@pytest.fixture
def zoo(tmp_path, monkeypatch):
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    made = Zoo(tmp_path)
    for path in made.paths:
        monkeypatch.syspath_prepend(path)
    yield made
    made.forget()


def attempts(run):
    return dict(zip(run.trials["pipeline"], run.trials["attempts"], strict=True))


def score(run):
    (value,) = run.scores["value"]
    return value


@pytest.mark.parametrize(
    ("pipeline", "file", "old", "new"),
    [
        pytest.param("plain", "plain_tracker.py", "x_m = self.x_m", "x_m = 1 + self.x_m", id="a-class"),
        pytest.param("plain", "helper.py", "return deep", "return 1 + deep", id="a-helper"),
        pytest.param("plain", "deep.py", "return x", "return 1 + x", id="a-helpers-helper"),
        pytest.param("late", "late.py", "return x", "return 1 + x", id="an-import-inside-a-function"),
        pytest.param("lazy", "laziness.py", "return x", "return 1 + x", id="a-name-from-a-plugins-lazy-facade"),
        pytest.param("attribute", "laziness.py", "return x", "return 1 + x", id="an-attribute-of-a-plugins-lazy-facade"),
        pytest.param("declared", "table.txt", "1.0", "2.0", id="a-data-file-that-is-declared"),
    ],
)
def test_an_edit_runs_again_what_depends_on_it_and_its_result_is_the_new_one(zoo, pipeline, file, old, new):
    first = zoo.run(pipeline)
    assert not first.trials["open"].any(), first.trials["open_because"][0]
    assert score(first) == 1.0
    assert attempts(zoo.run(pipeline)) == {pipeline: 1}
    zoo.edit(file, old, new)
    second = zoo.run(pipeline)
    assert attempts(second) == {pipeline: 2}
    assert score(second) == 2.0


def test_an_edit_behind_the_lazy_facade_of_sonobench_changes_the_key(zoo):
    from sonobench.harness.parts import Codes

    plan = zoo.study("facade", "plain").plan()
    codes = Codes.of(plan)
    assert "sonobench.protocols" in codes.trackers["facade"].modules
    assert zoo.run("facade").trials["open_because"][0] == ""


def test_a_new_version_of_a_distribution_runs_again_what_imports_it(zoo):
    zoo.run("wheel", "plain")
    zoo.release("2.0")
    assert attempts(zoo.run("wheel", "plain")) == {"wheel": 2, "plain": 1}


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        pytest.param("deep.py", "return x", "return x  # as it is", id="a-comment"),
        pytest.param("plain_tracker.py", "Stands still.", "Stands quite still.", id="a-docstring"),
        pytest.param("stranger.py", "return x", "return 1 + x", id="a-module-that-nothing-imports"),
        pytest.param("late_tracker.py", "x_m = self.x_m", "x_m = 1 + self.x_m", id="another-component"),
        pytest.param("_register.py", "'tracker': {", "'tracker': {'newcomer': 'zoo.late_tracker:Tracker', ", id="a-registered-plugin"),
    ],
)
def test_what_no_result_depends_on_runs_nothing_again(zoo, file, old, new):
    zoo.run("plain", "lazy")
    journal = (zoo.folder / "run/journal.jsonl").read_bytes()
    zoo.edit(file, old, new)
    assert attempts(zoo.run("plain", "lazy")) == {"plain": 1, "lazy": 1}
    assert (zoo.folder / "run/journal.jsonl").read_bytes() == journal


def test_no_component_depends_on_the_command_line_the_board_or_the_harness(zoo):
    from sonobench.harness.parts import Codes

    codes = Codes.of(zoo.study("plain", "facade").plan())
    groups = (codes.front_ends, codes.trackers, codes.scenes, codes.metrics)
    modules = {m for group in groups for found in group.values() for m in found.modules}
    assert not [m for m in modules if m.startswith(("sonobench.cli", "sonobench.board", "sonobench.report", "sonobench.harness"))]


def test_a_newly_loaded_plugin_file_runs_nothing_again(zoo):
    zoo.run("plain")
    journal = (zoo.folder / "run/journal.jsonl").read_bytes()
    other = zoo.folder / "other.py"
    other.write_text("from sonobench import hookimpl\n@hookimpl\ndef sonobench_components():\n    return {}\n")
    path = zoo.study("plain").folder / "zoos.toml"
    path.write_text(f'plugins = ["other.py"]\n{path.read_text()}')
    from sonobench.harness.progress import Silent
    from sonobench.scene.study import Study

    Study.load(path).run(out=zoo.folder / "run", in_process=True, display=Silent())
    assert (zoo.folder / "run/journal.jsonl").read_bytes() == journal


def test_an_edited_metric_scores_stored_estimates_again_and_runs_nothing_else(zoo):
    first = score(zoo.run("plain"))
    written = {p.name: p.stat().st_mtime_ns for p in (zoo.folder / "run/estimates").iterdir()}
    zoo.edit("metric.py", "values * 1.0", "values * 3.0")
    second = zoo.run("plain")
    assert (first, score(second)) == (1.0, 3.0)
    assert attempts(second) == {"plain": 1}
    assert {p.name: p.stat().st_mtime_ns for p in (zoo.folder / "run/estimates").iterdir()} == written


def test_the_new_result_of_a_shared_numba_helper_appears_though_compiled_code_is_kept(zoo):
    assert score(zoo.run("compiled", in_process=False, jobs=1)) == 1.0
    kept = {p.name for p in (zoo.folder / "cache/numba").iterdir()}
    zoo.edit("kernels.py", "x * 1.0", "x * 2.0")
    second = zoo.run("compiled", in_process=False, jobs=1)
    assert attempts(second) == {"compiled": 2}
    assert score(second) == 2.0
    assert {p.name for p in (zoo.folder / "cache/numba").iterdir()} > kept


@pytest.mark.parametrize(
    ("pipeline", "named"),
    [
        ("computed", "module zoo.hidden"),
        ("top", "module zoo.buried"),
        ("reading", "zoo/secret.txt"),
        ("shell", "the program true"),
    ],
)
def test_what_was_used_beyond_the_key_makes_a_row_open_which_names_it_and_is_never_reused(zoo, pipeline, named):
    for attempt in (1, 2):  # also the second time in one process, when nothing is imported any more
        (row,) = zoo.run(pipeline).trials.itertuples()
        assert row.open
        assert named in row.open_because
        assert row.attempts == attempt


def test_workers_see_computed_imports_in_functions_and_at_the_top_of_a_module(zoo):
    for attempt in (1, 2):
        trials = zoo.run("computed", "top", "plain", in_process=False, jobs=1).trials
        assert list(trials["open_because"]) == ["module zoo.hidden", "module zoo.buried", ""]
        assert list(trials["attempts"]) == [attempt, attempt, 1]


def test_a_pipeline_is_not_open_for_what_its_neighbour_in_the_same_process_used(zoo):
    run = zoo.run("computed", "top", "reading", "plain", "lazy", "declared")
    assert dict(zip(run.trials["pipeline"], run.trials["open"], strict=True)) == {
        **dict.fromkeys(("computed", "top", "reading"), True),
        **dict.fromkeys(("plain", "lazy", "declared"), False),
    }


def test_a_module_imported_again_by_a_second_component_in_the_same_process_is_seen(zoo):
    zoo.edit(
        "late_tracker.py", "from zoo.late import later; x_m = later(x_m)", "import importlib; importlib.import_module('zoo.hid' + 'den')"
    )
    run = zoo.run("computed", "late")
    assert list(run.trials["open_because"]) == ["module zoo.hidden"] * 2


@pytest.mark.parametrize("open_", [False, True])
def test_an_open_front_end_or_simulator_runs_again_in_the_next_run_and_a_closed_one_comes_from_the_cache(zoo, open_):
    scene = zoo.folder / "one.toml"
    scene.write_text(
        scene.read_text()
        .replace('simulator = { use = "measurements"', 'simulator = { use = "sim", of = { use = "measurements"', 1)
        .replace("1.0 }", "1.0 } }", 1)
    )
    zoo.edit("_register.py", "'front_end': 'recorded', 'tracker': 'plain'", "'front_end': 'front', 'tracker': 'plain'")
    if open_:
        zoo.edit("noted.py", "    pass", "    path.read_text()")
    lines = []
    for _ in range(2):
        trials = zoo.run("plain", fresh=True).trials  # the folder is new, the cache is the old one
        assert list(trials["open"]) == [open_]
        assert ("secret.txt" in trials["open_because"][0]) == open_
        lines.append([len((zoo.package / f"{n}.txt").read_text().splitlines()) for n in ("front", "sim")])
    grown = [after - before for before, after in zip(*lines, strict=True)]
    assert grown == ([1, 1] if open_ else [0, 0])


def test_an_open_metric_scores_again_in_the_next_run(zoo):
    zoo.edit("metric.py", "values * 1.0", "values * float(open(__file__.replace('metric.py', 'secret.txt')).read())")
    assert score(zoo.run("plain")) == 1.0
    (zoo.package / "secret.txt").write_text("4.0")
    second = zoo.run("plain")
    assert score(second) == 4.0
    assert attempts(second) == {"plain": 1}


def test_a_source_that_is_edited_while_its_trial_runs_makes_the_row_open(zoo):
    zoo.edit("late_tracker.py", "from zoo.late import later; x_m = later(x_m)", "import os; os.utime(__file__, (1, 1))")
    (row,) = zoo.run("late").trials.itertuples()
    assert "late_tracker.py, edited while the study ran" in row.open_because


def test_keys_do_not_depend_on_where_a_declared_file_lies(zoo):
    from sonobench.harness.code import Closure

    here, there = Closure({}, {}, files={"/a/table.txt": "1"}), Closure({}, {}, files={"/b/table.txt": "1"})
    assert here.digest == there.digest != Closure({}, {}, files={"/b/table.txt": "2"}).digest


def test_each_part_is_written_down_once(zoo):
    zoo.run("plain", "late")
    zoo.run("plain", "late")
    parts = [json.loads(line) for line in (zoo.folder / "run/parts.jsonl").read_text().splitlines()]
    names = {p["sha"] for p in parts}
    assert len(names) == len(parts)
    trials = open_run(zoo.folder / "run").trials
    assert set(trials["scene_sha"]) | set(trials["pipeline_sha"]) <= names
    assert {p[k] for p in parts if p["kind"] == "pipeline" for k in ("front_end", "tracker")} <= names
