"""Which edits change a component's code digest, and which do not."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

from sonobench.harness.code import closure, code, forget, numba_digest

FILES = {
    "__init__.py": "",
    "tracker.py": '''"""About it."""
from dataclasses import dataclass
from zoo.helper import help_
import numpy as np

@dataclass(frozen=True)
class Tracker:
    """A tracker."""
    gain: float = 1.0

    def step(self, x):
        """Step."""
        from zoo.late import later
        return later(help_(x)) * self.gain
''',
    "helper.py": "from .deep import deep\ndef help_(x):\n    return deep(x)\n",
    "deep.py": "def deep(x):\n    return x\n",
    "late.py": "def later(x):\n    return x\n",
    "stranger.py": "def nobody(x):\n    return x\n",
    "fast.py": "from numba import njit\nfrom zoo.deep import deep\n@njit\ndef fast(x):\n    return x\n",
}


@pytest.fixture
def zoo(tmp_path, monkeypatch):
    package = tmp_path / "zoo"
    package.mkdir()
    for name, text in FILES.items():
        (package / name).write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    forget()
    yield package
    for name in [n for n in sys.modules if n.partition(".")[0] == "zoo"]:
        del sys.modules[name]
    forget()


def tracker():
    return importlib.import_module("zoo.tracker").Tracker()


def edited(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    forget()


@pytest.mark.parametrize("name", ["tracker.py", "helper.py", "deep.py", "late.py"])
def test_an_edit_of_whatever_a_component_imports_changes_its_code(zoo, name):
    built = tracker()
    before = code(built)
    edited(zoo / name, "return ", "return 2 * ")
    assert code(built) != before


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("tracker.py", '"""A tracker."""', '"""Another word."""'),
        ("tracker.py", '"""Step."""', '"""Step."""  # why'),
        ("deep.py", "return x", "return x  # a comment"),
        ("stranger.py", "return x", "return 2 * x"),
    ],
)
def test_comments_docstrings_and_modules_that_nobody_imports_change_nothing(zoo, name, old, new):
    built = tracker()
    before = code(built)
    edited(zoo / name, old, new)
    assert code(built) == before


def test_the_parameters_of_a_component_are_not_its_code(zoo):
    module = importlib.import_module("zoo.tracker")
    assert code(module.Tracker(1.0)) == code(module.Tracker(2.0))


def test_versions_of_other_distributions_count_and_their_sources_do_not(zoo):
    found = closure(tracker())
    assert "numpy" in found.distributions
    assert not any(m.startswith("numpy") for m in found.modules)


def test_a_name_read_through_the_lazy_facade_leads_to_its_home(zoo):
    edited(
        zoo / "tracker.py",
        "import numpy as np",
        "import numpy as np\nfrom sonobench import Estimate\nimport sonobench as sb\nP = sb.Mixture",
    )
    found = closure(tracker()).modules
    assert "sonobench.types" in found
    assert "sonobench.protocols" in found
    assert not any(m.startswith(("sonobench.harness", "sonobench.cli", "sonobench.board", "sonobench.scene")) for m in found)


def test_a_scene_does_not_depend_on_the_harness_the_board_or_the_command_line():
    found = closure("sonobench.scene.scene", "sonobench.pipeline", "sonobench.scoring").modules
    assert "sonobench.scene.tables" in found
    assert not any(m.startswith(("sonobench.harness", "sonobench.cli", "sonobench.board", "sonobench.report")) for m in found)


def test_imports_for_type_checkers_only_do_not_count(zoo):
    edited(
        zoo / "deep.py", "def deep", "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from zoo.stranger import nobody\ndef deep"
    )
    assert "zoo.stranger" not in closure(tracker()).modules


def test_a_plugin_file_counts_by_its_syntax_tree_and_not_by_the_name_that_its_content_gives_it(tmp_path):
    from sonobench.registry import load_file

    text = "from dataclasses import dataclass\n@dataclass(frozen=True)\nclass A:\n    x: float = 1.0\n"
    digests = []
    for number, content in enumerate([text, text + "# a comment\n", text + "B = 1\n"]):
        path = tmp_path / str(number) / "mine.py"
        path.parent.mkdir()
        path.write_text(content)
        digests.append(code(load_file(path, f"{number}" * 64).A()))
    assert digests[0] == digests[1] != digests[2]


def test_a_helper_of_a_compiled_function_renames_the_folder_of_compiled_code(zoo):
    before = numba_digest(["zoo.tracker"])
    edited(zoo / "stranger.py", "return x", "return 2 * x")
    assert numba_digest(["zoo.tracker"]) == before
    edited(zoo / "deep.py", "return x", "return 2 * x")
    assert numba_digest(["zoo.tracker"]) != before
