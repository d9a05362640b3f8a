"""Starting costs nothing that a verb does not use."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

HEAVY = (
    "numpy",
    "scipy",
    "pandas",
    "pluggy",
    "numba",
    "mcap",
    "matplotlib",
    "pyarrow",
    "cattrs",
    "rich",
    "sonobench_plugins",
    "sonobench_datasets",
)


def modules_after(arguments: list[str]) -> set[str]:
    code = f"""
import sys, io, contextlib, json
from sonobench.cli import main
with contextlib.redirect_stdout(io.StringIO()):
    try: main({arguments!r})
    except SystemExit as stop: assert stop.code == 0, stop.code
print(json.dumps(sorted({{m.split('.')[0] for m in sys.modules}})))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout))


@pytest.mark.parametrize(
    "verb", [[], ["run"], ["board"], ["report"], ["replay"], ["data"], ["data", "make"], ["plugins"], ["plugins", "check"]]
)
def test_help_imports_no_numpy_pandas_pluggy_or_plugin(verb: list[str]) -> None:
    assert not modules_after([*verb, "--help"]) & set(HEAVY)


def test_importing_the_package_imports_nothing_heavy() -> None:
    code = "import sonobench, sys, json; print(json.dumps(sorted({m.split('.')[0] for m in sys.modules})))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(json.loads(done.stdout)) & set(HEAVY)


def test_the_lazy_facade_offers_what_it_says() -> None:
    import sonobench

    assert sorted(sonobench._HOME) == sonobench.__all__
    for name in sonobench.__all__:
        assert getattr(sonobench, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = sonobench.nothing


def test_listing_plugins_imports_no_pandas() -> None:
    assert not modules_after(["data", "list"]) & {"pandas", "numba", "matplotlib"}


def test_checking_a_plugin_that_ends_the_process_is_a_failed_check(tmp_path: Path) -> None:
    (tmp_path / "rude.py").write_text(
        "import os\nfrom dataclasses import dataclass\nfrom sonobench import hookimpl\n\n"
        "@dataclass(frozen=True)\nclass Rude:\n    def correlate(self, spectra, pairs):\n        os._exit(0)\n\n"
        "@hookimpl\ndef sonobench_components():\n    return {'delay': {'rude': Rude}}\n"
    )
    done = subprocess.run([sys.executable, "-m", "sonobench", "plugins", "check", "rude.py"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 3
    assert "ended the process" in done.stdout


def test_a_broken_plugin_file_is_listed_with_its_reason(tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text("import nothing_of_that_name\n")
    command = [sys.executable, "-m", "sonobench", "plugins", "list", "--plugin", "broken.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0
    assert "broken.py" in done.stdout
    assert "unavailable: ModuleNotFoundError: No module named 'nothing_of_that_name'" in done.stdout
