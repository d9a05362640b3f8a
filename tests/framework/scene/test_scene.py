"""Scenes from tables: what is refused, and with which words."""

import pickle

import numpy as np
import pytest
from scene_tables import MEASURED, TABLE, registry, scene

from sonobench.components import overlay
from sonobench.errors import InputError, PluginError, TableError
from sonobench.scene.scene import Scene

ALL = [
    "chen2012",
    "chen2012-audio",
    "chen2012-audio-isolated",
    *(f"quickstart-{i}" for i in range(1, 7)),
    *(f"tuning-{i}" for i in range(1, 5)),
]
WALK = {"use": "line", "from_m": [1.0, 1.0, 1.5], "speed_m_s": 1.0}


def refused(**top):
    with pytest.raises(TableError) as caught:
        scene(top)
    return caught.value.faults


@pytest.mark.parametrize("name", ALL)
def test_every_packaged_scene_is_without_fault(name):
    loaded = Scene.load(name, registry())
    assert loaded.name == name
    assert loaded.about


def test_quickstart_and_tuning_share_no_clip_no_room_and_no_path():
    def facts(prefix):
        scenes = [Scene.load(n, registry()) for n in ALL if n.startswith(prefix)]
        tables = [s.table for s in scenes]
        clips = {t["sound"]["clip"] for s in tables for t in s["sources"].values()}
        paths = {repr(t["trajectory"]) for s in tables for t in s["sources"].values()}
        return clips, {tuple(s["room"]["size_m"]) for s in tables}, paths

    for measured, tuned in zip(facts("quickstart"), facts("tuning"), strict=True):
        assert not measured & tuned


@pytest.mark.parametrize(
    ("top", "says"),
    [
        ({"duration_s": -1.0}, "duration_s: is -1.0; a positive number"),
        ({"duration_s": 0.0}, "duration_s: is 0.0"),
        ({"period_s": 5.0}, "period_s: is 5.0, longer than the scene"),
        ({"room": {"size_m": [4.0, -3.0, 2.5]}}, "room.size_m: is [4.0, -3.0, 2.5]"),
        ({"room": {"reflections": [0.5] * 6}}, "room: either reflections or t60_s"),
        ({"room": {"t60_s": -0.1}}, "room.t60_s: is -0.1"),
        ({"arrays": {"walls": {"rate_hz": [8000.0, 16000.0]}}}, "arrays.walls.rate_hz: [8000.0, 16000.0] clash"),
        ({"arrays": {"walls": {"rate_hz": [8000.0]}}}, "arrays.walls.rate_hz: has 1 rates for 2 microphones"),
        ({"arrays": {"walls": {"rate_hz": -1.0}}}, "arrays.walls.rate_hz: is -1.0"),
        ({"arrays": {"walls": {"pairs": [[0, 2]]}}}, "arrays.walls.pairs: [[0, 2]] name no two of the elements 0 to 1"),
        ({"arrays": {"walls": {"pairs": [[1, 1]]}}}, "arrays.walls.pairs: [[1, 1]] name no two"),
        ({"arrays": {"walls": {"pairs": [[0, 1, 1]]}}}, "arrays.walls.pairs: has shape (1, 3)"),
        ({"arrays": {"walls": {"elements_m": [[1.0, 1.0]]}}}, "arrays.walls.elements_m: has shape (1, 2)"),
        (
            {"arrays": {"walls": {"elements_m": [[1.8, 0.1, 0.5], [2.2, 0.1, 1.5]], "position_m": [0.0, 0.0, 1.5]}}},
            "arrays.walls.elements_m[1]: lies at (2.2, 0.1, 3) m in the room, outside its 4 × 3 × 2.5 m",
        ),
        ({"sources": {"anna": {"intervals": [[0.8, 0.2]]}}}, "sources.anna.intervals: [0.8, 0.2] ends before it starts"),
        ({"sources": {"anna": {"intervals": [[0.0, 2.5]]}}}, "sources.anna.intervals: [0, 2.5] leaves the scene of 0 to 2 s"),
        ({"sources": {"anna": {"intervals": [[-0.5, 1.0]]}}}, "sources.anna.intervals: [-0.5, 1] leaves the scene"),
        ({"sources": {"anna": {"intervals": [[0.0, 1.0], [0.5, 1.5]]}}}, "sources.anna.intervals: [0, 1] and [0.5, 1.5] overlap"),
        ({"sources": {"anna": {"intervals": [[1.0, 1.5], [0.0, 0.5]]}}}, "sources.anna.intervals: are out of order"),
        ({"sources": {"anna": {"intervals": []}}}, "sources.anna.intervals: has shape (0,)"),
        ({"sources": {"anna": {"sound": {"use": "clip", "clip": "anna"}}}}, "sources.anna.sound: no clip is named 'anna'; there are it-male-1, "),
        ({"sources": {"anna": {"sound": {"use": "clip", "clip": "gone.wav"}}}}, "sources.anna.sound: gone.wav: no such file"),
        ({"sources": {"carlo": {"label": 1}}}, "sources: anna and carlo share the label 1"),
        ({"given": ["strats"]}, "given: nothing is known as 'strats'; did you mean 'starts'?"),
        ({"given": ["births"], "given_arrays": {"births": [[1.0, 1.0, 1.5]]}}, "given_arrays.births: is also in given"),
        ({"noise": {"snr_db": float("nan")}}, "noise.snr_db: is nan"),
    ],
)  # fmt: skip
def test_a_fault_is_named_by_its_path_and_a_sentence(top, says):
    (fault,) = refused(**top)
    assert fault.startswith(f"scene: {says}"), fault


@pytest.mark.parametrize("coefficient", [-0.1, 1.0])
def test_a_reflection_outside_zero_to_one_is_refused(coefficient):
    table = {k: v for k, v in TABLE.items() if k != "room"}
    room = {"size_m": [4.0, 3.0, 2.5], "reflections": [0.5] * 5 + [coefficient]}
    with pytest.raises(TableError, match=r"scene: room.reflections: .* leaves \[0, 1\)"):
        Scene.from_table({**table, "room": room}, registry())


def test_a_walk_that_leaves_the_room_is_refused_with_time_and_place():
    (fault,) = refused(sources={"anna": {"trajectory": {**WALK, "to_m": [1.0, 5.0, 1.5], "speed_m_s": 2.0}}})
    assert fault == "scene: sources.anna.trajectory: at 1.21 s it is at (1, 3.02, 1.5) m, outside the room's 4 × 3 × 2.5 m"


def test_a_walk_that_would_leave_the_room_after_the_scene_is_taken():
    scene(sources={"anna": {"trajectory": {**WALK, "to_m": [1.0, 5.0, 1.5], "speed_m_s": 0.5}}})


def test_one_clip_in_two_sources_is_refused():
    one = {"use": "clip", "clip": "ru-female-1"}
    (fault,) = refused(sources={"anna": {"sound": one}, "carlo": {"sound": {**one, "offset_s": 1.0}}})
    assert fault == "scene: sources: anna and carlo sound the same clip ru-female-1.flac; give each its own"


def test_an_empty_scene_is_refused():
    with pytest.raises(TableError) as caught:
        Scene.from_table({**TABLE, "sources": {}, "arrays": {}}, registry())
    assert [f.split(";")[0] for f in caught.value.faults] == ["scene: sources: the scene is empty", "scene: arrays: nothing listens"]


def test_a_silent_source_is_refused_by_a_simulator_of_sound_only():
    source = {"mute": {"trajectory": {"use": "still", "position_m": [1.0, 1.0, 1.0]}}}
    assert refused(sources=source) == ("scene: sources.mute.sound: is missing; ImageMethod renders sound",)
    scene({**MEASURED, "sources": source})


def test_all_faults_come_in_one_message():
    faults = refused(
        duration_s=-2.0,
        given=["nonsense"],
        arrays={"walls": {"pairs": [[0, 7]], "rate_hz": [1.0, 2.0]}},
        sources={"anna": {"sound": {"use": "clip", "clip": "nobody"}}, "carlo": {"gain_db": float("inf")}},
    )
    assert [f.split(":")[1].strip() for f in faults] == [
        "duration_s", "arrays.walls.rate_hz", "arrays.walls.pairs", "sources.anna.sound", "sources.carlo.gain_db", "given",
    ]  # fmt: skip


def test_overrides_lie_over_the_file_nested_or_dotted(tmp_path):
    file = tmp_path / "own.toml"
    file.write_text('simulator = "image-method"\nduration_s = 1.0\n[arrays.a]\nelements_m = [[0, 0, 0]]\n'
                    '[sources.s]\nsound = "white"\ntrajectory = { use = "still", position_m = [1, 1, 1] }\n')  # fmt: skip
    plain = Scene.load(file, registry())
    over = Scene.load(file, registry(), {"noise": {"snr_db": 5.0}, "sources.s.gain_db": 3.0})
    assert (plain.name, plain.noise, over.noise.snr_db, over.sources["s"].gain_db) == ("own", None, 5.0, 3.0)
    assert plain.digest() != over.digest()
    assert plain.digest() == Scene.load(file, registry()).digest()


def test_the_digest_follows_the_content_of_the_files_that_sound(tmp_path):
    import soundfile

    (tmp_path / "own.toml").write_text('simulator = "image-method"\nduration_s = 1.0\n[arrays.a]\nelements_m = [[0, 0, 0]]\n[sources.s]\n'
        'sound = { use = "clip", clip = "hum.wav" }\ntrajectory = { use = "still", position_m = [1, 1, 1] }\n')  # fmt: skip
    digests, tables = set(), []
    for level in (0.1, 0.2):
        soundfile.write(tmp_path / "hum.wav", level * np.sin(np.arange(8000)), 8000)
        loaded = Scene.load(tmp_path / "own.toml", registry())
        digests.add(loaded.digest())
        tables.append(loaded.table)
    assert len(digests) == 2
    assert tables[0] == tables[1]
    assert str(tmp_path) not in repr(tables)  # where a scene lies does not change what it is


def test_what_is_no_scene_file_is_said_so(tmp_path):
    (tmp_path / "bad.toml").write_text("a = [")
    with pytest.raises(InputError, match=r"bad\.toml: not valid TOML"):
        Scene.load(tmp_path / "bad.toml", registry())
    with pytest.raises(InputError, match=r"gone\.toml: no such file"):
        Scene.load(tmp_path / "gone.toml", registry())
    with pytest.raises(PluginError, match="did you mean 'quickstart-1'"):
        Scene.load("quickstrat-1", registry())


def test_table_to_scene_to_table_is_the_identity():
    first = scene()
    assert Scene.from_table(first.table, registry()).table == first.table


def test_a_scene_pickles_with_its_table():
    first = scene()
    again = pickle.loads(pickle.dumps(first))
    assert again.digest() == first.digest()
    assert again.table == overlay(first.table, {})


def test_a_pose_turns_counter_clockwise_then_shifts():
    array = scene(arrays={"walls": {"elements_m": [[1.0, 0.0, 0.0]], "pairs": [], "yaw_deg": 90.0, "position_m": [1.0, 1.0, 1.0]}}).arrays[
        "walls"
    ]
    np.testing.assert_allclose(array.pose @ [1, 0, 0, 1], [1, 2, 1, 1], atol=1e-12)
