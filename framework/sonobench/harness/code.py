"""Which code a component depends on, as a digest: found by reading sources, never by importing them.

For every class in a built object: the syntax tree, without docstrings, of its module and, transitively, of every
module of its own root, of sonobench, and of anything not installed from a wheel, that it imports (also inside functions),
plus the versions of the other distributions and of Python, plus the files that a component declares in an attribute
`files`. A comment, a docstring, the command line and the board change nothing; a helper's helper does.
What runs beyond that is seen when it runs: `sonobench.uses`.
"""

from __future__ import annotations

import ast
import dataclasses
import hashlib
import importlib.machinery
import importlib.metadata
import json
import platform
import re
import sys
import sysconfig
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from sonobench.errors import InputError

_LOCAL = "sonobench_plugin_"  # modules of plugin files are named by their content; see registry.load_file
_DOTTED = re.compile(r"\.*[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")
_Imported = tuple[str, str]  # (module, name), name "" for a plain import of the module


@dataclass(frozen=True, slots=True)
class Closure:
    """What code depends on.

    Attributes:
        modules: digest of the syntax tree by module; a plugin file goes by its file name.
        distributions: version by name, of what is imported but not read.
        names: the modules as Python names them.
        sources: when the files of the modules, and the declared data files, were last changed (ns), by path.
        files: SHA-256 of the declared data files by path; keys take their names, not their folders.
    """

    modules: Mapping[str, str]
    distributions: Mapping[str, str]
    names: tuple[str, ...] = ()
    sources: Mapping[str, int] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)

    @property
    def digest(self) -> str:
        """One SHA-256 of it all, and of Python's version."""
        return hashlib.sha256(json.dumps(self.to_table(), sort_keys=True).encode()).hexdigest()

    def to_table(self) -> dict[str, Any]:
        """What the digest covers."""
        files = sorted([Path(path).name, sha] for path, sha in self.files.items())
        return {
            "modules": dict(self.modules),
            "distributions": dict(self.distributions),
            "files": files,
            "python": platform.python_version(),
        }


def code(*objects: Any) -> str:
    """Digest of the code that built objects depend on; a module's name (str) stands for that module."""
    return closure(*objects).digest


def closure(*objects: Any) -> Closure:
    """The modules, distributions and files that built objects depend on; a module's name (str) stands for that module."""
    found = _closure(frozenset(name for o in objects for name in ([o] if isinstance(o, str) else modules_of(o))))
    stats = [(path, _modified_ns(path)) for o in objects if not isinstance(o, str) for path in sorted(files_of(o))]
    if not stats:
        return found
    return replace(found, files={str(p): _sha256(p, ns) for p, ns in stats}, sources={**found.sources, **{str(p): ns for p, ns in stats}})


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


def files_of(value: Any) -> set[Path]:
    """The data files that the components of a built object declare in an attribute `files`, recursively."""
    found: set[Path] = set()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        try:
            found |= {Path(f).resolve() for f in getattr(value, "files", ())}
        except Exception as error:  # a component's own property
            raise InputError(f"{type(value).__name__}.files must be the paths of its data files: {type(error).__name__}: {error}") from None
        for each in dataclasses.fields(value):
            found |= files_of(getattr(value, each.name))
    elif isinstance(value, Mapping):
        found.update(*map(files_of, value.values()))
    elif isinstance(value, (tuple, list)):
        found.update(*map(files_of, value))
    return found


def _modified_ns(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


@lru_cache(maxsize=1024)
def _sha256(path: Path, modified_ns: int) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if modified_ns else "missing"  # the trial will say so itself


def forget() -> None:
    """Read sources anew (a long-lived notebook calls it between runs)."""
    for function in (_closure, _location, _distribution, _installed):
        function.cache_clear()


@cache
def _closure(start: frozenset[str]) -> Closure:
    modules: dict[str, str] = {}
    distributions: dict[str, str] = {}
    seen = {m for name in start for m in (name, *_parents(name))}
    sources: dict[str, int] = {}
    todo = sorted(seen)
    while todo:
        name = todo.pop()
        path = _location(name)
        if path is None:
            continue
        sources[str(path)] = modified_ns = path.stat().st_mtime_ns
        digest, imports = _read(path, name, modified_ns)
        modules[f"file:{path.name}" if name.startswith(_LOCAL) else name] = digest
        for target in (t for i in imports for t in _targets(*i)):
            root = target.partition(".")[0]
            if _followed(root, name.partition(".")[0]):
                new = {target, *_parents(target)} - seen
                seen |= new
                todo += sorted(new)
            elif root not in sys.stdlib_module_names:
                distributions[root] = _distribution(root)
    return Closure(dict(sorted(modules.items())), dict(sorted(distributions.items())), tuple(sorted(seen)), sources)


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
    """Every import in a module, wherever it stands but under `if TYPE_CHECKING`, and names read off imported modules."""
    owners: dict[str, str] = {}
    attributes: list[tuple[str, str]] = []
    for node in _running(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, ""
                owners[alias.asname or alias.name.partition(".")[0]] = alias.name if alias.asname else alias.name.partition(".")[0]
        elif isinstance(node, ast.ImportFrom):
            base = _base(node, name, is_package)
            for alias in node.names:
                yield base, alias.name
                if _is_submodule(base, alias.name):
                    owners[alias.asname or alias.name] = f"{base}.{alias.name}"
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            attributes.append((node.value.id, node.attr))
    read = {(owners[owner], attribute) for owner, attribute in attributes if owner in owners}
    yield from ((o, a) for o, a in read if _followed(o.partition(".")[0], name.partition(".")[0]))


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
        if name != "*" and _is_submodule(module, name):
            return [module, f"{module}.{name}"]
        return [module, *_lazy_homes(module, name)]
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


def _lazy_homes(module: str, name: str) -> tuple[str, ...]:
    """The modules that a module's own `__getattr__` may take a name from: where it says so (under TYPE_CHECKING, or as a
    table of strings), that one; else every submodule that it names."""
    path = _location(module)
    if path is None or path.suffix != ".py" or not _followed(module.partition(".")[0], ""):
        return ()
    said, bound, all_ = _facade(path, module, path.stat().st_mtime_ns)
    if name in said:
        return (said[name],)
    return all_ if name == "*" or name not in bound else ()


@lru_cache(maxsize=256)
def _facade(path: Path, module: str, _mtime_ns: int) -> tuple[dict[str, str], frozenset[str], tuple[str, ...]]:
    """Of a module with a `__getattr__`: home by name where it says so, the names bound in it, and all submodules that it names."""
    tree = ast.parse(path.read_bytes())
    if not any(isinstance(node, ast.FunctionDef) and node.name == "__getattr__" for node in tree.body):
        return {}, frozenset(), ()
    package = module if path.stem == "__init__" else module.rpartition(".")[0]
    said = {n: f"{base}.{n}" if _is_submodule(base, n) else base for n, base in _reexports(path, module, _mtime_ns).items()}
    for node in ast.walk(tree):
        if isinstance(node, ast.Dict):
            for key, value in zip(node.keys, node.values, strict=True):
                home = _submodule(package, value.elts[0] if isinstance(value, (ast.Tuple, ast.List)) and value.elts else value)
                if isinstance(key, ast.Constant) and home is not None:
                    said.setdefault(str(key.value), home)
    named = (_submodule(package, node) for node in ast.walk(tree))
    bound = frozenset(n.id for n in ast.walk(tree) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store))
    bound |= {n.name for n in tree.body if isinstance(n, (ast.FunctionDef, ast.ClassDef))}
    return said, bound, tuple(sorted({n for n in named if n is not None}.union(said.values())))


def _submodule(package: str, node: ast.AST | None) -> str | None:
    """The submodule that a string in a source names, relative to its package or in full."""
    if not isinstance(node, ast.Constant) or not isinstance(node.value, str) or not _DOTTED.fullmatch(node.value):
        return None
    for name in (f"{package}.{node.value.lstrip('.')}", node.value):
        if name.startswith(f"{package}.") and _location(name) is not None:
            return name
    return None


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
