"""Somebody else's distribution, installed with pip, is found, fit, and used like the bundled one; a broken one is only listed."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest

HOME = Path(__file__).resolve().parents[1] / "third_party"


@pytest.fixture(scope="session")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that pip installed both distributions into."""
    folder = tmp_path_factory.mktemp("third-party")
    sources = [shutil.copytree(HOME / name, folder / "src" / name) for name in ("sonobench-dummy", "sonobench-dummy-broken")]
    options = [
        "--quiet",
        "--disable-pip-version-check",
        "--no-deps",
        "--no-index",
        "--no-build-isolation",
        "--target",
        str(folder / "site"),
    ]
    done = subprocess.run([sys.executable, "-m", "pip", "install", *options, *map(str, sources)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder / "site"


@pytest.fixture
def run(installed: Path, tmp_path: Path) -> Any:
    """Python in a process that has the distributions on its path."""
    environment = {
        **os.environ,
        "PYTHONPATH": str(installed),
        "SONOBENCH_CACHE": str(tmp_path / "cache"),
        "SONOBENCH_DUMMY_LOG": str(tmp_path / "observed"),
    }

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, env=environment, cwd=tmp_path)

    return run


def _cli(*arguments: str) -> list[str]:
    return ["-c", "import sys; from sonobench.cli import main; sys.exit(main())", *arguments]


def test_it_is_not_registered_where_it_is_not_installed() -> None:
    assert not any(p.name in ("dummy", "broken") for p in entry_points(group="sonobench"))


def test_plugins_list_shows_it_beside_the_bundled_and_the_broken_with_its_reason(run: Any) -> None:
    done = run(*_cli("plugins", "list", "--json"))
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)
    mine = {(r["role"], r["name"]): r for r in rows if r["distribution"] == "sonobench-dummy"}
    assert set(mine) == {("delay", "half-phat"), ("tracker", "best-cell"), ("pipeline", "half-cell"), ("pipeline", "recorded-cell")}
    assert {(r["version"], r["status"]) for r in mine.values()} == {("0.3.1", "ok")}
    (broken,) = [r for r in rows if r["distribution"] == "sonobench-dummy-broken"]
    assert broken["status"] == "unavailable: ModuleNotFoundError: No module named 'a_library_that_nobody_has'"
    assert any(r["distribution"] == "sonobench" and r["name"] == "phat" and r["status"] == "ok" for r in rows)


def test_its_components_hold_every_claim_of_the_kit(run: Any) -> None:
    code = """
from sonobench.registry import Registry
from sonobench.testing import check
registry = Registry.load()
mine = [e for e in registry.entries() if e.plugin.distribution == "sonobench-dummy"]
failed = [f for e in mine for f in check(e, e.role, registry) if f.result == "failed"]
print(len(mine), failed)
"""
    done = run("-c", code)
    assert done.stdout.strip() == "4 []", done.stdout + done.stderr


def test_a_study_runs_its_scene_and_pipeline_and_its_observer_sees_every_trial(run: Any, tmp_path: Path) -> None:
    (tmp_path / "walk.toml").write_text('scenes = ["dummy-hall"]\nrepetitions = 2\nmetrics = ["ospa"]\n[pipelines]\nrecorded-cell = {}\n')
    done = run(*_cli("run", "walk.toml", "--jobs", "1", "--out", "out"))
    assert done.returncode == 0, done.stdout + done.stderr
    assert "recorded-cell" in done.stdout
    observed = [json.loads(line) for line in (tmp_path / "observed").read_text().splitlines()]
    assert observed == [{"pipeline": "recorded-cell", "status": "ok"}] * 2


def test_what_only_the_broken_one_could_provide_is_refused_with_its_reason(run: Any) -> None:
    done = run(*_cli("plugins", "show", "half-fat"))
    assert done.returncode == 2
    assert "did you mean 'half-phat'?" in done.stderr
    code = """
from sonobench.components import build
from sonobench.registry import Registry
from sonobench.errors import SonobenchError
try:
    build("delay", "missing-one", Registry.load())
except SonobenchError as error:
    print(error)
"""
    said = run("-c", code).stdout
    assert "plugin broken (sonobench-dummy-broken) could not be loaded: ModuleNotFoundError" in said
