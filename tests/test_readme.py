"""What the README shows is what happens."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from readme import README, blocks, write_files


def run(folder: Path, *arguments: str, timeout_s: float = 300.0) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "SONOBENCH_CACHE": str(folder / "cache")}
    return subprocess.run(
        [sys.executable, "-m", "sonobench", *arguments], cwd=folder, env=environment, capture_output=True, text=True, timeout=timeout_s
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_files(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", ["floor_phat.py", "loudest.py"])
def test_a_newcomers_plugin_is_short_imports_two_packages_and_subclasses_nothing(name: str) -> None:
    source = blocks("file")[name]
    assert len([line for line in source.splitlines() if line.strip()]) <= 20
    tree = ast.parse(source)
    roots = {n.module.split(".")[0] for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n.module}
    roots |= {a.name.split(".")[0] for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    assert roots == {"dataclasses", "numpy", "sonobench"}
    assert all(not n.bases for n in ast.walk(tree) if isinstance(n, ast.ClassDef))


@pytest.mark.parametrize("name", ["floor_phat.py", "loudest.py"])
def test_a_newcomers_plugin_passes_the_conformance_kit(folder: Path, name: str) -> None:
    done = run(folder, "plugins", "check", name)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_study_of_the_readme_runs_and_sweeps(folder: Path) -> None:
    done = run(folder, "run", "floor.toml")
    assert done.returncode == 0, done.stdout + done.stderr
    for entry in ("ck-phd", "mine[floor=0.05]", "mine[floor=0.2]"):
        assert entry in done.stdout
    board = run(folder, "board", "floor", "--metric", "gospa", "--format", "md")
    assert board.returncode == 0, board.stderr
    assert "gospa ↓ (m)" in board.stdout
    python = "from sonobench import Study\nrun = Study.load('floor.toml').run()\nprint(run.board('ospa'))"
    assert python.splitlines()[1] in README.read_text("utf-8").replace('"', "'")
    api = subprocess.run(
        [sys.executable, "-c", python],
        cwd=folder,
        env={**os.environ, "SONOBENCH_CACHE": str(folder / "cache")},
        capture_output=True,
        text=True,
    )
    assert api.returncode == 0, api.stderr
    assert "mine[floor=0.2]" in api.stdout


def test_the_recording_commands_of_the_readme_work(folder: Path) -> None:
    commands = re.search(r"## Recordings\n```sh\n(.*?)```", README.read_text("utf-8"), re.DOTALL)
    assert commands
    for line in commands.group(1).splitlines():
        done = run(folder, *line.removeprefix("sonobench ").split())
        assert done.returncode == 0, done.stderr
    assert (folder / "tracks.mcap").is_file()


def test_every_page_that_the_readme_links_exists() -> None:
    for target in re.findall(r"\]\((docs/[^)]+)\)", README.read_text("utf-8")):
        assert (README.parent / target).is_file(), target
