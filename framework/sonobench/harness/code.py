"""Which code a component depends on, as a digest: found by reading sources, never by importing them.

For every class in a built object: the syntax tree, without docstrings, of its module and, transitively, of every
module of its own root, of sonobench, and of anything not installed from a wheel, that it imports (also inside functions),
plus the versions of the other distributions and of Python. A comment, a docstring, the command line and the board
change nothing; a helper's helper does.
"""

from __future__ import annotations

import ast
import dataclasses
import hashlib
import importlib.machinery
import importlib.metadata
import json
import platform
import sys
import sysconfig
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

_LOCAL = "sonobench_plugin_"  # modules of plugin files are named by their content; see registry.load_file
_Imported = tuple[str, str]  # (module, name), name "" for a plain import of the module


@dataclass(frozen=True, slots=True)
class Closure:
    """What code depends on.

    Attributes:
        modules: digest of the syntax tree by module; a plugin file goes by its file name.
        distributions: version by name, of what is imported but not read.
    """

    modules: Mapping[str, str]
    distributions: Mapping[str, str]

    @property
    def digest(self) -> str:
        """One SHA-256 of it all, and of Python's version."""
        text = json.dumps([dict(self.modules), dict(self.distributions), platform.python_version()], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


def code(*objects: Any) -> str:
    """Digest of the code that built objects depend on; a module's name (str) stands for that module."""
    return closure(*objects).digest


def closure(*objects: Any) -> Closure:
    """The modules and distributions that built objects depend on; a module's name (str) stands for that module."""
    return _closure(frozenset(name for o in objects for name in ([o] if isinstance(o, str) else modules_of(o))))


def modules_of(value: Any) -> set[str]:
    """Modules of the classes (and their bases) that make up a built object, recursively."""
    found: set[str] = set()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        found |= {c.__module__ for c in type(value).__mro__ if c.__module__ not in ("builtins", "typing")}
        for field in dataclasses.fields(value):
            found |= modules_of(getattr(value, field.name))
    elif isinstance(value, Mapping):
        found.update(*map(modules_of, value.values()))
    elif isinstance(value, (tuple, list)):
        found.update(*map(modules_of, value))
    return found


def forget() -> None:
    """Read sources anew (a long-lived notebook calls it between runs)."""
    for function in (_closure, _location, _distribution):
        function.cache_clear()


@cache
def _closure(start: frozenset[str]) -> Closure:
    modules: dict[str, str] = {}
    distributions: dict[str, str] = {}
    seen = {m for name in start for m in (name, *_parents(name))}
    todo = sorted(seen)
    while todo:
        name = todo.pop()
        path = _location(name)
        if path is None:
            continue
        digest, imports = _read(path, name, path.stat().st_mtime_ns)
        modules[f"file:{path.name}" if name.startswith(_LOCAL) else name] = digest
        for target in (t for i in imports for t in _targets(*i)):
            root = target.partition(".")[0]
            if _followed(root, name.partition(".")[0]):
                new = {target, *_parents(target)} - seen
                seen |= new
                todo += sorted(new)
            elif root not in sys.stdlib_module_names:
                distributions[root] = _distribution(root)
    return Closure(dict(sorted(modules.items())), dict(sorted(distributions.items())))


def has_version(module: str) -> bool:
    """Whether a module's code goes by a version (Python's own, or installed from a wheel) and need not be read."""
    return not _followed(module.partition(".")[0], "")


def _followed(root: str, own: str) -> bool:
    """Whether sources below `root` are read: our own, the importing module's own, and what has no version to go by."""
    if root in ("sonobench", own):
        return True
    if root in sys.stdlib_module_names or root in sys.builtin_module_names:
        return False
    path = _location(root)
    return path is not None and not any(path.is_relative_to(p) for p in _installed())


@cache
def _installed() -> tuple[Path, ...]:
    paths = {Path(p) for p in (sysconfig.get_path("purelib"), sysconfig.get_path("platlib")) if p}
    paths |= {Path(p) for p in sys.path if Path(p).name in ("site-packages", "dist-packages")}
    return (*paths, Path(sysconfig.get_path("stdlib")))


@cache
def _location(name: str) -> Path | None:
    """The source (or compiled extension) of a module, found without importing it; None for what has none."""
    loaded = sys.modules.get(name)
    if loaded is not None and getattr(loaded, "__file__", None):
        return Path(str(loaded.__file__))
    parent = name.rpartition(".")[0]
    if not parent:
        spec = importlib.machinery.PathFinder.find_spec(name)
        return Path(spec.origin) if spec and spec.origin and spec.origin not in ("built-in", "frozen") else None
    package = _location(parent)
    if package is None or package.stem != "__init__":
        return None
    spec = importlib.machinery.PathFinder.find_spec(name, [str(package.parent)])
    return Path(spec.origin) if spec and spec.origin else None


@lru_cache(maxsize=4096)
def _read(path: Path, name: str, _mtime_ns: int) -> tuple[str, tuple[_Imported, ...]]:
    content = path.read_bytes()
    if path.suffix != ".py":
        return hashlib.sha256(content).hexdigest(), ()
    tree = ast.parse(content)
    imports = tuple(sorted(set(_imports(tree, name, path.stem == "__init__"))))
    _drop_docstrings(tree)
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest(), imports


def _drop_docstrings(tree: ast.AST) -> None:
    for node in ast.walk(tree):
        if (
            isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef))
            and ast.get_docstring(node, False) is not None
        ):
            node.body = node.body[1:]


def _imports(tree: ast.AST, name: str, is_package: bool) -> Iterator[_Imported]:
    """Every import in a module, wherever it stands but under `if TYPE_CHECKING`, and names read off `import sonobench`."""
    facades: set[str] = set()
    attributes: list[tuple[str, str]] = []
    for node in _running(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, ""
                if alias.name == "sonobench" or (alias.name.startswith("sonobench.") and not alias.asname):
                    facades.add(alias.asname or "sonobench")
        elif isinstance(node, ast.ImportFrom):
            base = _base(node, name, is_package)
            yield from ((base, alias.name) for alias in node.names)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            attributes.append((node.value.id, node.attr))
    yield from (("sonobench", attribute) for owner, attribute in attributes if owner in facades)


def _running(node: ast.AST) -> Iterator[ast.AST]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and "TYPE_CHECKING" in (getattr(child.test, "id", ""), getattr(child.test, "attr", "")):
            for statement in child.orelse:
                yield statement
                yield from _running(statement)
            continue
        yield child
        yield from _running(child)


def _targets(module: str, name: str) -> list[str]:
    """The modules that `from module import name` depends on."""
    if not name:
        return [module]
    if module.partition(".")[0] != "sonobench":
        return [module, *([f"{module}.{name}"] if name != "*" and _is_submodule(module, name) else [])]
    return [_home(module, name)]


def _home(module: str, name: str) -> str:
    """The module of sonobench that defines a name.

    Its façades re-export lazily and say from where under TYPE_CHECKING; a façade must not tie every room together.
    """
    if _is_submodule(module, name):
        return f"{module}.{name}"
    path = _location(module)
    if path is not None and path.stem == "__init__":
        base = _reexports(path, module, path.stat().st_mtime_ns).get(name, module)
        return module if base == module else _home(base, name)
    return module


@lru_cache(maxsize=256)
def _reexports(path: Path, name: str, _mtime_ns: int) -> dict[str, str]:
    found = {}
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.ImportFrom):
            base = _base(node, name, True)
            found.update({alias.name: base for alias in node.names if not alias.asname})
    return found


def _base(node: ast.ImportFrom, name: str, is_package: bool) -> str:
    """The module that a (relative) `from … import` in module `name` names."""
    if not node.level:
        return node.module or ""
    above = name.split(".")
    above = above[: len(above) - node.level + is_package]
    return ".".join([*above, *([node.module] if node.module else [])])


def _is_submodule(module: str, name: str) -> bool:
    path = _location(module)
    return path is not None and path.stem == "__init__" and _location(f"{module}.{name}") is not None


def _parents(module: str) -> list[str]:
    """Packages whose `__init__` runs when a module is imported; sonobench's own hold only re-exports."""
    parts = module.split(".")
    return [] if parts[0] == "sonobench" else [".".join(parts[:n]) for n in range(1, len(parts))]


@cache
def _distribution(root: str) -> str:
    try:
        return importlib.metadata.version(root)
    except importlib.metadata.PackageNotFoundError:
        names = importlib.metadata.packages_distributions().get(root, [])
        return ", ".join(f"{n} {importlib.metadata.version(n)}" for n in sorted(set(names))) or "unknown"


def numba_digest(modules: Iterable[str]) -> str:
    """Digest that names the folder of compiled code: of the modules below these roots that use Numba, and all that those import.

    A plugin file itself is left out: Numba sees its own edits, and everybody else's code need not be compiled again.
    """
    users: set[str] = set()
    for root in sorted({m.partition(".")[0] for m in modules if not m.startswith((_LOCAL, "file:"))}):
        path = _location(root)
        if path is None or path.stem != "__init__":
            users |= {root} if path is not None else set()
            continue
        for file in sorted(path.parent.rglob("*.py")):
            if b"numba" in file.read_bytes():
                parts = file.relative_to(path.parent.parent).with_suffix("").parts
                users.add(".".join(parts[:-1] if parts[-1] == "__init__" else parts))
    return closure(*users).digest
