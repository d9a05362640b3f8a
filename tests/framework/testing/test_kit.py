"""The conformance kit finds each fault, and only that fault."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from kit_faults import FAULTS, GOOD
from kit_good import GoodMotion, GoodTracker

from sonobench.errors import SetupError
from sonobench.registry import Entry, Plugin, Registry
from sonobench.testing import CHECKS, check, check_file
from sonobench.testing.kit import Broken, Case
from sonobench.testing.models import motion_adapts


@pytest.fixture(scope="module")
def registry() -> Registry:
    """The bundled components and everything that is broken here."""
    registry = Registry.load()
    source = Plugin("kit", "tests", "1")
    for role, component in [*((r, c) for r, c, _ in FAULTS.values()), *GOOD.items()]:
        name = type(component).__name__
        registry._entries[role, name] = [Entry(role, name, source, type(component))]
    return registry


@pytest.mark.parametrize("name", sorted(FAULTS))
def test_each_fault_is_found_by_exactly_its_check_with_a_sentence(name: str, registry: Registry) -> None:
    role, component, words = FAULTS[name]
    failed = {f.check: f.sentence for f in check(component, role, registry) if f.result == "failed"}
    assert list(failed) == [name], failed
    assert words in failed[name]


def test_no_check_is_without_a_fault_that_trips_it() -> None:
    assert sorted(CHECKS) == sorted(FAULTS)


@pytest.mark.parametrize("role", sorted(GOOD))
def test_a_good_component_holds_every_claim_of_its_role(role: str, registry: Registry) -> None:
    findings = check(GOOD[role], role, registry)
    assert {f.check for f in findings} == {"built", *(c.name for c in CHECKS.values() if role in c.roles)}
    assert [f for f in findings if f.result != "ok"] == []


def test_every_role_has_checks_of_its_own() -> None:
    from sonobench.protocols import ROLES

    own = {c.roles[0] for c in CHECKS.values() if len(c.roles) == 1}
    assert own == set(ROLES)


def test_every_claim_is_a_sentence_and_builds_on_earlier_ones_of_its_role() -> None:
    seen: list[str] = []
    for one in CHECKS.values():
        assert one.claim.endswith("."), one.name
        assert set(one.needs) <= set(seen), f"{one.name} builds on what runs after it"
        seen.append(one.name)


@dataclass
class Thawed:
    def correlate(self, spectra: Any, pairs: Any) -> Any:
        return spectra


@dataclass(frozen=True)
class Idle:
    floor: float


@pytest.mark.parametrize(
    ("component", "words"),
    [
        (Thawed(), "Thawed is not frozen; write @dataclass(frozen=True)"),
        (Idle(0.1), "Idle has no correlate, which a delay needs"),
        (Idle, "is no component; build one"),
        (3, "3 is no component"),
    ],
)
def test_what_is_no_component_of_the_role_is_said_at_once(component: Any, words: str) -> None:
    (finding,) = check(component, "delay", Registry())
    assert (finding.check, finding.result) == ("built", "failed")
    assert words in finding.sentence


def test_an_unknown_role_is_refused_with_a_hint() -> None:
    with pytest.raises(ValueError, match="did you mean 'tracker'"):
        check(Idle(0.1), "traker", Registry())


def test_what_cannot_be_asked_is_skipped_with_its_reason(registry: Registry) -> None:
    findings = {f.check: f for f in check(FAULTS["tracker.runs"][1], "tracker", registry)}
    assert findings["tracker.rows"].result == "skipped"
    assert "builds on tracker.seed" in findings["tracker.rows"].sentence
    assert findings["tracker.rows"].ok


@dataclass(frozen=True)
class Smelling(GoodTracker):
    """Reads what the kit's room has not."""

    def init(self, rng: Any, setup: Any) -> Any:
        setup.of_kind("odour", "smelling")


@dataclass(frozen=True)
class Fickle(GoodTracker):
    """Finds out too late."""

    def fix(self, state: Any, rows: Any) -> Any:
        raise SetupError("no room")


def test_a_need_that_the_kits_room_does_not_meet_is_a_reason_not_a_fault(registry: Registry) -> None:
    findings = [f for f in check(Smelling(), "tracker", registry) if f.check.startswith("tracker.")]
    assert {f.result for f in findings} == {"skipped"}
    assert "smelling reads sensors of kind 'odour'; the front end lists" in findings[0].sentence


def test_a_setup_error_after_init_is_a_fault(registry: Registry) -> None:
    failed = [f for f in check(Fickle(), "tracker", registry) if f.result == "failed"]
    assert [f.check for f in failed] == ["tracker.runs"]


PLUGIN = """
from dataclasses import dataclass
import numpy as np
from sonobench import hookimpl

@dataclass(frozen=True)
class Shouting:
    floor: float

    def correlate(self, spectra, pairs):
        cross = spectra[..., pairs[:, 0], :] * spectra[..., pairs[:, 1], :].conj()
        return np.fft.irfft(cross / (np.abs(cross) + self.floor))

@dataclass(frozen=True)
class Strict:
    floor: float = -1.0

    def __post_init__(self):
        if self.floor < 0:
            raise ValueError("floor must be at least 0")

    correlate = Shouting.correlate

@hookimpl
def sonobench_components():
    return {"delay": {"bare": Shouting, "quiet": {"use": "bare", "floor": 1e-9}, "loud": {"use": "bare", "floor": 0.0}, "strict": Strict}}
"""


def test_a_file_is_checked_with_its_presets_and_only_it(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(PLUGIN)
    findings = check_file(file)
    assert {f.component for f in findings} == {"delay bare", "delay quiet", "delay loud", "delay strict"}
    told = {f.component: f for f in findings if f.result == "failed"}
    assert set(told) == {"delay loud", "delay strict"}
    assert told["delay loud"].check == "delay.silence"
    assert "floor must be at least 0" in told["delay strict"].sentence
    (bare,) = [f for f in findings if f.component == "delay bare"]
    assert bare.result == "skipped"
    assert "parameters without a default: floor; register a preset" in bare.sentence


def test_findings_travel() -> None:
    import pickle

    finding = check(3, "delay", Registry())[0]
    assert pickle.loads(pickle.dumps(finding)) == finding
    assert set(dataclasses.asdict(finding)) == {"component", "check", "result", "sentence"}


@dataclass(frozen=True)
class _Unread:
    """Binds to anything, and finds no field in what it is given."""

    def log_ratio(self, x: Any, scan: Any) -> None:
        return None


@dataclass(frozen=True)
class _Everywhere(_Unread):
    sensors: tuple[int, ...] = (0,)


@dataclass(frozen=True)
class Bindable:
    bound: Any

    def bind(self, space: Any, setup: Any) -> Any:
        return self.bound


@pytest.mark.parametrize(("bound", "words"), [(_Unread(), "without `sensors`"), (_Everywhere(), "bind must refuse, by SetupError")])
def test_a_likelihood_that_binds_to_anything_is_told_what_bind_must_do(bound: Any, words: str, registry: Registry) -> None:
    failed = {f.check: f.sentence for f in check(Bindable(bound), "likelihood", registry) if f.result == "failed"}
    assert words in failed["likelihood.runs"]


class Learner(GoodMotion):
    """Keeps what it learns to itself, or writes it into the memory that it is given."""

    level = 0.0

    def __init__(self, own: bool) -> None:
        object.__setattr__(self, "own", own)

    def adapt(self, memory: Any, prior: Any, posterior: Any, dt_s: float) -> Any:
        if self.own:
            object.__setattr__(self, "level", 1.0)
            return np.zeros(1)
        memory = np.zeros(1) if memory is None else memory
        memory += 1.0
        return memory

    def moments(self, x: Any, P: Any, mode: Any, dt_s: float, memory: Any = None) -> Any:
        m, spread = super().moments(x, P, mode, dt_s)
        return m, spread + (self.level + (0.0 if memory is None else float(memory[0]))) * dt_s * np.eye(4)


@pytest.mark.parametrize(("own", "words"), [(True, "stays without the memory"), (False, "do not write into the old one")])
def test_a_motion_that_learns_elsewhere_than_in_a_new_memory_is_found(own: bool, words: str) -> None:
    with pytest.raises(Broken, match=words):
        motion_adapts(Case(Learner(own), "motion", Registry()))
