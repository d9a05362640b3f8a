"""Tables become components, or one message with every fault."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sonobench.components import build, canonical_json, identity, overlay, to_table
from sonobench.errors import TableError, UnavailableError
from sonobench.protocols import Delay, Motion
from sonobench.registry import Plugin, Registry
from sonobench.types import Array, Ints


@dataclass(frozen=True)
class Whitener:
    floor: float = 0.1
    order: int = 2
    weights: Array = field(default_factory=lambda: np.ones(2))

    def __post_init__(self) -> None:
        if self.floor < 0:
            raise ValueError(f"floor must be at least 0, got {self.floor}")

    def correlate(self, spectra: Any, pairs: Any) -> Any:
        return spectra


@dataclass(frozen=True)
class Chain:
    delays: tuple[Delay, ...] = ()
    by_name: Mapping[str, Delay] = field(default_factory=dict)
    delay: Delay = Whitener(floor=0.3)
    motion: Motion | None = None
    mode: Literal["a", "b"] = "a"
    rates: float | tuple[float, ...] = 1.0
    matrix: Array = field(default_factory=lambda: np.eye(2))
    pairs: Ints = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    needed: str = field(kw_only=True)

    def correlate(self, spectra: Any, pairs: Any) -> Any:
        return spectra


@pytest.fixture
def registry() -> Registry:
    registry = Registry()
    source = Plugin("test", "tests", "1")
    targets: dict[tuple[str, str], Any] = {
        ("delay", "whitener"): Whitener,
        ("delay", "chain"): Chain,
        ("delay", "soft"): {"use": "whitener", "floor": 0.7, "order": 5},
        ("delay", "softer"): {"use": "soft", "floor": 0.9},
        ("delay", "loop"): {"use": "loop"},
        ("delay", "gone"): "no_such_module:Thing",
    }
    from sonobench.registry import Entry

    for (role, name), target in targets.items():
        registry._entries[role, name] = [Entry(role, name, source, target)]
    return registry


FAULTS = [
    ({"use": "whitener", "flor": 1.0}, "here.flor: Whitener has no such field; did you mean 'floor'?"),
    ({"use": "chain"}, "here.needed: is missing"),
    ({"use": "whitener", "floor": True}, "here.floor: a number is needed, got true or false: True"),
    ({"use": "whitener", "order": 10.5}, "here.order: an integer is needed, got a number: 10.5"),
    (
        {"use": "whitener", "weights": [[1, 2], [3]]},
        "here.weights: a regular array is needed, got a ragged one with rows of lengths [2, 1]",
    ),
    ({"use": "whitener", "weights": ["a"]}, "here.weights: an array of numbers is needed"),
    ({"use": "whitener", "weights": [True]}, "here.weights: an array of numbers is needed"),
    ({"use": "whitener", "weights": 3}, "here.weights: a list of numbers is needed, got an integer: 3"),
    ({"use": "chain", "needed": "x", "motion": {"use": "whitener"}}, "here.motion: 'whitener' is a delay, not a motion"),
    ({"use": "whitner"}, "here: no delay is named 'whitner'; did you mean 'whitener'?"),
    ({"usee": "whitener"}, "here: a delay needs `use = NAME`; did you mean 'use' where 'usee' stands?"),
    ({"use": "whitener", "floor": -1}, "here: floor must be at least 0, got -1.0"),
    (
        {"use": "chain", "needed": "x", "delays": ["whitener", {"use": "whitener", "floor": "high"}]},
        "here.delays[1].floor: a number is needed, got a string: 'high'",
    ),
    (
        {"use": "chain", "needed": "x", "by_name": {"one": {"use": "whitener", "order": "x"}}},
        "here.by_name.one.order: an integer is needed",
    ),
    ({"use": "chain", "needed": "x", "mode": "c"}, "here.mode: one of ['a', 'b'] is needed, got 'c'"),
    ({"use": "chain", "needed": "x", "delay": {"flor": 1}}, "here.delay.flor: Whitener has no such field; did you mean 'floor'?"),
    ({"use": "chain", "needed": "x", "pairs": [[0.5, 1]]}, "here.pairs: an array of integers is needed"),
    ({"use": "chain", "needed": "x", "rates": "fast"}, "here.rates: a number is needed, got a string: 'fast'"),
    ({"use": "chain", "needed": 3}, "here.needed: a string is needed, got an integer: 3"),
    ({"use": "loop"}, "here: preset delay 'loop' leads back to itself: loop → loop"),
    (17, "here: a delay is a name or a table with `use`, got an integer: 17"),
]


@pytest.mark.parametrize(("table", "message"), FAULTS, ids=[m.split(":")[0] + str(i) for i, (_, m) in enumerate(FAULTS)])
def test_a_fault_says_where_what_came_and_what_was_needed(registry: Registry, table: Any, message: str) -> None:
    with pytest.raises(TableError) as caught:
        build("delay", table, registry, "here")
    assert len(caught.value.faults) == 1, caught.value.faults
    assert caught.value.faults[0].startswith(message)


def test_all_faults_come_in_one_message(registry: Registry) -> None:
    table = {"use": "chain", "mode": "z", "rates": True, "delays": [{"use": "whitener", "order": 1.5}, {"use": "nobody"}], "extra": 1}
    with pytest.raises(TableError) as caught:
        build("delay", table, registry, "s.toml: pipelines.mine")
    paths = sorted(f.split(": ")[1] for f in caught.value.faults)
    assert paths == [f"pipelines.mine.{p}" for p in ("delays[0].order", "delays[1]", "extra", "mode", "needed", "rates")]


def test_a_component_that_cannot_be_imported_is_unavailable_not_a_fault(registry: Registry) -> None:
    with pytest.raises(UnavailableError, match=r"delay tests:gone is unavailable: ModuleNotFoundError"):
        build("delay", {"use": "gone"}, registry)


def test_presets_lie_under_the_users_keys(registry: Registry) -> None:
    built = build("delay", {"use": "softer", "order": 1}, registry)
    assert (built.floor, built.order) == (0.9, 1)


def test_a_role_table_without_use_is_laid_over_the_default(registry: Registry) -> None:
    built = build("delay", {"use": "chain", "needed": "x", "delay": {"order": 9}}, registry)
    assert built.delay == Whitener(floor=0.3, order=9, weights=built.delay.weights)


def test_a_different_use_replaces_the_table_whole() -> None:
    base = {"a": {"use": "x", "p": 1, "deep": {"q": 1, "r": 2}}, "b": 1}
    assert overlay(base, {"a": {"deep": {"q": 5}}}) == {"a": {"use": "x", "p": 1, "deep": {"q": 5, "r": 2}}, "b": 1}
    assert overlay(base, {"a": {"use": "y", "s": 2}}) == {"a": {"use": "y", "s": 2}, "b": 1}
    assert overlay({"a": "x"}, {"a": {"p": 3}}) == {"a": {"use": "x", "p": 3}}


def test_arrays_arrive_read_only_and_integers_become_floats(registry: Registry) -> None:
    built = build("delay", {"use": "whitener", "floor": 1, "weights": [1, 2]}, registry)
    assert isinstance(built.floor, float)
    assert built.weights.dtype == np.float64
    assert not built.weights.flags.writeable


@given(
    floor=st.floats(0, 1e6),
    order=st.integers(-5, 5),
    weights=st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=4),
    rate=st.floats(0, 9) | st.lists(st.floats(0, 9)),
)
def test_table_to_component_to_table_is_the_identity(floor: float, order: int, weights: list[float], rate: Any) -> None:
    registry = Registry()
    from sonobench.registry import Entry

    source = Plugin("test", "tests", "1")
    registry._entries["delay", "whitener"] = [Entry("delay", "whitener", source, Whitener)]
    registry._entries["delay", "chain"] = [Entry("delay", "chain", source, Chain)]
    inner = {"use": "whitener", "floor": floor, "order": order, "weights": weights}
    built = build(
        "delay", {"use": "chain", "needed": "x", "delays": [inner], "delay": inner, "rates": rate, "by_name": {"k": inner}}, registry
    )
    table = to_table(built, registry, "delay")
    again = build("delay", table, registry)
    assert canonical_json(to_table(again, registry, "delay")) == canonical_json(table)
    assert identity(again, registry, "delay") == identity(built, registry, "delay")
    assert table["delays"][0] == inner
    assert pickle.loads(pickle.dumps(built)).needed == "x"
