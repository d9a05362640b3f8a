"""Tables ↔ components.

A component is a frozen dataclass; its fields are its parameters. A field typed with a role takes a table
`{ use = NAME, … }` or just "NAME". Scalars are strict (only int → float), arrays arrive read-only, and ALL faults are
reported at once, each with its path.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import types
import typing
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, TypeVar

import cattrs
import cattrs.gen
import numpy as np
from cattrs.errors import (
    AttributeValidationNote,
    BaseValidationError,
    ClassValidationError,
    ForbiddenExtraKeysError,
    IterableValidationNote,
)

from sonobench.errors import PluginError, SonobenchError, TableError, UnavailableError
from sonobench.protocols import ROLES
from sonobench.registry import Registry, did_you_mean
from sonobench.types import read_only
from sonobench.uses import watching

T = TypeVar("T")

_ROLE_OF: Mapping[Any, str] = {protocol: role for role, protocol in ROLES.items()}
_DEFAULT_USE = {"pipeline": "pipeline"}  # a role whose tables need no `use`


def build(target: type[T] | str, table: Any, registry: Registry, where: str = "") -> Any:
    """A component, or any tree of frozen dataclasses, from a table.

    Args:
        target: a role's name (then `table` names its component by `use`), or a dataclass.
        table: mapping, or for a role just the name.
        registry: where names are looked up.
        where: the head of every path in a message, such as "study.toml: pipelines.mine".

    Raises:
        TableError: all faults.
        UnavailableError: the table is right, but a component that it names cannot be loaded here.
    """
    converter = _converter(registry)
    wanted: Any = ROLES[target] if isinstance(target, str) else target
    try:
        with watching():
            return converter.structure(table, wanted)
    except Exception as error:  # cattrs wraps whatever a component's own __post_init__ raises
        faults = list(_faults(error, where))
        if all(isinstance(cause, UnavailableError) for _, cause in faults):
            raise faults[0][1] from None
        raise TableError([text for text, _ in faults]) from None


def to_table(component: Any, registry: Registry, role: str | None = None) -> Any:
    """The full table of a component, defaults included; `build` of it gives the component back."""
    if dataclasses.is_dataclass(component) and not isinstance(component, type):
        hints = _hints(type(component))
        table: dict[str, Any] = {} if role is None else {"use": registry.name_of(role, type(component))}
        for f in dataclasses.fields(component):
            if f.init:
                table[f.name] = _field_table(getattr(component, f.name), hints[f.name], registry)
        return table
    return _plain(component)


def identity(component: Any, registry: Registry, role: str | None = None) -> str:
    """SHA-256 of the component's full table as canonical JSON."""
    return digest(to_table(component, registry, role))


def canonical_json(value: Any) -> str:
    """JSON with sorted keys and no spaces, equal for equal values."""
    return json.dumps(_plain(value), sort_keys=True, separators=(",", ":"), ensure_ascii=False)


def digest(value: Any) -> str:
    """SHA-256 (hex) of the canonical JSON of plain data."""
    return hashlib.sha256(canonical_json(value).encode()).hexdigest()


def overlay(base: Mapping[str, Any], top: Mapping[str, Any]) -> dict[str, Any]:
    """`top` over `base`, deep; the top's keys win, and a different `use` replaces that table whole."""
    merged = dict(base)
    for key, value in top.items():
        below = merged.get(key)
        below = {"use": below} if isinstance(below, str) and isinstance(value, Mapping) else below
        if isinstance(value, Mapping) and isinstance(below, Mapping) and value.get("use", below.get("use")) == below.get("use"):
            merged[key] = overlay(below, value)
        else:
            merged[key] = value
    return merged


def resolve(role: str, table: Any, registry: Registry) -> tuple[type, dict[str, Any]]:
    """The class that a table names, and its parameters with all presets laid under them.

    Raises:
        PluginError: unknown or ambiguous name, or a preset that leads back to itself.
        ValueError: the table has no `use`.
    """
    table = {"use": table} if isinstance(table, str) else table
    if not isinstance(table, Mapping):
        raise ValueError(f"a {role} is a name or a table with `use`, got {_kind(table)}")
    table = dict(table)
    seen: list[str] = []
    while True:
        use = table.pop("use", _DEFAULT_USE.get(role))
        if not isinstance(use, str):
            raise ValueError(f"a {role} needs `use = NAME`{did_you_mean_use(table)}")
        if use in seen:
            raise PluginError(f"preset {role} {use!r} leads back to itself: {' → '.join([*seen, use])}")
        seen.append(use)
        target = registry.target(registry.entry(role, use))
        if isinstance(target, type):
            return target, table
        table = overlay(target, table)


def did_you_mean_use(table: Mapping[str, Any]) -> str:
    """A hint for a misspelt `use`."""
    near = next((k for k in table if did_you_mean(str(k), ["use"])), None)
    return f"; did you mean 'use' where {near!r} stands?" if near else f"; got only {sorted(table)}" if table else ""


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, (tuple, list)):
        return [_plain(v) for v in value]
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    raise TypeError(f"{value!r} is no plain data (a number, string, list or table)")


def _field_table(value: Any, hint: Any, registry: Registry) -> Any:
    role = role_of(hint)
    if isinstance(value, tuple) and value and dataclasses.is_dataclass(value[0]):
        return [to_table(v, registry, role) for v in value]
    if isinstance(value, Mapping) and any(dataclasses.is_dataclass(v) for v in value.values()):
        return {k: to_table(v, registry, role) for k, v in value.items()}
    return to_table(value, registry, role)


def role_of(hint: Any) -> str | None:
    """The role in `Role`, `Role | None`, `tuple[Role, …]` or `Mapping[str, Role]`."""
    try:
        if hint in _ROLE_OF:
            return _ROLE_OF[hint]
    except TypeError:
        return None
    return next((r for a in typing.get_args(hint) if (r := role_of(a))), None)


@lru_cache(maxsize=512)
def _hints(cls: type) -> dict[str, Any]:
    return typing.get_type_hints(cls)


def _kind(value: Any) -> str:
    names = {dict: "a table", list: "a list", str: "a string", bool: "true or false", int: "an integer", float: "a number"}
    return (
        f"{names.get(type(value), type(value).__name__)}: {value!r}" if not isinstance(value, Mapping) else f"a table with {sorted(value)}"
    )


def _converter(registry: Registry) -> cattrs.Converter:
    converter = cattrs.Converter(forbid_extra_keys=True, detailed_validation=True)
    for kind, hook in {float: _float, int: _int, bool: _bool, str: _str}.items():
        converter.register_structure_hook(kind, hook)
    converter.register_structure_hook_func(_is_array, _array)
    converter.register_structure_hook_func(_is_scalar_or_more, lambda value, hint: _either(value, hint, converter))
    converter.register_structure_hook_factory(dataclasses.is_dataclass, lambda cls: _dataclass_hook(cls, converter, registry))
    converter.register_structure_hook_func(
        lambda hint: _hashable(hint) and hint in _ROLE_OF, lambda value, hint: _component(value, hint, converter, registry)
    )
    converter.register_structure_hook_func(
        lambda hint: typing.get_origin(hint) is tuple, lambda value, hint: _tuple(value, hint, converter)
    )
    converter.register_structure_hook_func(lambda hint: typing.get_origin(hint) is typing.Literal, _literal)
    converter.register_structure_hook_func(_is_mapping, lambda value, hint: _mapping(value, hint, converter))
    converter.register_structure_hook_func(lambda hint: hint is Any, lambda value, _: value)
    return converter


def _hashable(value: Any) -> bool:
    try:
        hash(value)
    except TypeError:
        return False
    return True


def _dataclass_hook(cls: type, converter: cattrs.Converter, registry: Registry) -> Callable[[Any, Any], Any]:
    hints = _hints(cls)
    known = [f.name for f in dataclasses.fields(cls) if f.init]
    omitted: dict[str, Any] = {f.name: cattrs.override(omit=True) for f in dataclasses.fields(cls) if not f.init}
    make: Callable[[Any, Any], Any] = cattrs.gen.make_dict_structure_fn(
        cls, converter, _cattrs_forbid_extra_keys=True, _cattrs_detailed_validation=True, **omitted
    )

    def structure(value: Any, _: Any) -> Any:
        if isinstance(value, cls):
            return value
        if not isinstance(value, Mapping):
            raise ValueError(f"a table with {known} is needed, got {_kind(value)}")
        return make({k: _over_default(cls, k, v, hints, registry) for k, v in value.items()}, cls)

    return structure


def _over_default(cls: type, name: str, value: Any, hints: Mapping[str, Any], registry: Registry) -> Any:
    """A role's table without `use` is laid over the field's default component."""
    role = _ROLE_OF.get(hints.get(name)) or _optional_role(hints.get(name))
    if role is None or not isinstance(value, Mapping) or "use" in value:
        return value
    default = next(f for f in dataclasses.fields(cls) if f.name == name)
    component = default.default if default.default is not dataclasses.MISSING else None
    if component is None and default.default_factory is not dataclasses.MISSING:
        component = default.default_factory()
    return value if component is None else overlay(to_table(component, registry, role), value)


def _optional_role(hint: Any) -> str | None:
    arms = (
        [a for a in typing.get_args(hint) if a is not type(None)]
        if isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union
        else []
    )
    return _ROLE_OF.get(arms[0]) if len(arms) == 1 and _hashable(arms[0]) else None


def _component(value: Any, hint: Any, converter: cattrs.Converter, registry: Registry) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return value
    cls, parameters = resolve(_ROLE_OF[hint], value, registry)
    return converter.structure(parameters, cls)


def _float(value: Any, _: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise ValueError(f"a number is needed, got {_kind(value)}")
    return float(value)


def _int(value: Any, _: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise ValueError(f"an integer is needed, got {_kind(value)}")
    return int(value)


def _bool(value: Any, _: Any) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f"true or false is needed, got {_kind(value)}")
    return bool(value)


def _str(value: Any, _: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"a string is needed, got {_kind(value)}")
    return value


def _literal(value: Any, hint: Any) -> Any:
    allowed = typing.get_args(hint)
    if value not in allowed or not any(type(value) is type(a) for a in allowed):
        raise ValueError(f"one of {list(allowed)} is needed, got {value!r}{did_you_mean(str(value), map(str, allowed))}")
    return value


def _is_array(hint: Any) -> bool:
    return hint is np.ndarray or typing.get_origin(hint) is np.ndarray


def _array(value: Any, hint: Any) -> Any:
    arguments = typing.get_args(hint)
    wanted = np.dtype((typing.get_args(arguments[1]) or (np.float64,))[0]) if len(arguments) > 1 else np.dtype(np.float64)
    if not isinstance(value, (list, tuple, np.ndarray)):
        raise ValueError(f"a list of numbers is needed, got {_kind(value)}")
    try:
        array = np.asarray(value)
    except ValueError:
        raise ValueError(
            f"a regular array is needed, got a ragged one with rows of lengths {[len(v) if isinstance(v, (list, tuple)) else 0 for v in value]}"
        ) from None
    allowed = {"f": "iuf", "i": "iu", "u": "iu", "b": "b"}[wanted.kind]
    if (array.size and array.dtype.kind not in allowed) or (any(isinstance(v, bool) for v in _leaves(value)) and wanted.kind != "b"):
        raise ValueError(
            f"an array of {'integers' if wanted.kind in 'iu' else 'booleans' if wanted.kind == 'b' else 'numbers'} is needed, got {value!r}"
        )
    return read_only(array, wanted)


def _leaves(value: Any) -> list[Any]:
    return [leaf for v in value for leaf in _leaves(v)] if isinstance(value, (list, tuple)) else [value]


def _tuple(value: Any, hint: Any, converter: cattrs.Converter) -> tuple[Any, ...]:
    if not isinstance(value, (list, tuple)):
        raise ValueError(f"a list is needed, got {_kind(value)}")
    arms = typing.get_args(hint)
    if len(arms) == 2 and arms[1] is Ellipsis:
        return tuple(converter.structure(value, list[arms[0]]))  # type: ignore[valid-type]
    if len(arms) != len(value):
        raise ValueError(f"{len(arms)} items are needed, got {len(value)}: {value!r}")
    return tuple(converter.structure(v, a) for v, a in zip(value, arms, strict=True))


def _is_mapping(hint: Any) -> bool:
    return typing.get_origin(hint) in (Mapping, dict, typing.get_origin(typing.Mapping[str, int]))


def _mapping(value: Any, hint: Any, converter: cattrs.Converter) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ValueError(f"a table is needed, got {_kind(value)}")
    inner, faults, result = typing.get_args(hint)[1], [], {}
    for key, item in value.items():
        try:
            result[key] = converter.structure(item, inner)
        except Exception as error:
            error.__notes__ = [*getattr(error, "__notes__", ()), AttributeValidationNote("", str(key), inner)]
            faults.append(error)
    if faults:
        raise ClassValidationError("", faults, dict)
    return result


def _is_scalar_or_more(hint: Any) -> bool:
    arms = typing.get_args(hint) if isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union else ()
    return len([a for a in arms if a is not type(None)]) > 1


def _either(value: Any, hint: Any, converter: cattrs.Converter) -> Any:
    """`float | tuple[float, …]`, `str | Table`: the arm is chosen by the shape of the value, so that its message is the one shown."""
    arms = [a for a in typing.get_args(hint) if a is not type(None)]
    if value is None and len(arms) < len(typing.get_args(hint)):
        return None
    many = [a for a in arms if typing.get_origin(a) is tuple or _is_array(a)]
    tables = [a for a in arms if dataclasses.is_dataclass(a) or _is_mapping(a)]
    chosen = many if isinstance(value, (list, tuple, np.ndarray)) else tables if isinstance(value, Mapping) else []
    scalars = [a for a in arms if a not in many and a not in tables]
    for arm in chosen or scalars:
        if arm in (float, int, bool, str) and type(value) is not arm and len(chosen or scalars) > 1:
            continue
        return converter.structure(value, arm)
    return converter.structure(value, (chosen or scalars or arms)[0])


def _faults(error: BaseException, path: str) -> Any:
    """(message, cause) of every leaf of a cattrs error group."""
    if isinstance(error, BaseValidationError):
        for inner in error.exceptions:
            yield from _faults(inner, path + "".join(_step(n, path) for n in getattr(inner, "__notes__", ()) if _step(n, path)))
    elif isinstance(error, ForbiddenExtraKeysError):
        known = [f.name for f in dataclasses.fields(error.cl)] if dataclasses.is_dataclass(error.cl) else []
        for name in sorted(error.extra_fields):
            near = did_you_mean(name, [*known, "use"]) or (f"; it has {known}" if known else "; it has none")
            yield f"{_join(path, name)}: {error.cl.__name__} has no such field{near}", error
    elif isinstance(error, KeyError):
        yield _say(path, "is missing"), error
    elif isinstance(error, TableError):
        for fault in error.faults:
            yield _say(path, fault), error
    else:
        text = str(error) if isinstance(error, (ValueError, SonobenchError)) else f"{type(error).__name__}: {error}"
        yield _say(path, text), error


def _say(path: str, text: str) -> str:
    return f"{path.rstrip()} {text}" if path.endswith((":", ": ")) else f"{path}: {text}" if path else text


def _step(note: Any, path: str) -> str:
    if isinstance(note, IterableValidationNote):
        return f"[{note.index}]"
    if isinstance(note, AttributeValidationNote):
        return _join(path, note.name)[len(path) :]
    return ""


def _join(path: str, name: str) -> str:
    return f"{path}.{name}" if path and not path.endswith((":", ": ")) else f"{path.rstrip()} {name}" if path else name
