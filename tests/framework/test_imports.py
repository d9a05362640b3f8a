"""Imports point one way, and each library has one room; read from the source, so that a lazy import counts too."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import sonobench
import sonobench_plugins

FRAMEWORK = Path(sonobench.__file__).parent
PLUGINS = Path(sonobench_plugins.__file__).parent


def _modules(root: Path) -> list[Path]:
    return sorted(p for p in root.rglob("*.py") if "__pycache__" not in p.parts)


def _package(file: Path, root: Path) -> list[str]:
    return [root.name, *file.relative_to(root).parts[:-1]]


def _imports(file: Path, root: Path, top_level: bool = False) -> Iterator[tuple[str, str]]:
    """(module, imported name or "") of every import in a file, or only of those that run when it is imported."""
    for node in _nodes(ast.parse(file.read_text("utf-8")), top_level):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = _package(file, root)
            base = base[: len(base) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            yield from ((module, alias.name) for alias in node.names)


def _nodes(tree: ast.AST, top_level: bool) -> Iterator[ast.AST]:
    for node in ast.iter_child_nodes(tree):
        if top_level and isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
            continue
        if top_level and isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        yield from _nodes(node, top_level)


def _users(root: Path, library: str, top_level: bool = False) -> set[str]:
    """Files below a root that import a library, as paths relative to it."""
    return {
        f.relative_to(root).as_posix()
        for f in _modules(root)
        if any(module.split(".")[0] == library for module, _ in _imports(f, root, top_level))
    }


@pytest.mark.parametrize("library", ["sonobench_plugins", "sonobench_datasets"])
def test_the_framework_imports_no_bundled_algorithm_and_no_data(library: str) -> None:
    assert _users(FRAMEWORK, library) == set()


def test_the_framework_does_not_even_name_the_bundled_packages() -> None:
    named = [f.relative_to(FRAMEWORK).as_posix() for f in _modules(FRAMEWORK) if "sonobench_plugins" in f.read_text("utf-8")]
    assert named == []


def test_imports_are_seen_wherever_they_hide(tmp_path: Path) -> None:
    (tmp_path / "room").mkdir()
    file = tmp_path / "room" / "a.py"
    file.write_text(
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import pandas\n"
        "try:\n    import mcap.reader as r\nexcept ImportError:\n    pass\n"
        "def f():\n    from ..other import _private\n    import pandas\n"
    )
    everywhere = set(_imports(file, tmp_path))
    assert {("mcap.reader", ""), ("pandas", ""), (f"{tmp_path.name}.other", "_private")} <= everywhere
    assert set(_imports(file, tmp_path, top_level=True)) == {("typing", "TYPE_CHECKING"), ("mcap.reader", "")}
    assert _users(tmp_path, "mcap") == {"room/a.py"}


def test_plugins_import_only_public_names_of_sonobench() -> None:
    private = [
        f"{f.name}: from {module} import {name}"
        for f in _modules(PLUGINS)
        for module, name in _imports(f, PLUGINS)
        if module.split(".")[0] == "sonobench" and any(p.startswith("_") for p in [*module.split("."), name] if p)
    ]
    assert private == []


def test_plugins_import_no_private_names_of_each_other() -> None:
    private = [
        f"{f.name}: from {module} import {name}"
        for f in _modules(PLUGINS)
        for module, name in _imports(f, PLUGINS)
        if module.split(".")[0] == "sonobench_plugins" and any(p.startswith("_") for p in [*module.split("."), name] if p)
    ]
    assert private == []


def test_every_name_that_plugins_import_from_sonobench_is_there() -> None:
    import importlib

    for file in _modules(PLUGINS):
        for module, name in _imports(file, PLUGINS):
            if module.split(".")[0] == "sonobench" and name:
                assert hasattr(importlib.import_module(module), name), f"{file.name}: {module} has no {name}"


def test_log_alone_imports_mcap() -> None:
    assert {f.split("/")[0] for f in _users(FRAMEWORK, "mcap")} <= {"log"}
    assert _users(PLUGINS, "mcap") == set()


def test_board_and_the_run_folder_alone_load_pandas_by_being_imported() -> None:
    users = _users(FRAMEWORK, "pandas", top_level=True)
    assert {u for u in users if not u.startswith("board/") and u != "harness/run_folder.py"} == set()
    assert _users(PLUGINS, "pandas") == set()


def test_the_kit_and_the_command_line_load_nothing_heavy_by_being_imported() -> None:
    heavy = {"pandas", "numba", "scipy", "matplotlib", "pyarrow", "rich"}
    for room in ("cli", "testing"):
        found = {lib: sorted(u for u in _users(FRAMEWORK, lib, top_level=True) if u.startswith(f"{room}/")) for lib in heavy}
        assert {lib: users for lib, users in found.items() if users} == {}
    assert _users(FRAMEWORK, "numpy", top_level=True).isdisjoint(f"cli/{p.name}" for p in (FRAMEWORK / "cli").glob("*.py"))


def test_nobody_draws_from_numpys_global_generator() -> None:
    allowed = {"default_rng", "Generator", "SeedSequence", "BitGenerator", "PCG64", "Philox"}
    found = []
    for root in (FRAMEWORK, PLUGINS):
        for file in _modules(root):
            for node in ast.walk(ast.parse(file.read_text("utf-8"))):
                if (
                    isinstance(node, ast.Attribute)
                    and ast.unparse(node.value) in ("np.random", "numpy.random")
                    and node.attr not in allowed
                ):
                    found.append(f"{file.name}:{node.lineno} {ast.unparse(node)}")
    assert found == []
