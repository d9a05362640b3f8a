"""The only loader of plugins.

Sources: the entry-point group `sonobench`, and files that a study or the command line names. Each loads by itself; a
broken one is kept with its reason and takes nothing else down.
"""

from __future__ import annotations

import difflib
import hashlib
import importlib
import importlib.util
import re
import sys
import traceback
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import pluggy

from sonobench import hookspecs, uses
from sonobench.errors import InputError, PluginError, UnavailableError
from sonobench.uses import follow, note_loaded, watching

_NAME = re.compile(r"[A-Za-z0-9][\w.-]*")
_LOADERS = (__file__, uses.__file__, importlib.__file__, "<frozen importlib._bootstrap>", "<frozen importlib._bootstrap_external>")


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """ "; did you mean 'x'?" for the nearest known word, or ""."""
    near = difflib.get_close_matches(word, list(known), n=1, cutoff=0.6)
    return f"; did you mean {near[0]!r}?" if near else ""


@dataclass(frozen=True, slots=True)
class Plugin:
    """One source of components.

    Attributes:
        name: entry point's name, or the file's path as given.
        distribution, version: who ships it; "local" and the head of the file's SHA-256 for a file.
        path: the file, or None for an entry point.
        reason: why it could not be loaded, "" when it could.
        details: the traceback behind `reason`.
    """

    name: str
    distribution: str
    version: str
    path: Path | None = None
    reason: str = ""
    details: str = ""


@dataclass(frozen=True, slots=True)
class Entry:
    """One registered component: `target` is a class, "package.module:Class", a table (a preset) or a preset's file."""

    role: str
    name: str
    plugin: Plugin
    target: Any

    @property
    def full_name(self) -> str:
        """`dist:name`, which always resolves."""
        return f"{self.plugin.distribution}:{self.name}"


class Registry:
    """What is registered, by role and name."""

    def __init__(self) -> None:
        self.plugins: list[Plugin] = []
        self._manager = pluggy.PluginManager(hookspecs.PROJECT)
        self._manager.add_hookspecs(hookspecs)
        self._entries: dict[tuple[str, str], list[Entry]] = {}
        self._data: list[tuple[Plugin, Path]] = []
        self._classes: dict[tuple[str, str], type | Mapping[str, Any]] = {}

    @classmethod
    def load(cls, plugins: Iterable[str | Path] = (), *, entry_points: bool = True, strict: bool = True) -> Registry:
        """All installed plugins, and these files.

        Args:
            plugins: files to load.
            entry_points: load installed plugins too.
            strict: a file that cannot be loaded is an error; else it is only listed with its reason, as an installed one is.

        Raises:
            PluginError: with `strict`, a file that cannot be loaded; always, one that is missing.
        """
        registry = cls()
        if entry_points:
            from importlib.metadata import entry_points as installed

            for point in sorted(installed(group=hookspecs.PROJECT), key=lambda p: (p.dist.name if p.dist else "", p.name)):
                dist = point.dist
                registry._add(Plugin(point.name, dist.name if dist else "unknown", dist.version if dist else ""), point.load)
        for file in dict.fromkeys(Path(p) for p in plugins):
            registry.add_file(file, strict)
        return registry

    @property
    def files(self) -> list[Path]:
        """The plugin files that were loaded, for a worker to load again."""
        return [p.path for p in self.plugins if p.path is not None]

    def add_file(self, path: Path, strict: bool = True) -> None:
        """Load one plugin file.

        Raises:
            PluginError: it is missing; with `strict` also if it raises, registers nothing, or misspells a hook.
        """
        if not path.is_file():
            raise PluginError(f"{path}: no such plugin file")
        content = path.read_bytes()
        digest = hashlib.sha256(content).hexdigest()
        plugin = Plugin(str(path), "local", digest[:8], path.resolve())
        twin = next((p for p in self.plugins if p.path is not None and p.version == digest[:8]), None)
        if twin is not None and twin.path == path.resolve():
            return
        if twin is not None:
            raise PluginError(f"{path}: is a copy of {twin.name}, which is loaded already; name one of them")
        loaded = self._add(plugin, lambda: load_file(path.resolve(), digest))
        if loaded.reason and strict:
            raise PluginError(f"{path}: {loaded.reason}\n{loaded.details}".rstrip())

    def _add(self, plugin: Plugin, load: Any) -> Plugin:
        key = f"{plugin.distribution}:{plugin.name}"
        try:
            with watching():
                module = load()
            follow([module.__name__])
            entries, data = self._registered(plugin, key, module)
        except (Exception, SystemExit) as error:  # a plugin's own code may raise anything
            if self._manager.has_plugin(key):
                self._manager.unregister(name=key)
            broken = Plugin(plugin.name, plugin.distribution, plugin.version, plugin.path, _reason(error), _details(error))
            self.plugins.append(broken)
            return broken
        self.plugins.append(plugin)
        for entry in entries:
            self._entries.setdefault((entry.role, entry.name), []).append(entry)
        self._data += [(plugin, d) for d in data]
        return plugin

    def _registered(self, plugin: Plugin, key: str, module: Any) -> tuple[list[Entry], list[Path]]:
        others = self._manager.get_plugins()
        try:
            self._manager.register(module, key)
            self._manager.check_pending()
        except pluggy.PluginValidationError as error:
            raise PluginError(_hook_fault(error, module)) from None
        callers = self._manager.get_hookcallers(module) or []
        if not callers:
            raise PluginError("registers nothing; is a hook's @hookimpl forgotten?")

        def call(hook: str) -> list[Any]:
            return list(self._manager.subset_hook_caller(hook, others)())

        entries = [e for table in call("sonobench_components") for e in _entries(plugin, table)]
        data: list[Path] = []
        for package in call("sonobench_data"):
            folder = _package_folder(package)
            data.append(folder)
            entries += [Entry("pipeline", f.stem, plugin, f) for f in sorted((folder / "pipelines").glob("*.toml"))]
        return entries, data

    def entries(self, role: str | None = None) -> Iterator[Entry]:
        """Every entry, sorted by role and name."""
        for (entry_role, _), found in sorted(self._entries.items()):
            if role is None or entry_role == role:
                yield from found

    def entry(self, role: str, name: str) -> Entry:
        """The entry of a name, or of `dist:name`.

        Raises:
            PluginError: nobody, or more than one, provides it.
        """
        dist, _, bare = name.rpartition(":")
        found = [e for e in self._entries.get((role, bare), []) if not dist or e.plugin.distribution == dist]
        if len(found) == 1:
            return found[0]
        if found:
            both = " and ".join(sorted(f"{e.plugin.distribution} {e.plugin.version} ({e.plugin.name})" for e in found))
            raise PluginError(f"{both} both provide a {role} named {bare!r}; write one of {sorted(e.full_name for e in found)}")
        raise PluginError(self._unknown(role, name))

    def _unknown(self, role: str, name: str) -> str:
        elsewhere = sorted(r for r, n in self._entries if n == name)
        if elsewhere:
            return f"{name!r} is a {' and a '.join(elsewhere)}, not a {role}"
        known = [n for r, n in self._entries if r == role]
        broken = "".join(f"; plugin {p.name} ({p.distribution}) could not be loaded: {p.reason}" for p in self.plugins if p.reason)
        return f"no {role} is named {name!r}{did_you_mean(name, known) or f'; there are {sorted(known)}'}{broken}"

    def target(self, entry: Entry) -> type | Mapping[str, Any]:
        """The class or preset table behind an entry.

        Raises:
            UnavailableError: its module cannot be imported or has no such class.
        """
        key = (entry.role, entry.full_name)
        if key not in self._classes:
            self._classes[key] = _resolve(entry)
        return self._classes[key]

    def status(self, entry: Entry) -> str:
        """ "ok", or why it is unavailable; imports the component, and for a preset the one it leads to."""
        try:
            target = self.target(entry)
            use = target.get("use") if isinstance(target, Mapping) else None
            return self.status(self.entry(entry.role, use)) if use and use != entry.name else "ok"
        except UnavailableError as error:
            return f"unavailable: {error.reason}"
        except PluginError as error:
            return f"unavailable: {error}"

    def name_of(self, role: str, component: type) -> str:
        """The name under which a class is registered, as short as is unambiguous.

        Raises:
            PluginError: it is not registered.
        """
        home = f"{component.__module__}:{component.__qualname__}"
        for entry in self.entries(role):
            if entry.target is component or entry.target == home:
                return entry.name if len(self._entries[role, entry.name]) == 1 else entry.full_name
        raise PluginError(f"{home} is not registered as a {role}; return it from sonobench_components")

    def data_files(self, folder: str, suffix: str) -> dict[str, list[tuple[Plugin, Path]]]:
        """Bundled data of a kind by name (the file's stem)."""
        found: dict[str, list[tuple[Plugin, Path]]] = {}
        for plugin, root in self._data:
            for file in sorted((root / folder).glob(f"*{suffix}")):
                found.setdefault(file.name.removesuffix(suffix), []).append((plugin, file))
        return found

    def find_data(self, folder: str, name: str, suffix: str) -> Path:
        """The file of a registered scene, study, … by name or `dist:name`.

        Raises:
            PluginError: nobody, or more than one, ships it.
        """
        dist, _, bare = name.rpartition(":")
        files = self.data_files(folder, suffix)
        found = [(p, f) for p, f in files.get(bare, []) if not dist or p.distribution == dist]
        if len(found) == 1:
            return found[0][1]
        kind = f"{folder[:-3]}y" if folder.endswith("ies") else folder.removesuffix("s")
        if found:
            raise PluginError(f"more than one distribution ships a {kind} {bare!r}: {sorted(f'{p.distribution}:{bare}' for p, _ in found)}")
        raise PluginError(f"no {kind} is named {name!r}{did_you_mean(name, files) or f'; there are {sorted(files)}'}")

    def trial_finished(self, row: Mapping[str, Any]) -> None:
        """Tell every observer; one that raises is a warning."""
        for implementation in self._manager.hook.sonobench_trial_finished.get_hookimpls():
            try:
                implementation.function(*({"row": row}[name] for name in implementation.argnames))  # a hook may leave arguments out
            except (Exception, SystemExit) as error:  # an observer must not lose a row
                warnings.warn(f"observer {implementation.plugin_name} raised {type(error).__name__}: {error}", stacklevel=2)


def load_file(path: Path, digest: str) -> ModuleType:
    """Import a plugin file under a name made from its content, so that two versions never mix."""
    name = f"sonobench_plugin_{digest[:16]}"
    if name in sys.modules:  # of the same content, perhaps from another place or written anew
        sys.modules[name].__file__ = str(path)
        note_loaded(str(path))
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise PluginError("not a Python file; a plugin ends in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _entries(plugin: Plugin, table: Any) -> Iterator[Entry]:
    from sonobench.protocols import ROLES

    if not isinstance(table, Mapping):
        raise PluginError(f"sonobench_components returned {type(table).__name__}; a dictionary {{role: {{name: target}}}} is needed")
    for role, names in table.items():
        if role not in ROLES:
            raise PluginError(f"sonobench_components names the role {role!r}{did_you_mean(str(role), ROLES)} (roles: {sorted(ROLES)})")
        if not isinstance(names, Mapping):
            raise PluginError(f"sonobench_components: {role} is {type(names).__name__}; {{name: target}} is needed")
        for name, target in names.items():
            if not isinstance(name, str) or not _NAME.fullmatch(name):
                raise PluginError(f"sonobench_components: {role}: {name!r} is not a name (letters, digits, '-', '_', '.')")
            if not isinstance(target, (type, str, Mapping)):
                raise PluginError(f"sonobench_components: {role} {name}: {target!r} is not a class, a 'module:Class' or a table")
            yield Entry(role, name, plugin, target)


def _resolve(entry: Entry) -> type | Mapping[str, Any]:
    target = entry.target
    if isinstance(target, Mapping):
        return target
    if isinstance(target, Path):
        return _preset_file(target)
    if isinstance(target, str):
        module, _, name = target.partition(":")
        try:
            target = getattr(importlib.import_module(module), name)
        except (Exception, SystemExit) as error:
            raise UnavailableError(entry.role, entry.full_name, _reason(error)) from error
    _check_role(entry, target)
    return target


def _preset_file(path: Path) -> Mapping[str, Any]:
    from sonobench.tables import read_toml

    try:
        return read_toml(path)
    except InputError as error:
        raise UnavailableError("pipeline", path.stem, str(error)) from error


def _check_role(entry: Entry, component: Any) -> None:
    import dataclasses
    import inspect

    from sonobench.protocols import ROLES

    if not isinstance(component, type) or "__dataclass_params__" not in vars(component):  # a base's decorator does not count
        raise UnavailableError(entry.role, entry.full_name, f"{component!r} is not a dataclass; write @dataclass(frozen=True) above it")
    if not vars(component)["__dataclass_params__"].frozen:
        raise UnavailableError(entry.role, entry.full_name, f"{component.__name__} is not frozen; write @dataclass(frozen=True)")
    fields = {f.name for f in dataclasses.fields(component)}
    protocol = ROLES[entry.role]
    needed = {n for n in vars(protocol) if not n.startswith("_")} | set(inspect.get_annotations(protocol))
    missing = sorted(n for n in needed if n not in fields and not hasattr(component, n))
    if missing:
        lacking = f"{component.__name__} has no {', '.join(missing)}, which a {entry.role} needs"
        raise UnavailableError(entry.role, entry.full_name, lacking)


def _package_folder(package: Any) -> Path:
    spec = importlib.util.find_spec(package) if isinstance(package, str) else None
    if spec is None or not spec.submodule_search_locations:
        raise PluginError(f"sonobench_data returned {package!r}, which is no importable package")
    return Path(next(iter(spec.submodule_search_locations)))


def _hook_fault(error: pluggy.PluginValidationError, module: Any) -> str:
    known = [n for n in vars(hookspecs) if n.startswith("sonobench_")]
    for name in vars(module):
        if hasattr(getattr(module, name, None), f"{hookspecs.PROJECT}_impl") and name not in known:
            return f"{name} is no hook{did_you_mean(name, known)} (hooks: {known})"
    return " ".join(str(error).split())


def _reason(error: BaseException) -> str:
    if isinstance(error, PluginError):
        return str(error)
    return f"{type(error).__name__}: {error}"


def _details(error: BaseException) -> str:
    """The traceback from the plugin's own code on; what led there is the loader, which tells its author nothing."""
    if isinstance(error, PluginError):
        return ""
    own = error.__traceback__
    while own is not None and own.tb_frame.f_code.co_filename in _LOADERS:
        own = own.tb_next
    return "".join(traceback.format_exception(type(error), error, own))
