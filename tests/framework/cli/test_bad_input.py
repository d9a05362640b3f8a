"""Bad input ends in one clear message, exit code 2, and nothing left behind."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCENE = """
simulator = "image-method"
duration_s = 1.0
rate_hz = 16000
[room]
size_m = [4, 3, 2.5]
reflections = [0.5, 0.5, 0.5, 0.5, 0.5, 0.5]
[arrays.wall]
elements_m = [[0.2, 0.1, 1.5], [0.6, 0.1, 1.5]]
pairs = [[0, 1]]
[sources.talker]
sound = { use = "clip", clip = "ru-female-1" }
trajectory = { use = "still", position_m = [2, 1.5, 1.5] }
intervals = [[0.0, 0.8]]
[nominal]
height_m = 1.5
"""

STUDY = """
scenes = ["./scene.toml"]
metrics = ["ospa"]
[pipelines]
ck-phd = {}
"""


def sonobench(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "sonobench", *arguments], cwd=folder, capture_output=True, text=True, timeout=120)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    work = tmp_path / "work"
    work.mkdir()
    (work / "scene.toml").write_text(SCENE)
    (work / "study.toml").write_text(STUDY)
    return work


def refused(folder: Path, *arguments: str) -> str:
    before = sorted(p.relative_to(folder) for p in folder.rglob("*"))
    done = sonobench(folder, *arguments)
    assert done.returncode == 2, (done.returncode, done.stdout, done.stderr)
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    assert sorted(p.relative_to(folder) for p in folder.rglob("*")) == before
    return done.stderr


def test_the_unspoilt_scene_and_study_are_valid(folder: Path) -> None:
    for name in ("scene.toml", "study.toml"):
        done = sonobench(folder, "data", "validate", name)
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("position_m = [2, 1.5, 1.5]", "position_m = [5, 1.5, 1.5]", ["talker", "room"]),
        ("[0.6, 0.1, 1.5]", "[0.6, -0.1, 1.5]", ["wall", "room"]),
        ("pairs = [[0, 1]]", "pairs = [[0, 1]]\nrate_hz = [16000, 8000]", ["wall", "rate", "16000", "8000"]),
        ('clip = "ru-female-1"', 'clip = "ru-femal-1"', ["talker", "'ru-femal-1'", "ru-female-1"]),
        ("duration_s = 1.0", "duration_s = -1.0", ["duration_s", "-1"]),
        ("intervals = [[0.0, 0.8]]", "intervals = [[0.8, 0.1]]", ["talker", "interval"]),
    ],
)
def test_a_faulty_scene_is_refused(folder: Path, old: str, new: str, words: list[str]) -> None:
    assert old in SCENE
    (folder / "scene.toml").write_text(SCENE.replace(old, new))
    message = refused(folder, "data", "make", "scene.toml", "-o", "out.mcap")
    for word in words:
        assert word in message
    assert refused(folder, "run", "study.toml")


def test_an_unknown_pipeline_names_the_nearest(folder: Path) -> None:
    (folder / "study.toml").write_text(STUDY.replace("ck-phd", "ck-pdh"))
    assert "did you mean 'ck-phd'" in refused(folder, "run", "study.toml")


def test_several_faults_come_together(folder: Path) -> None:
    (folder / "study.toml").write_text(
        STUDY.replace("ck-phd = {}", "ck-phd = { tracker = { prune_wight = 1 } }\nnobdy = {}") + "\n[sweep]\n'scene.nois.snr_db' = [1]\n"
    )
    message = refused(folder, "run", "study.toml")
    assert "prune_wight" in message
    assert "nobdy" in message


def test_an_empty_study_is_refused(folder: Path) -> None:
    (folder / "study.toml").write_text("")
    message = refused(folder, "run", "study.toml")
    assert "pipelines" in message
    assert "scenes" in message


def test_a_truncated_recording_is_called_unfinished(folder: Path) -> None:
    assert sonobench(folder, "data", "make", "scene.toml", "-o", "whole.mcap").returncode == 0
    content = (folder / "whole.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(content[: len(content) * 2 // 3])
    for verb in (
        ["data", "info", "cut.mcap"],
        ["data", "validate", "cut.mcap"],
        ["replay", "cut.mcap", "--pipeline", "ck-phd", "-o", "x.mcap"],
    ):
        message = refused(folder, *verb)
        assert "cut.mcap" in message
        assert "unfinished" in message or "truncated" in message


def test_an_mcap_that_is_not_ours_is_said_to_be_so(folder: Path) -> None:
    from mcap.writer import Writer

    with open(folder / "other.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start("", "another tool")
        schema = writer.register_schema("thing", "jsonschema", b"{}")
        channel = writer.register_channel("/thing", "json", schema)
        writer.add_message(channel, 0, b"{}", 0)
        writer.finish()
    (folder / "text.mcap").write_text("hello")
    assert "not a sonobench.recording" in refused(folder, "data", "info", "other.mcap")
    assert "MCAP" in refused(folder, "data", "info", "text.mcap")
    assert "no such file" in refused(folder, "data", "info", "none.mcap").lower()


def test_a_folder_that_is_missing_is_said_to_be_so(folder: Path) -> None:
    assert "nowhere" in refused(folder, "data", "make", "scene.toml", "-o", "nowhere/out.mcap")


def test_a_pipeline_that_reads_samples_refuses_a_recording_without_any(folder: Path) -> None:
    assert sonobench(folder, "data", "make", "chen2012", "-o", "scans.mcap").returncode == 0
    message = refused(folder, "replay", "scans.mcap", "--pipeline", "ck-phd")
    assert "samples" in message


def test_a_recording_is_written_only_where_it_can_be_read_again(folder: Path) -> None:
    assert "must end in .mcap" in refused(folder, "data", "make", "scene.toml", "-o", "out.txt")
    assert "must end in .mcap" in refused(folder, "replay", "golden", "--pipeline", "nobody", "-o", "out.txt")
    assert "ends in .mcap" in refused(folder, "data", "info", "scene.toml")


def test_a_sound_that_cannot_be_read_is_not_valid(folder: Path) -> None:
    (folder / "noise.flac").write_bytes(b"no sound at all")
    (folder / "scene.toml").write_text(SCENE.replace('"ru-female-1"', '"noise.flac"'))
    message = refused(folder, "data", "validate", "scene.toml")
    assert "sources.talker.sound" in message
    assert "noise.flac: cannot be read as sound" in message


def test_a_scene_that_fits_into_no_memory_is_refused(folder: Path) -> None:
    (folder / "scene.toml").write_text(SCENE.replace("duration_s = 1.0", "duration_s = 1e9").replace("16000\n", "1e12\nperiod_s = 1e-3\n"))
    message = refused(folder, "data", "make", "scene.toml", "-o", "out.mcap")
    assert "1e+21 samples" in message
    assert "1e+12 evaluation times" in message


def test_an_unknown_role_is_refused(folder: Path) -> None:
    assert "did you mean 'metric'" in refused(folder, "plugins", "list", "--role", "metrics")
    assert "did you mean 'delay'" in refused(folder, "plugins", "show", "phat", "--role", "delays")


def test_a_cache_that_cannot_be_made_leaves_no_run_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SONOBENCH_CACHE", str(folder / "scene.toml" / "cache"))
    assert "SONOBENCH_CACHE" in refused(folder, "run", "study.toml")


def test_a_plugin_that_fails_at_import_shows_its_own_lines_only(folder: Path) -> None:
    (folder / "mine.py").write_text("import json\njson.loads('{')\n")
    done = sonobench(folder, "run", "quickstart", "--dry-run", "--plugin", "mine.py")
    assert done.returncode == 2
    assert "mine.py: JSONDecodeError" in done.stderr
    assert "line 2" in done.stderr
    assert "registry.py" not in done.stderr
    assert "importlib" not in done.stderr


def test_a_run_without_any_score_says_why_in_one_line_for_each_cause(folder: Path) -> None:
    (folder / "noise.flac").write_bytes(b"no sound at all")
    (folder / "scene.toml").write_text(SCENE.replace('"ru-female-1"', '"noise.flac"'))
    (folder / "study.toml").write_text("repetitions = 2\n" + STUDY)
    done = sonobench(folder, "run", "study.toml", "--jobs", "1")
    assert done.returncode == 3, done.stderr
    assert "no board" in done.stdout
    assert done.stderr.count("noise.flac: cannot be read as sound") == 1
    (line,) = (text for text in done.stderr.splitlines() if text.startswith("ck-phd"))
    assert line.split()[:3] == ["ck-phd", "error", "2"]


def test_a_replay_whose_tracker_raises_is_a_failed_trial(folder: Path) -> None:
    (folder / "mine.py").write_text(
        "from dataclasses import dataclass\n"
        "from sonobench import Space, hookimpl\n"
        "@dataclass(frozen=True)\n"
        "class Raises:\n"
        "    space = Space.of('x_m', 'y_m')\n"
        "    def init(self, rng, setup): return None\n"
        "    def step(self, rng, state, scan): raise ValueError('as told')\n"
        "@hookimpl\n"
        "def sonobench_components():\n"
        "    return {'tracker': {'raises': Raises}, 'pipeline': {'mine': {'use': 'ck-phd', 'tracker': 'raises'}}}\n"
    )
    done = sonobench(folder, "replay", "golden", "--pipeline", "mine", "--plugin", "mine.py", "-o", "out.mcap")
    assert done.returncode == 3
    assert "error: pipeline mine failed on golden: ValueError: as told" in done.stderr
    assert "please report" not in done.stderr
    assert not (folder / "out.mcap").exists()
