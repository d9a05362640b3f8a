"""The only loader of plugins: each loads by itself, each fault is said in one sentence, nothing is guessed."""

from __future__ import annotations

import hashlib
import sys
import textwrap
import types
import warnings
from pathlib import Path
from typing import Any

import pytest

from sonobench.components import build
from sonobench.errors import PluginError, UnavailableError
from sonobench.hookspecs import hookimpl
from sonobench.registry import Plugin, Registry

GOOD = """
from dataclasses import dataclass
from sonobench import hookimpl

@dataclass(frozen=True)
class Mine:
    floor: float = 0.1
    def correlate(self, spectra, pairs):
        return spectra

@hookimpl
def sonobench_components():
    return {"delay": {"mine": Mine}}
"""


def _file(folder: Path, text: str, name: str = "mine.py") -> Path:
    file = folder / name
    file.write_text(textwrap.dedent(text))
    return file


def _module(name: str, **hooks: Any) -> types.ModuleType:
    module = types.ModuleType(name)
    for hook, function in hooks.items():
        function.__name__ = hook
        setattr(module, hook, hookimpl(function))
    return module


def _delays(table: Any) -> types.ModuleType:
    return _module("delays", sonobench_components=lambda: {"delay": table})


def _add(registry: Registry, distribution: str, module: Any, name: str = "plugin") -> Plugin:
    def load() -> Any:
        if isinstance(module, BaseException):
            raise module
        return module

    return registry._add(Plugin(name, distribution, "1.0"), load)


class Mine:
    """Deliberately no dataclass."""


REFUSED = {
    "misspelt hook": (
        GOOD.replace("def sonobench_components", "def sonobench_component"),
        "sonobench_component is no hook; did you mean 'sonobench_components'?",
    ),
    "wrong signature": (
        GOOD + "\n@hookimpl\ndef sonobench_trial_finished(row, extra):\n    pass\n",
        "extra",
    ),
    "forgotten marker": (GOOD.replace("@hookimpl\n", ""), "registers nothing; is a hook's @hookimpl forgotten?"),
    "raises": ("raise RuntimeError('no licence')", "RuntimeError: no licence"),
    "leaves Python": ("import sys; sys.exit(3)", "SystemExit: 3"),
    "a hook that raises": (GOOD.replace('return {"delay": {"mine": Mine}}', "return 1 / 0"), "ZeroDivisionError"),
    "a hook that leaves Python": (GOOD.replace('return {"delay": {"mine": Mine}}', "raise SystemExit('bye')"), "SystemExit: bye"),
    "no syntax": ("def (", "SyntaxError"),
    "unknown role": (GOOD.replace('{"delay"', '{"dellay"'), "names the role 'dellay'; did you mean 'delay'?"),
    "no table": (GOOD.replace('{"delay": {"mine": Mine}}', "[Mine]"), "returned list; a dictionary {role: {name: target}} is needed"),
    "no names": (GOOD.replace('{"mine": Mine}', "Mine"), "delay is type; {name: target} is needed"),
    "no target": (GOOD.replace('"mine": Mine', '"mine": 3'), "delay mine: 3 is not a class, a 'module:Class' or a table"),
    "a name with a blank": (GOOD.replace('"mine"', '"my delay"'), "'my delay' is not a name"),
    "a data package that is none": (
        "from sonobench import hookimpl\n@hookimpl\ndef sonobench_data():\n    return 'no_such_package'\n",
        "sonobench_data returned 'no_such_package', which is no importable package",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_plugin_file_that_cannot_be_used_is_refused_with_its_reason(case: str, tmp_path: Path) -> None:
    text, words = REFUSED[case]
    file = _file(tmp_path, text)
    with pytest.raises(PluginError) as caught:
        Registry.load([file], entry_points=False)
    assert str(caught.value).startswith(f"{file}: ")
    assert words in str(caught.value)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match="no such plugin file"):
        Registry.load([tmp_path / "gone.py"], entry_points=False)


def test_what_is_no_python_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match=r"a plugin ends in \.py"):
        Registry.load([_file(tmp_path, GOOD, "mine.txt")], entry_points=False)


def test_a_refused_file_leaves_nothing_behind(tmp_path: Path) -> None:
    import sys

    before = {n for n in sys.modules if n.startswith("sonobench_plugin_")}
    with pytest.raises(PluginError):
        Registry.load([_file(tmp_path, "x = 1\nraise ValueError")], entry_points=False)
    assert {n for n in sys.modules if n.startswith("sonobench_plugin_")} == before


@pytest.mark.parametrize("fault", [ImportError("no module named that"), SystemExit(1), RuntimeError("boom")])
def test_a_broken_installed_plugin_is_listed_with_its_reason_and_takes_nothing_down(fault: BaseException) -> None:
    registry = Registry()
    _add(registry, "broken", fault)
    _add(registry, "fine", _delays({"mine": {"use": "other"}}))
    assert [(p.distribution, p.reason) for p in registry.plugins] == [("broken", f"{type(fault).__name__}: {fault}"), ("fine", "")]
    assert [e.full_name for e in registry.entries()] == ["fine:mine"]
    with pytest.raises(PluginError, match=f"could not be loaded: {type(fault).__name__}"):
        registry.entry("delay", "theirs")


def test_an_entry_point_that_cannot_be_imported_is_listed_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    from importlib import metadata

    point = metadata.EntryPoint("theirs", "a_module_that_nobody_has", "sonobench")
    monkeypatch.setattr(metadata, "entry_points", lambda group: [point])
    (plugin,) = Registry.load().plugins
    assert (plugin.name, plugin.reason) == ("theirs", "ModuleNotFoundError: No module named 'a_module_that_nobody_has'")
    assert "Traceback" in plugin.details


def test_a_plugin_whose_second_hook_is_wrong_registers_nothing() -> None:
    registry = Registry()
    module = _delays({"mine": {"use": "other"}})
    module.sonobench_data = hookimpl(_named("sonobench_data", lambda: "no_such_package"))  # type: ignore[attr-defined]
    assert "no importable package" in _add(registry, "half", module).reason
    assert list(registry.entries()) == []
    assert registry._manager.get_plugins() == set()


def _named(name: str, function: Any) -> Any:
    function.__name__ = name
    return function


def test_two_that_claim_one_name_are_both_named_and_each_resolves_by_its_distribution() -> None:
    registry = Registry()
    _add(registry, "one", _delays({"mine": {"use": "phat", "floor": 1.0}}))
    _add(registry, "two", _delays({"mine": {"use": "phat", "floor": 2.0}}))
    with pytest.raises(PluginError) as caught:
        registry.entry("delay", "mine")
    assert str(caught.value) == (
        "one 1.0 (plugin) and two 1.0 (plugin) both provide a delay named 'mine'; write one of ['one:mine', 'two:mine']"
    )
    assert registry.entry("delay", "two:mine").target["floor"] == 2.0
    assert registry.entry("delay", "one:mine").plugin.distribution == "one"


def test_one_name_may_serve_several_roles() -> None:
    registry = Registry()
    _add(registry, "one", _module("m", sonobench_components=lambda: {"delay": {"x": {"use": "a"}}, "motion": {"x": {"use": "b"}}}))
    assert registry.entry("delay", "x").target["use"] == "a"
    assert registry.entry("motion", "x").target["use"] == "b"


def test_an_unknown_name_says_what_is_near_or_what_there_is_or_where_it_belongs() -> None:
    registry = Registry()
    _add(registry, "one", _delays({"phat": {"use": "a"}}))
    for role, name, words in [
        ("delay", "phta", "no delay is named 'phta'; did you mean 'phat'?"),
        ("delay", "wavelet", "no delay is named 'wavelet'; there are ['phat']"),
        ("tracker", "phat", "'phat' is a delay, not a tracker"),
        ("delay", "two:phat", "no delay is named 'two:phat'"),
    ]:
        with pytest.raises(PluginError) as caught:
            registry.entry(role, name)
        assert str(caught.value).startswith(words)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("@dataclass(frozen=True)\n", "", "is not a dataclass; write @dataclass(frozen=True) above it"),
        ("@dataclass(frozen=True)", "@dataclass", "Mine is not frozen; write @dataclass(frozen=True)"),
        ("def correlate", "def corelate", "Mine has no correlate, which a delay needs"),
        ("class Mine:", "class Base:\n    pass\n\nclass Mine(Base):", "is not a dataclass; write @dataclass(frozen=True) above it"),
    ],
    ids=["no dataclass", "not frozen", "missing method", "a plain base class"],
)
def test_a_class_that_is_no_component_is_unavailable_and_says_why(old: str, new: str, words: str, tmp_path: Path) -> None:
    registry = Registry.load([_file(tmp_path, GOOD.replace(old, new))], entry_points=False)
    (entry,) = registry.entries()
    assert words in registry.status(entry)
    with pytest.raises(UnavailableError, match="delay"):
        build("delay", "mine", registry)


def test_a_target_whose_module_is_broken_is_unavailable_only_when_it_is_used() -> None:
    registry = Registry()
    _add(registry, "one", _delays({"gone": "no_such_module:Thing", "nameless": "sonobench.types:NoSuchThing", "plain": {"use": "gone"}}))
    assert "No module named 'no_such_module'" in registry.status(registry.entry("delay", "gone"))
    assert "NoSuchThing" in registry.status(registry.entry("delay", "nameless"))
    assert "No module named 'no_such_module'" in registry.status(registry.entry("delay", "plain"))
    with pytest.raises(UnavailableError, match="no_such_module"):
        build("delay", "plain", registry)


def test_listing_imports_none_of_the_bundled_algorithms() -> None:
    import subprocess
    import sys

    code = (
        "import sys; from sonobench.registry import Registry; list(Registry.load().entries());"
        "print([m for m in sys.modules if m.startswith('sonobench_plugins.')], 'scipy' in sys.modules, 'numba' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['sonobench_plugins._register'] False False"


def test_an_observer_that_raises_is_a_warning_and_the_others_still_see_the_row() -> None:
    registry, seen = Registry(), []

    def fail(row: Any) -> None:
        raise RuntimeError("disk full")

    _add(registry, "failing", _module("a", sonobench_trial_finished=fail), "first")
    _add(registry, "seeing", _module("b", sonobench_trial_finished=lambda row: seen.append(row["trial_key"])), "second")
    with pytest.warns(UserWarning, match="observer failing:first raised RuntimeError: disk full"):
        registry.trial_finished({"trial_key": "k"})
    assert seen == ["k"]


def test_an_observer_may_take_no_argument() -> None:
    registry, seen = Registry(), []
    _add(registry, "quiet", _module("a", sonobench_trial_finished=lambda: seen.append(1)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        registry.trial_finished({"trial_key": "k"})
    assert seen == [1]


def test_two_versions_of_one_file_do_not_mix(tmp_path: Path) -> None:
    file = _file(tmp_path, GOOD)
    old = Registry.load([file], entry_points=False)
    file.write_text(file.read_text().replace("floor: float = 0.1", "floor: float = 0.9"))
    new = Registry.load([file], entry_points=False)
    assert (build("delay", "mine", old).floor, build("delay", "mine", new).floor) == (0.1, 0.9)
    versions = [next(r.entries()).plugin.version for r in (old, new)]
    assert versions[0] != versions[1]


def test_a_file_named_twice_is_loaded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = _file(tmp_path, GOOD)
    monkeypatch.chdir(tmp_path)
    assert len(list(Registry.load([file, file, str(file), "mine.py", "./mine.py"], entry_points=False).entries())) == 1


def test_a_copy_of_a_file_elsewhere_is_refused_and_both_are_named(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    first, second = _file(tmp_path, GOOD), _file(tmp_path / "b", GOOD)
    with pytest.raises(PluginError) as caught:
        Registry.load([first, second], entry_points=False)
    assert str(caught.value) == f"{second}: is a copy of {first}, which is loaded already; name one of them"


def test_a_built_component_of_a_file_pickles_where_the_file_is_loaded(tmp_path: Path) -> None:
    import pickle

    registry = Registry.load([_file(tmp_path, GOOD)], entry_points=False)
    built = build("delay", {"use": "mine", "floor": 0.3}, registry)
    assert pickle.loads(pickle.dumps(built)) == built


def test_a_plugin_file_written_anew_with_the_same_content_is_the_same_plugin(tmp_path: Path) -> None:
    from sonobench.uses import _LOADED_NS

    source = "from sonobench import hookimpl\n\n\n@hookimpl\ndef sonobench_components():\n    return {}\n"
    for name in ("one.py", "two.py", "one.py"):
        path = tmp_path / name
        path.write_text(source)
        registry = Registry()
        registry.add_file(path)
        (module,) = {m for n, m in sys.modules.items() if n == f"sonobench_plugin_{hashlib.sha256(source.encode()).hexdigest()[:16]}"}
        assert module.__file__ == str(path.resolve())
        assert _LOADED_NS[str(path.resolve())] == path.stat().st_mtime_ns
