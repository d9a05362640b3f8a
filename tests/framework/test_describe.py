"""What `plugins show` says comes from the component's own source."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from sonobench.describe import describe, describe_text, field_docs, readable, unit_of
from sonobench.protocols import Delay
from sonobench.registry import Registry
from sonobench.types import Array, Ints

PLUGIN = '''
"""A delay of two paths.

It weighs both.
Source: Somebody & Other 1999, eq. 3;
their second paper.
Deviations: none.
"""
from dataclasses import dataclass, field
import numpy as np
from sonobench import hookimpl
from sonobench.protocols import Delay
from sonobench.types import Array

@dataclass(frozen=True)
class Two:
    """Two."""

    first: Delay  #: the direct one
    #: of the silence, "#: not a comment",
    #: over two lines
    floor_db: float = -60.0
    shape: Array = field(
        default_factory=lambda: np.ones(2),
    )  #: (2,) weights
    plain: int = 3  # no documentation
    speed_m_s: float | None = None  #: None: the recording's

    def correlate(self, spectra, pairs):
        wide = 3  #: no field
        return spectra

@hookimpl
def sonobench_components():
    return {"delay": {"two": Two, "loud": {"use": "two", "first": "two", "floor_db": -20}, "gone": "nowhere:Gone"}}
'''


@pytest.fixture
def registry(tmp_path: Path) -> Registry:
    file = tmp_path / "two.py"
    file.write_text(PLUGIN)
    return Registry.load([file], entry_points=False)


def test_summary_source_and_origin_are_told(registry: Registry) -> None:
    told = describe(registry.entry("delay", "two"), registry)
    assert told["summary"] == "A delay of two paths."
    assert told["source"] == "Somebody & Other 1999, eq. 3; their second paper."
    assert (told["role"], told["name"], told["distribution"], told["status"], told["use"]) == ("delay", "two", "local", "ok", None)
    assert len(told["version"]) == 8


def test_parameters_have_type_unit_default_and_documentation(registry: Registry) -> None:
    told = {p["name"]: p for p in describe(registry.entry("delay", "two"), registry)["parameters"]}
    assert told["first"] == {"name": "first", "type": "delay", "unit": "", "default": None, "needed": True, "doc": "the direct one"}
    assert (told["floor_db"]["unit"], told["floor_db"]["default"]) == ("dB", -60.0)
    assert told["floor_db"]["doc"] == 'of the silence, "#: not a comment", over two lines'
    assert (told["shape"]["type"], told["shape"]["default"], told["shape"]["doc"]) == ("array of numbers", [1.0, 1.0], "(2,) weights")
    assert told["plain"]["doc"] == ""
    assert (told["speed_m_s"]["type"], told["speed_m_s"]["unit"]) == ("number or none", "m/s")
    assert not told["speed_m_s"]["needed"]


def test_a_preset_shows_its_own_values(registry: Registry) -> None:
    told = describe(registry.entry("delay", "loud"), registry)
    values = {p["name"]: (p["default"], p["needed"]) for p in told["parameters"]}
    assert told["use"] == "two"
    assert values["floor_db"] == (-20, False)
    assert values["first"] == ("two", False)


def test_what_cannot_be_loaded_says_why_and_has_no_parameters(registry: Registry) -> None:
    told = describe(registry.entry("delay", "gone"), registry)
    assert "No module named 'nowhere'" in told["status"]
    assert told["parameters"] == []


def test_the_text_holds_every_parameter_and_what_must_be_set(registry: Registry) -> None:
    text = describe_text(describe(registry.entry("delay", "two"), registry))
    assert text.startswith("delay two  (local ")
    for words in ("first: delay must be set", "floor_db: number in dB = -60.0", "Source: Somebody", "the direct one"):
        assert words in text
    assert "unavailable: " in describe_text(describe(registry.entry("delay", "gone"), registry))


def test_every_parameter_of_every_bundled_component_is_documented() -> None:
    registry = Registry.load()
    bare = []
    for entry in registry.entries():
        if entry.plugin.distribution == "sonobench" and entry.role != "pipeline":
            told = describe(entry, registry)
            bare += [f"{entry.role} {entry.name}.{p['name']}" for p in told["parameters"] if not p["doc"]]
            if told["status"] == "ok":
                assert told["summary"].endswith("."), entry.name
    assert bare == []


@pytest.mark.parametrize(
    ("hint", "words"),
    [
        (float, "number"),
        (int | None, "integer or none"),
        (bool, "true or false"),
        (Array, "array of numbers"),
        (Ints, "array of integers"),
        (tuple[str, ...], "list of text"),
        (tuple[Delay, ...], "list of delays"),
        (tuple[float, float], "list of 2"),
        (Mapping[str, float], "table of numbers"),
        (Literal["a", "b"], "'a' or 'b'"),
        (float | tuple[float, ...], "number or list of numbers"),
        (Any, "anything"),
        (np.ndarray, "array of numbers"),
    ],
)
def test_types_read_like_words(hint: Any, words: str) -> None:
    assert readable(hint) == words


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("v_m_s", "m/s"),
        ("a_m_s2", "m/s²"),
        ("rate_hz", "Hz"),
        ("tau_s", "s"),
        ("p_s", ""),
        ("w_rad_s", "rad/s"),
        ("w_rad_s2", "rad/s²"),
        ("turn_deg_s", "°/s"),
        ("acceleration_deg_s2", "°/s²"),
        ("count", ""),
        ("c_m", "m"),
    ],
)
def test_units_come_from_the_end_of_the_name(name: str, unit: str) -> None:
    assert unit_of(name) == unit


def test_a_class_without_a_file_has_no_documentation() -> None:
    from dataclasses import make_dataclass

    assert field_docs(make_dataclass("Made", [("x", int)])) == {}


def test_a_list_of_components_shows_their_tables() -> None:
    registry = Registry.load()
    told = describe(registry.entry("motion", "imm"), registry)
    (models,) = [p["default"] for p in told["parameters"] if p["name"] == "models"]
    assert [m["use"] for m in models] == ["constant-velocity", "constant-velocity"]
