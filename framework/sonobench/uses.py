"""What running code used: imports, files, programs and connections, by the module that asked for them.

Sources are read to find what code depends on (`harness.code`), but an import of a computed name or a file that is opened
can only be seen when it happens. `watching` is entered where plugins are loaded, components built and trials run; what
it sees is kept for the life of the process, because what was read once may be used ever after (a cached table, a module
that is imported already). Not seen: what compiled libraries open by themselves.
"""

from __future__ import annotations

import builtins
import importlib
import importlib.util
import os
import sys
import sysconfig
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from types import FrameType, FunctionType, ModuleType
from typing import Any

_LOCAL = "sonobench_plugin_"  # modules of plugin files are named by their content
_BOUNDARY = "sonobench.harness.trial"  # below this module's frames stands the harness, not a component
# by reader: a module's file, or its name where that is made of the content (a plugin file's)
_IMPORTED: dict[str, set[str]] = {}  # names of modules
_READ: dict[str, set[str]] = {}  # files
_OUTSIDE: dict[str, set[str]] = {}  # programs and connections, in words
_WRITTEN: set[str] = set()
_LOADED_NS: dict[str, int] = {}  # when a source was last changed, as a module was made of it
_PLUGIN_ROOTS: set[str] = set()
_WORDS: Mapping[str, Callable[[tuple[Any, ...]], str]] = {
    "subprocess.Popen": lambda a: f"the program {a[0]}",
    "os.system": lambda a: f"the program {os.fsdecode(a[0])}",
    "os.posix_spawn": lambda a: f"the program {os.fsdecode(a[0])}",
    "os.exec": lambda a: f"the program {os.fsdecode(a[0])}",
    "socket.connect": lambda a: f"a connection to {a[1]}",
}
_SYSTEM = ("/proc", "/sys", "/dev", "/etc", "/usr/lib", "/usr/share")
_import, _import_module = builtins.__import__, importlib.import_module
_LOADER = "<frozen importlib"
_state = {"depth": 0, "hooked": 0}


def follow(modules: Iterable[str]) -> None:
    """What modules below these roots use is of interest, though they are installed."""
    if new := {m.partition(".")[0] for m in modules} - _PLUGIN_ROOTS - {"sonobench"}:
        _PLUGIN_ROOTS.update(new)
        _is_of_interest.cache_clear()


@contextmanager
def watching() -> Iterator[None]:
    """Note what code in this block imports and opens."""
    if not _state["hooked"]:  # an audit hook stays for good; outside of these blocks it does nothing
        _state["hooked"] = 1
        sys.addaudithook(_audit)
    if not _state["depth"]:
        builtins.__import__, importlib.import_module = _noted_import, _noted_import_module
    _state["depth"] += 1
    try:
        yield
    finally:
        _state["depth"] -= 1
        if not _state["depth"]:
            builtins.__import__, importlib.import_module = _import, _import_module


def beyond(known: Collection[str], files: Mapping[str, int], allowed: Sequence[str] = ()) -> list[str]:
    """What the modules `known` used that is neither among them nor in `files`, in words; and what changed meanwhile.

    Args:
        known: names of modules whose sources were read.
        files: when they, and declared data files, were last changed (ns), by path.
        allowed: folders and files that anybody may read.
    """
    found: set[str] = set()
    seen, sources = set(known), set(files)
    readers = [(name.partition(".")[0], _key(name)) for name in known]
    roots = (*_SYSTEM, *_installed(), *(str(Path(a).resolve()) for a in allowed), *allowed)
    paths: set[str] = set()
    while readers:
        root, reader = readers.pop()
        found |= _OUTSIDE.get(reader, set())
        paths |= {p for p in map(_source, _READ.get(reader, ())) if p is not None}
        for name in sorted(_IMPORTED.get(reader, set()) - seen):
            if not _has_version(name, root):
                found.add(f"module {name}")
                seen.add(name)
                readers.append((name.partition(".")[0], _key(name)))
                sources.add(str(getattr(sys.modules.get(name), "__file__", None)))
    found |= {f"file {p}" for p in paths - sources - _WRITTEN if not _is_below(p, roots) and os.path.exists(p)}
    return sorted(found | _changed(known, files))


def _changed(known: Iterable[str], files: Mapping[str, int]) -> set[str]:
    found = set()
    for path, modified_ns in files.items():
        with suppress(OSError):
            if os.stat(path).st_mtime_ns != modified_ns:
                found.add(f"file {path}, edited while the study ran")
    for name in known:
        own = str(getattr(sys.modules.get(name), "__file__", None))
        if own in files and _LOADED_NS.get(own, files[own]) != files[own]:
            found.add(f"module {name}, edited after this process had imported it")
    return found


def _noted_import(
    name: str,
    globals: Mapping[str, Any] | None = None,
    locals: Mapping[str, Any] | None = None,
    fromlist: Sequence[str] | None = (),
    level: int = 0,
) -> ModuleType:
    module = _import(name, globals, locals, fromlist or (), level)
    reader = _interesting(globals or {}) if _state["depth"] else None
    if reader is not None:
        base = module.__name__ if fromlist else name
        found = _IMPORTED.setdefault(reader, set())
        if not level or fromlist:
            found.add(base)
        for item in fromlist or ():
            value = getattr(module, item, None)
            if isinstance(value, ModuleType):
                found.add(value.__name__)
            elif isinstance(value, (type, FunctionType)):  # a lazy façade gives it from elsewhere
                found.add(value.__module__)
    return module


def _noted_import_module(name: str, package: str | None = None) -> ModuleType:
    module = _import_module(name, package)
    reader = _reader(sys._getframe(1)) if _state["depth"] else None
    if reader is not None:
        _IMPORTED.setdefault(reader, set()).add(module.__name__)
    return module


_noted_import_module.__module__ = "importlib"  # a module that takes it by name has not taken it from here


def _audit(event: str, args: tuple[Any, ...]) -> None:
    if not _state["depth"]:
        return
    if event == "open":
        path, mode, flags = args
        if isinstance(path, (str, bytes)):
            _note_open(os.path.abspath(os.fsdecode(path)), mode, flags)
    elif event in _WORDS and (reader := _reader(sys._getframe(1))) is not None:
        _OUTSIDE.setdefault(reader, set()).add(_WORDS[event](args))


def _note_open(path: str, mode: str | None, flags: int) -> None:
    frame: FrameType | None = sys._getframe(2)
    if frame is not None and frame.f_code.co_filename.startswith(_LOADER):
        note_loaded(_source(path))
        while frame is not None and frame.f_code.co_filename.startswith(_LOADER):
            frame = frame.f_back
        if (
            frame is None or str(frame.f_globals.get("__name__")).partition(".")[0] == "sonobench"
        ):  # noted as an import, or a façade's own rooms
            return
    reader = _reader(frame)
    if reader is None:
        return
    access = flags & os.O_ACCMODE
    writes = any(m in mode for m in "wax") if mode else access == os.O_WRONLY or bool(flags & (os.O_CREAT | os.O_TRUNC))
    if writes:
        _WRITTEN.add(path)
    else:
        _READ.setdefault(reader, set()).add(path)


def note_loaded(source: str | None) -> None:
    """Remember that a module has what its source says now."""
    if source is not None and not _is_below(source, _installed()):
        with suppress(OSError):
            _LOADED_NS[source] = os.stat(source).st_mtime_ns


def _reader(frame: FrameType | None) -> str | None:
    """The innermost module of interest on the stack; a lazy façade's `__getattr__` acts for who asked it."""
    facade = None
    while frame is not None:
        name = frame.f_globals.get("__name__")
        if name == _BOUNDARY:
            break
        if (found := _interesting(frame.f_globals)) is not None:
            if frame.f_code.co_name != "__getattr__":
                return found
            facade = facade or found
        frame = frame.f_back
    return facade


def _interesting(globals: Mapping[str, Any]) -> str | None:
    """The reader whose code has these globals, None if it is not of interest."""
    name, file = globals.get("__name__"), globals.get("__file__")
    if not isinstance(name, str) or not isinstance(file, str) or not _is_of_interest(name, file):
        return None
    return name if name.startswith(_LOCAL) else file


def _key(name: str) -> str:
    return name if name.startswith(_LOCAL) else str(getattr(sys.modules.get(name), "__file__", None))


@cache
def _is_of_interest(name: str, file: str) -> bool:
    root = name.partition(".")[0]
    if root in ("sonobench", "__main__", "builtins") or root in sys.stdlib_module_names:
        return False
    return root in _PLUGIN_ROOTS or not _is_below(file, _installed())


def _has_version(name: str, importers_root: str) -> bool:
    """Whether a version stands for a module's code (an installed one's, or Python's); sonobench's packages hold only re-exports."""
    root = name.partition(".")[0]
    module = sys.modules.get(name)
    if root == "sonobench":
        return hasattr(module, "__path__")
    if root in sys.stdlib_module_names:
        return True
    file = getattr(module, "__file__", None)
    if file is None:  # built in, or a namespace that holds no code
        return True
    return root != importers_root and _is_below(file, _installed())


def _source(path: str) -> str | None:
    """The source of a compiled file; None for what Numba keeps beside it."""
    if "__pycache__" not in path:
        return path
    with suppress(ValueError):
        return importlib.util.source_from_cache(path)
    return None


def _is_below(path: str, folders: Iterable[str]) -> bool:
    return any(path == f or path.startswith(f.rstrip(os.sep) + os.sep) for f in folders)


@cache
def _installed() -> tuple[str, ...]:
    named = [sysconfig.get_path(p) for p in ("purelib", "platlib", "stdlib", "platstdlib")]
    named += [f"{prefix}/{lib}" for prefix in (sys.prefix, sys.base_prefix) for lib in ("lib", "lib64")]
    named += [*(p for p in sys.path if Path(p).name in ("site-packages", "dist-packages"))]
    return tuple(dict.fromkeys(n for n in named if n))
