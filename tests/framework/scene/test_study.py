"""Studies: what a table comes to, and how it is refused."""

from __future__ import annotations

import shutil

import pytest
from harness_study import PLUGIN, SCENE, STUDY, write_study

from sonobench.errors import InputError, PluginError, TableError
from sonobench.log import write_recording
from sonobench.scene import Scene
from sonobench.scene.study import Study


def load(folder, text=STUDY, plugin=PLUGIN, **options):
    return Study.load(write_study(folder, text, plugin), **options)


def faults(folder, text, **options):
    with pytest.raises(TableError) as caught:
        load(folder, text, **options)
    return list(caught.value.faults)


def test_trials_are_the_product_of_scenes_repetitions_and_entries(tmp_path):
    text = STUDY + 'other = { use = "guesser" }\n[sweep]\nscene.simulator.p_d = [0.5, 0.9]\npipelines.other.tracker.x_m = [1, 2, 3]\n'
    planned = load(tmp_path, text).plan()
    assert len(planned) == 2 * 2 * 2 * 4
    assert {t.pipeline for t in planned} == {"guesser", "other[x_m=1]", "other[x_m=2]", "other[x_m=3]"}
    assert {t.source.swept["p_scene.simulator.p_d"] for t in planned} == {0.5, 0.9}
    assert len({t.trial_key for t in planned}) == len(planned)


def test_a_swept_value_is_in_the_pipelines_table_and_the_rest_of_it_stays(tmp_path):
    planned = load(tmp_path, STUDY + "[sweep]\npipelines.guesser.tracker.spread_m = [0.5]\n").plan()
    assert planned.entries[0].table["tracker"] == {"use": "guess", "x_m": 2.0, "y_m": 1.5, "spread_m": 0.5}


def test_two_leaves_of_one_name_are_told_apart_by_more_of_their_paths(tmp_path):
    text = STUDY + '[sweep]\npipelines.guesser.tracker = [{ use = "guess" }, { use = "bad", how = "nan" }]\n'
    assert [e.name for e in load(tmp_path, text).plan().entries] == ["guesser[tracker=guess]", "guesser[tracker=bad(how=nan)]"]


def test_a_renderings_seed_depends_on_study_seed_scene_and_repetition_and_on_nothing_else(tmp_path):
    one = {(t.scene, t.repetition): t.seed for t in load(tmp_path).plan()}
    more = {(t.scene, t.repetition): t.seed for t in load(tmp_path, STUDY + "[sweep]\nscene.simulator.p_d = [0.5]\n").plan()}
    other = {(t.scene, t.repetition): t.seed for t in load(tmp_path, seed=1).plan()}
    assert one == more
    assert len(set(one.values()) | set(other.values())) == 8


def test_flags_stand_over_the_table(tmp_path):
    study = load(tmp_path, STUDY + 'other = { use = "guesser" }\n', repetitions=5, seed=7, also=["nan"], only=["gu*", "nan"])
    assert (study.repetitions, study.seed, list(study.pipelines)) == (5, 7, ["guesser", "nan"])


def test_a_study_survives_its_own_table(tmp_path):
    study = load(tmp_path, STUDY + "[sweep]\nscene.simulator.p_d = [0.5, 0.9]\n")
    table = study.to_table()
    again = Study.from_table({k: v for k, v in table.items() if k not in ("name", "folder")}, tmp_path / "tiny.toml")
    assert again == study
    assert [t.trial_key for t in again.plan()] == [t.trial_key for t in study.plan()]


def test_two_settings_of_one_metric_have_labels_of_their_own(tmp_path):
    text = STUDY.replace('["distance"]', '[{ use = "distance" }, { use = "distance", better_at_zero = false }]')
    assert [m.label for m in load(tmp_path, text).plan().metrics] == ["distance", "distance[better_at_zero=false]"]


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("guesser = {}", "guessr = {}", "pipelines.guessr: no pipeline is named 'guessr'; did you mean 'guesser'?"),
        ("guesser = {}", "", "the study names no pipeline"),
        ("guesser = {}", "guesser = 3", "pipelines.guesser: a table is needed, got 3"),
        ("guesser = {}", "guesser = { tracker = { x_n = 1.0 } }", "tracker.x_n: Guess has no such field; did you mean 'x_m'?"),
        ('scenes = ["one.toml", "two.toml"]', "", "neither scenes nor recordings"),
        ('"one.toml"', '"three.toml"', "three.toml"),
        ('"one.toml"', '"no-such-scene"', "no scene is named 'no-such-scene'"),
        ("repetitions = 2", "repetitions = -1", "repetitions: an integer of at least 1 is needed, got -1"),
        ("repetitions = 2", "repetitions = true", "repetitions: an integer of at least 1 is needed, got True"),
        ("repetitions = 2", "repetition = 2", "repetition: a study has no such key; did you mean 'repetitions'?"),
        ("repetitions = 2", "seed = -3", "seed: an integer of at least 0 is needed, got -3"),
        ('["distance"]', "[]", "the study names no metric"),
        ('["distance"]', '["distnce"]', "did you mean 'distance'?"),
        ('["distance"]', "[4]", "metrics[0]: a name or a table with `use` is needed, got 4"),
        ('["distance"]', '["distance", "distance"]', "the same metric stands there twice"),
        (
            "guesser = {}",
            "guesser = {}\n[sweep]\nscen.a = [1]",
            "sweep.scen.a: begins with neither scene nor pipelines; did you mean 'scene'?",
        ),
        ("guesser = {}", "guesser = {}\n[sweep]\nscene.duration_s = 3", "sweep.scene.duration_s: a list of alternatives is needed, got 3"),
        (
            "guesser = {}",
            "guesser = {}\n[sweep]\npipelines.gueser.tracker.x_m = [1]",
            "no entry is named 'gueser'; did you mean 'guesser'?",
        ),
        ("guesser = {}", "guesser = {}\n[sweep]\nscene.duration_s = [-1.0]", "duration_s"),
        ("guesser = {}", "guesser = {}\n[sweep]\npipelines.guesser.tracker.x_m = [1, 1]", "two swept values give the same entry"),
        ("scenes =", 'recordings = ["takes/*.mcap"]\nscenes =', "'takes/*.mcap' matches no file"),
        ("scenes =", 'recordings = ["takes"]\nscenes =', "'takes' does not end in .mcap"),
    ],
)
def test_a_fault_is_named_with_its_key_and_what_to_do(tmp_path, old, new, fault):
    assert old in STUDY
    found = faults(tmp_path, STUDY.replace(old, new))
    assert any(fault in f for f in found), found


def test_all_faults_are_told_at_once(tmp_path):
    text = STUDY.replace("repetitions = 2", "repetitions = 0\nspeed = 1").replace("guesser = {}", "guessr = {}\nnaan = {}")
    found = faults(tmp_path, text.replace('"one.toml"', '"no-such-scene"'))
    assert len(found) == 5
    assert all(f.startswith("tiny.toml: ") for f in found)


def test_a_pattern_that_keeps_nothing_is_a_fault(tmp_path):
    assert "matches none of ['guesser']; did you mean 'guesser'?" in faults(tmp_path, STUDY, only=["gueser"])[0]


def test_a_broken_recording_is_a_fault_that_names_the_file(tmp_path):
    (tmp_path / "take.mcap").write_bytes(b"not an MCAP")
    found = faults(tmp_path, STUDY.replace("scenes =", 'recordings = ["*.mcap"]\nscenes ='))
    assert len(found) == 1
    assert "take.mcap" in found[0]


def test_a_pipeline_whose_module_is_missing_is_planned_as_unavailable(tmp_path):
    planned = load(tmp_path, STUDY + "absent = {}\n").plan()
    assert not planned.faults
    assert "no_such_package" in planned.entries[1].reason
    assert [e.pipeline is None for e in planned.entries] == [False, True]


def test_a_plugin_file_that_cannot_be_loaded_is_refused(tmp_path):
    with pytest.raises(PluginError, match=r"plugin\.py"):
        load(tmp_path, plugin="import no_such_package\n")


def test_what_is_no_study_is_refused(tmp_path):
    with pytest.raises(PluginError, match="no study is named 'nothing'"):
        Study.load("nothing")
    with pytest.raises(InputError, match="no such file"):
        Study.load(tmp_path / "nothing.toml")
    (tmp_path / "broken.toml").write_text("scenes = [")
    with pytest.raises(InputError, match="not valid TOML"):
        Study.load(tmp_path / "broken.toml")


def test_two_scenes_of_one_name_are_refused(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub/one.toml").write_text(SCENE)
    assert "are both named 'one'" in faults(tmp_path, STUDY.replace('"two.toml"', '"sub/one.toml"'))[0]


def test_what_would_be_the_same_trials_is_refused(tmp_path):
    study = load(tmp_path)
    write_recording(tmp_path / "take.mcap", Scene.load(tmp_path / "one.toml", study.registry).simulate(0))
    shutil.copy(tmp_path / "take.mcap", tmp_path / "copy.mcap")
    (found,) = faults(tmp_path, STUDY.replace("scenes =", 'recordings = ["*.mcap"]\nscenes ='))
    assert "copy.mcap hold the same input; name one of them" in found
    once = load(tmp_path, STUDY.replace("scenes =", 'recordings = ["tak*.mcap", "take.mcap"]\nscenes ='))
    assert [p.name for p in once.recordings] == ["take.mcap"]
    found, _ = faults(tmp_path, STUDY + "[sweep]\nscene.period_s = [0.2, 0.2]\n")
    assert "two swept values give the same scene" in found
    (tmp_path / "take.mcap").rename(tmp_path / "one.mcap")
    (found,) = faults(tmp_path, STUDY.replace("scenes =", 'recordings = ["one.mcap"]\nscenes ='))
    assert "has the name of a scene" in found
