"""A registered component in words: what `plugins list` and `plugins show` print."""

from __future__ import annotations

import dataclasses
import inspect
import io
import json
import re
import sys
import textwrap
import tokenize
import types
import typing
from collections.abc import Mapping
from typing import Any

from sonobench.components import resolve, role_of, to_table
from sonobench.errors import PluginError, SonobenchError
from sonobench.protocols import ROLES
from sonobench.registry import Entry, Registry

#: a field name's last words → unit, longest first
_UNITS = {
    "_deg_s2": "°/s²",
    "_rad_s2": "rad/s²",
    "_deg_s": "°/s",
    "_rad_s": "rad/s",
    "_m_s2": "m/s²",
    "_m_s": "m/s",
    "_rad": "rad",
    "_deg": "°",
    "_hz": "Hz",
    "_db": "dB",
    "_ms": "ms",
    "_s": "s",
    "_m": "m",
}
_NO_UNIT = {"p_s"}  # the probability of survival, not seconds
_ROLE_OF = {protocol: role for role, protocol in ROLES.items()}


def describe(entry: Entry, registry: Registry) -> dict[str, Any]:
    """Role, name, distribution, version, status, summary, source, and parameters, as plain data.

    A component that cannot be loaded has its reason as `status` and no parameters. A preset says what it is a preset of
    (`use`), and its own values stand as defaults. Each parameter is {name, type, unit, default, doc}; a default of None
    with `needed` True must be set.
    """
    told: dict[str, Any] = {
        "role": entry.role,
        "name": entry.name,
        "distribution": entry.plugin.distribution,
        "version": entry.plugin.version,
        "status": "ok",
        "use": None,
        "summary": "",
        "source": "",
        "parameters": [],
    }
    try:
        component, table = resolve(entry.role, {"use": entry.full_name}, registry)
        target = registry.target(entry)
        if isinstance(target, Mapping):
            told["use"] = target.get("use", entry.role)
        told["summary"], told["source"] = _documentation(component)
        told["parameters"] = _parameters(component, table, registry)
    except (SonobenchError, ValueError) as error:
        told["status"] = str(error)
    return told


def describe_text(told: Mapping[str, Any]) -> str:
    """What `describe` found, as lines to read."""
    head = f"{told['role']} {told['name']}  ({told['distribution']} {told['version']})"
    head += f", a preset of {told['use']}" if told["use"] else ""
    lines = [head, f"  {told['summary']}", f"  Source: {told['source']}" if told["source"] else ""]
    lines += [f"  unavailable: {told['status']}"] if told["status"] != "ok" else []
    lines += ["  no parameters"] if told["status"] == "ok" and not told["parameters"] else []
    for p in told["parameters"]:
        value = "must be set" if p["needed"] else f"= {json.dumps(p['default'], ensure_ascii=False)}"
        lines.append(f"  {p['name']}: {p['type']}{' in ' + p['unit'] if p['unit'] else ''} {value}")
        lines += [f"      {p['doc']}"] if p["doc"] else []
    return "\n".join(line for line in lines if line.strip())


def roles_within(component: Any, path: str = "") -> dict[str, str]:
    """Role of every component below this one, by its dotted path in the full table, such as {"front_end.delay": "delay"}."""
    if not dataclasses.is_dataclass(component) or isinstance(component, type):
        return {}
    hints = typing.get_type_hints(type(component))
    found: dict[str, str] = {}
    for f in dataclasses.fields(component):
        for name, value in _items(f.name, getattr(component, f.name)):
            role = role_of(hints[f.name]) if dataclasses.is_dataclass(value) else None
            found |= ({f"{path}{name}": role} if role else {}) | roles_within(value, f"{path}{name}.")
    return found


def _items(name: str, value: Any) -> list[tuple[str, Any]]:
    if isinstance(value, Mapping):
        return [(f"{name}.{k}", v) for k, v in value.items()]
    return [(f"{name}.{k}", v) for k, v in enumerate(value)] if isinstance(value, tuple) else [(name, value)]


def unit_of(name: str) -> str:
    """The unit that a field's name ends in, or ""."""
    return "" if name in _NO_UNIT else next((unit for suffix, unit in _UNITS.items() if name.endswith(suffix)), "")


def readable(hint: Any) -> str:
    """A type as a user would say it: "number", "list of numbers", "delay or none"."""
    words = {float: "number", int: "integer", bool: "true or false", str: "text", type(None): "none", Any: "anything"}
    if _hashable(hint) and hint in _ROLE_OF:
        return _ROLE_OF[hint]
    if _hashable(hint) and hint in words:
        return words[hint]
    origin, arms = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        return " or ".join(readable(a) for a in arms)
    if origin is typing.Literal:
        return " or ".join(repr(a) for a in arms)
    if origin is tuple:
        return f"list of {_plural(readable(arms[0]))}" if len(arms) == 2 and arms[1] is Ellipsis else f"list of {len(arms)}"
    if "ndarray" in str(origin or hint):
        return f"array of {_array_of(arms)}"
    if origin is not None and issubclass(origin, Mapping):
        return f"table of {_plural(readable(arms[1]))}"
    return getattr(hint, "__name__", str(hint))


def _hashable(value: Any) -> bool:
    try:
        hash(value)
    except TypeError:
        return False
    return True


def _plural(word: str) -> str:
    return word if word in ("text", "anything") or " " in word else f"{word}s"


def _array_of(arms: tuple[Any, ...]) -> str:
    text = str(arms)
    return "integers" if "int" in text else "booleans" if "bool" in text else "numbers"


def _documentation(component: type) -> tuple[str, str]:
    """First line of the module's docstring, and what follows "Source:" up to a blank line or the next such word."""
    module = sys.modules.get(component.__module__)
    text = inspect.cleandoc(getattr(module, "__doc__", None) or component.__doc__ or "")
    summary = text.split("\n\n")[0].split("\nSource:")[0].replace("\n", " ")
    found = re.search(r"^Source:\s*(.+?)(?=\n\s*\n|\n[A-Z][\w ]*:|\Z)", text, re.MULTILINE | re.DOTALL)
    return summary, " ".join(found.group(1).split()) if found else ""


def _parameters(component: type, table: Mapping[str, Any], registry: Registry) -> list[dict[str, Any]]:
    hints, docs = typing.get_type_hints(component), field_docs(component)
    return [
        {
            "name": f.name,
            "type": readable(hints[f.name]),
            "unit": unit_of(f.name),
            "default": table[f.name] if f.name in table else _default(f, hints[f.name], registry),
            "needed": f.name not in table and f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING,
            "doc": docs.get(f.name, ""),
        }
        for f in dataclasses.fields(component)
        if f.init
    ]


def _default(f: Any, hint: Any, registry: Registry) -> Any:
    if f.default is not dataclasses.MISSING:
        value = f.default
    elif f.default_factory is not dataclasses.MISSING:
        value = f.default_factory()
    else:
        return None
    try:
        role = next((_ROLE_OF[a] for a in (hint, *typing.get_args(hint)) if _hashable(a) and a in _ROLE_OF), None)
        if role and isinstance(value, tuple):
            return [to_table(v, registry, role) for v in value]
        return to_table(value, registry, role if dataclasses.is_dataclass(value) else None)
    except (PluginError, TypeError):  # a default that no table can say
        return repr(value)


def field_docs(component: type) -> dict[str, str]:
    """The `#:` comment of each field: at its line's end, or on the lines above it."""
    docs: dict[str, str] = {}
    for cls in reversed(component.__mro__):
        if dataclasses.is_dataclass(cls):
            docs |= _docs_of(cls)
    return docs


def _docs_of(cls: type) -> dict[str, str]:
    try:
        source = textwrap.dedent(inspect.getsource(cls))
    except (OSError, TypeError):  # made without a file
        return {}
    docs: dict[str, str] = {}
    above: list[str] = []
    name, depth, at_start = "", 0, True
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT and token.string.startswith("#:"):
            text = token.string[2:].strip()
            if at_start:
                above.append(text)
            elif name:
                docs[name] = text
        elif token.type == tokenize.INDENT:
            depth += 1
        elif token.type == tokenize.DEDENT:
            depth -= 1
        elif token.type in (tokenize.NEWLINE, tokenize.NL):
            at_start = token.type == tokenize.NEWLINE or at_start
            name = "" if token.type == tokenize.NEWLINE else name
        elif at_start:
            at_start = False
            name = token.string if depth == 1 and token.type == tokenize.NAME else ""
            if name and above:
                docs[name] = " ".join(above)
            above = []
    return docs
