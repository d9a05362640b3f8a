"""Checks by name, and the function that runs those of a role.

A check is a function of a `Case`; its docstring's first line is its claim. It raises `Broken` with a sentence where the
claim does not hold, `Skip` where it cannot be asked. A check that builds on others (two runs can be compared only if
runs repeat) names them in `needs` and is skipped, with that reason, where one of them did not hold: one fault, one finding.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NoReturn

import numpy as np

from sonobench.components import build
from sonobench.errors import TableError, UnavailableError
from sonobench.protocols import ROLES
from sonobench.registry import Entry, Registry, did_you_mean

Result = Literal["ok", "failed", "skipped"]


class Broken(Exception):
    """A claim that does not hold; the message is the finding's sentence."""


class Skip(Exception):
    """A claim that cannot be asked of this component; the message says why."""


@dataclass(frozen=True, slots=True)
class Finding:
    """What one check found.

    Attributes:
        component: role and name, or class.
        check: the check's name.
        result: "ok", "failed" or "skipped".
        sentence: the claim that held, what is wrong, or why it could not be asked.
    """

    component: str
    check: str
    result: Result
    sentence: str

    @property
    def ok(self) -> bool:
        """Not failed."""
        return self.result != "failed"


@dataclass(frozen=True, slots=True)
class Case:
    """What a check gets: the built component, its role, and the registry for what it names."""

    component: Any
    role: str
    registry: Registry


@dataclass(frozen=True, slots=True)
class Check:
    """One entry of `CHECKS`: name, function, the roles it asks, and the checks that it builds on."""

    name: str
    run: Callable[[Case], None]
    roles: tuple[str, ...]
    needs: tuple[str, ...]

    @property
    def claim(self) -> str:
        """The first line of the function's docstring."""
        return (self.run.__doc__ or "").strip().splitlines()[0]


CHECKS: dict[str, Check] = {}


def claim(name: str, roles: Iterable[str], needs: Iterable[str] = ()) -> Callable[[Callable[[Case], None]], Callable[[Case], None]]:
    """Enter a function in `CHECKS`."""

    def enter(function: Callable[[Case], None]) -> Callable[[Case], None]:
        CHECKS[name] = Check(name, function, tuple(roles), tuple(needs))
        return function

    return enter


def broken(sentence: str) -> NoReturn:
    """Give up with a finding."""
    raise Broken(sentence)


def unmet(reasons: Iterable[object]) -> Skip:
    """The kit's setups lack what the component needs, as its own SetupErrors say."""
    return Skip("the synthetic setup lacks what it needs: " + "; ".join(dict.fromkeys(map(str, reasons))))


def need(holds: Any, sentence: str) -> None:
    """Give up with a finding unless it holds."""
    if not holds:
        raise Broken(sentence)


def untouched(call: Callable[..., Any], *arrays: Any) -> None:
    """Call with read-only copies; give up with a finding where they are written to."""
    copies = [np.array(a) for a in arrays]
    for one in copies:
        one.flags.writeable = False
    try:
        call(*copies)
    except ValueError as error:
        if "read-only" in str(error):
            raise Broken(f"writes into its arguments ({error}); build new arrays") from None
        raise


def check(component: Any, role: str, registry: Registry | None = None) -> list[Finding]:
    """Every finding of a component.

    Args:
        component: a built component, or a registry's `Entry` (its defaults are then built first).
        role: such as "tracker".
        registry: where names are looked up; by default everything installed.

    Raises:
        ValueError: there is no such role.
    """
    if role not in ROLES:
        raise ValueError(f"no role is named {role!r}{did_you_mean(role, ROLES)}; there are {sorted(ROLES)}")
    registry = Registry.load() if registry is None else registry
    who = f"{role} {component.name}" if isinstance(component, Entry) else f"{role} {type(component).__name__}"
    if isinstance(component, Entry):
        built = _build(component, registry, who)
        if isinstance(built, Finding):
            return [built]
        component = built
    missing = _missing(component, role)
    if missing:
        return [Finding(who, "built", "failed", missing)]
    findings = [Finding(who, "built", "ok", "Its defaults build.")]
    case = Case(component, role, registry)
    held: set[str] = set()
    for one in CHECKS.values():
        if role in one.roles:
            result, sentence = _run(one, case, held)
            findings.append(Finding(who, one.name, result, sentence))
            held |= {one.name} if result == "ok" else set()
    return findings


def check_file(path: str | Path) -> list[Finding]:
    """Every finding of everything that a plugin file registers, presets included.

    Raises:
        PluginError: the file cannot be loaded.
    """
    registry = Registry.load([path])
    own = [e for e in registry.entries() if e.plugin.path == Path(path).resolve()]
    return [finding for entry in own for finding in check(entry, entry.role, registry)]


def _run(one: Check, case: Case, held: set[str]) -> tuple[Result, str]:
    blocking = [n for n in one.needs if n not in held]
    if blocking:
        return "skipped", f"builds on {', '.join(blocking)}, which did not hold or could not be asked"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            one.run(case)
    except Skip as reason:
        return "skipped", str(reason)
    except Broken as fault:
        return "failed", str(fault)
    except Exception as error:  # a component under test may raise anything
        return "failed", f"{one.claim} It raised {type(error).__name__}: {error}"
    return "ok", one.claim


def _build(entry: Entry, registry: Registry, who: str) -> Any:
    try:
        return build(entry.role, {"use": entry.full_name}, registry)
    except TableError as error:
        missing = [f.split(":")[0] for f in error.faults if f.endswith(": is missing")]
        if len(missing) == len(error.faults):
            sentence = f"has parameters without a default: {', '.join(missing)}; register a preset that sets them, or check a built one"
            return Finding(who, "built", "skipped", sentence)
        return Finding(who, "built", "failed", f"its defaults do not build: {error}")
    except UnavailableError as error:
        return Finding(who, "built", "failed", str(error))


def _missing(component: Any, role: str) -> str:
    """What is wrong with the component as a component, or ""."""
    kind = type(component)
    if not dataclasses.is_dataclass(component) or isinstance(component, type):
        return f"{component!r} is no component; build one: a component is an instance of a frozen dataclass"
    parameters = vars(kind).get("__dataclass_params__")
    if parameters is None or not parameters.frozen:  # a base's decorator does not count
        return f"{kind.__name__} is not frozen; write @dataclass(frozen=True) above it"
    protocol = ROLES[role]
    names = {n for n in vars(protocol) if not n.startswith("_")} | set(getattr(protocol, "__annotations__", ()))
    lacking = sorted(n for n in names if not hasattr(component, n))
    return f"{kind.__name__} has no {', '.join(lacking)}, which a {role} needs" if lacking else ""
