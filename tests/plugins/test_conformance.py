"""Every bundled component, and the configurations in which it is used, holds every claim of its role."""

from __future__ import annotations

import importlib.util
from typing import Any

import pytest

from sonobench.components import build
from sonobench.registry import Entry, Registry
from sonobench.testing import CHECKS, check

REGISTRY = Registry.load()
BUNDLED = [e for e in REGISTRY.entries() if e.plugin.distribution == "sonobench"]
OPTIONAL = {"pyroomacoustics": "pyroomacoustics", "clear-mot": "motmetrics", "hota": "trackeval"}  # name → the module of an extra

#: parameters of components that have no defaults for them
NEEDED: dict[tuple[str, str], dict[str, Any]] = {
    ("birth", "fixed"): {"means": [[1.0, 0.0, 0.9, 0.0], [3.0, 0.0, 2.1, 0.0]], "variances": [[0.1, 0.1, 0.1, 0.1]], "weights": [0.1]},
    ("pipeline", "pipeline"): {"front_end": "gcc-peaks", "tracker": "ck-phd"},
    ("simulator", "measurements"): {"p_d": 0.9, "delay_std_s": 5e-5, "clutter_per_scan": 1.0},
    ("sound", "clip"): {"clip": "ru-female-1"},
    ("trajectory", "arc"): {"centre_m": [2.0, 1.5, 1.2], "radius_m": 1.0, "start_deg": 0.0, "speed_m_s": 0.5},
    ("trajectory", "bearing"): {"range_m": 5.0, "azimuth_deg": 20.0, "elevation_deg": 20.0, "azimuth_deg_s": 1.0},
    ("trajectory", "line"): {"from_m": [1.0, 1.0, 1.2], "to_m": [3.0, 2.0, 1.2], "speed_m_s": 0.5},
    ("trajectory", "still"): {"position_m": [1.0, 1.0, 1.2]},
    ("trajectory", "wander"): {
        "seed": 1,
        "start_m": [1.0, 1.0, 1.2],
        "heading_deg": 45.0,
        "speed_m_s": 0.5,
        "low_m": [0.2, 0.2],
        "high_m": [3.0, 2.8],
    },
    ("tracker", "cbmember"): {"particles": 150},
    ("spawn", "offset"): {"weights": [0.1], "offsets": [[0.1, 0.0, 0.0, 0.0]], "variances": [[0.01, 0.1, 0.01, 0.1]]},
    ("measurement", "tdoa-images"): {"reach_s": 0.02, "sensor": "pair"},
    ("trajectory", "langevin-walk"): {"seed": 1, "start_m": [1.0, 1.0, 1.2], "low_m": [0.2, 0.2], "high_m": [3.0, 2.8]},
    ("trajectory", "random-walk"): {"seed": 1, "start_m": [1.0, 1.0, 1.2], "low_m": [0.2, 0.2], "high_m": [3.0, 2.8]},
    ("trajectory", "waypoints"): {"points_m": [[1.0, 1.0, 1.2], [3.0, 1.0, 1.2], [3.0, 2.0, 1.2]], "speed_m_s": 0.5},
}
_SPATIAL = {"use": "constant-velocity", "dims": 3}
_TURNING = {
    "use": "imm",
    "models": ["bearing-acceleration", {"use": "bearing-velocity", "accelerations": True}, {"use": "bearing-turn", "accelerations": True}],
    "rates_hz": [[0.0, 0.1, 0.0], [0.1, 0.0, 0.1], [0.1, 0.2, 0.0]],
}
_SEEN = {"use": "fixed", "means": [[0.0, 0.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0]], "variances": [[1.0, 0.01, 0.3, 0.01]], "weights": [0.1]}
#: further configurations of the same components
VARIANTS: list[tuple[str, dict[str, Any]]] = [
    ("front_end", {"use": "gcc-peaks", "window": "hamming", "memory_s": 0.2, "pairs": "all"}),
    ("front_end", {"use": "gcc-peaks", "preprocess": ["pre-filter", "noise-reduction", "pre-emphasis"]}),
    ("front_end", {"use": "srp-peaks", "preprocess": [{"use": "noise-reduction", "rule": "subtraction"}, "normalise"]}),
    ("front_end", {"use": "gcc-max", "preprocess": [{"use": "pre-filter", "low_hz": 200.0, "high_hz": 6000.0}, "noise-reduction"]}),
    ("front_end", {"use": "avs", "direction": "wpf-mp", "preprocess": ["pre-filter"], "activity": "energy"}),
    ("direction", {"use": "wpf-mp", "noise": "diagonal", "literal": ["unnormalised"]}),
    ("direction", {"use": "maximum-power-exact", "noise": "diagonal"}),
    ("direction", {"use": "maximum-power-exact", "noise": "eigen", "confidence": "residuals"}),
    ("direction", {"use": "music", "sources": 2, "noise": "eigen"}),
    ("preprocessor", {"use": "pre-filter", "low_hz": 200.0, "high_hz": 3400.0}),
    ("preprocessor", {"use": "noise-reduction", "rule": "subtraction"}),
    ("preprocessor", {"use": "normalise", "by": "peak"}),
    ("activity", {"use": "short-time-energy", "rule": "minimum"}),
    ("sound", {"use": "harmonic", "vibrato_cents": 50.0}),
    ("simulator", {"use": "avs-snapshots", "held": True}),
    ("motion", {"use": "langevin", "dims": 3}),
    ("motion", {"use": "langevin", "noise": "diagonal"}),
    ("motion", _SPATIAL),
    ("motion", _TURNING),
    ("motion", {"use": "bearing-turn", "accelerations": True}),
    ("motion", {"use": "constant-velocity", "held_acceleration_m_s2": 2.0}),
    ("measurement", {"use": "tdoa", "sensor": "stack"}),
    ("tracker", {"use": "gm-phd", "measurement": {"use": "tdoa", "sensor": "stack"}, "update": "stacked"}),
    ("tracker", {"use": "ek-phd", "motion": _SPATIAL}),
    ("tracker", {"use": "smc-phd", "motion": _SPATIAL}),
    ("tracker", {"use": "gaussian-filter", "transform": "linearised", "process_scales": [1.0, 0.01], "gate": 4.0}),
    (
        "tracker",
        {"use": "gaussian-filter", "measurement": "position", "birth": {"use": "room"}, "motion": {"use": "constant-velocity", "dims": 2}},
    ),
    ("tracker", {"use": "ck-phd", "birth": {"use": "room"}}),
    ("tracker", {"use": "smc-phd", "birth": {"use": "room"}}),
    ("tracker", {"use": "smc-phd", "update": "joint", "birth": {"use": "room"}, "measurement": {"use": "tdoa", "sensor": "pair"}}),
    ("tracker", {"use": "smc-phd", "birth": {"use": "room"}, "measurement": {"use": "tdoa-images", "reach_s": 0.02, "sensor": "pair"}}),
    ("tracker", {"use": "tbd", "motion": _SPATIAL}),
    ("tracker", {"use": "ek-phd", "motion": "imm"}),
    ("tracker", {"use": "smc-phd", "motion": "imm", "birth": {"use": "room"}}),
    ("tracker", {"use": "field-lmb", "form": "enumerated", "report": "cardinality"}),
    ("tracker", {"use": "field-lmb", "motion": _TURNING, "likelihood": "fitted-detection", "birth": "from-spectrum"}),
    (
        "tracker",
        {"use": "tbd", "likelihood": {"use": "tdoa-field", "measurement": {"use": "tdoa-images", "reach_s": 0.02, "sensor": "pair"}}},
    ),
    ("likelihood", {"use": "tdoa-field", "measurement": {"use": "tdoa-images", "reach_s": 0.02, "sensor": "pair"}, "resolution_s": 1e-4}),
    ("pipeline", {"front_end": "recorded", "tracker": "smc-phd"}),
    ("simulator", {"use": "measurements", "layout": "position", "p_d": 0.9, "position_std_m": 0.02, "clutter_per_scan": 1.0}),
    ("tracker", {"use": "ck-phd", "measurement": "position", "birth": "room"}),
    ("tracker", {"use": "smc-phd", "extraction": "labels", "resampling": "residual"}),
    ("tracker", {"use": "delta-glmb", "motion": "bearing-velocity", "measurement": "direction", "birth": _SEEN}),
    ("tracker", {"use": "delta-glmb", "truncation": "murty", "max_hypotheses": 20, "measurement": "position", "birth": "from-positions"}),
    ("tracker", {"use": "smc-phd", "extraction": "k-means", "resampling": "stratified", "birth": {"use": "room"}}),
    ("tracker", {"use": "smc-phd", "measurement": "position", "birth": "room", "extraction": "labels"}),
]


def _available(entry: Entry) -> None:
    module = OPTIONAL.get(entry.name)
    if module and importlib.util.find_spec(module) is None:
        pytest.skip(f"the extra {module} is not installed")


def _holds(component: Any, role: str) -> None:
    findings = check(component, role, REGISTRY)
    assert {f.check for f in findings} >= {c.name for c in CHECKS.values() if role in c.roles}, findings[0].sentence
    assert [(f.check, f.sentence) for f in findings if f.result == "failed"] == []
    assert any(f.check.startswith(f"{role}.") and f.result == "ok" for f in findings)


@pytest.mark.parametrize("entry", BUNDLED, ids=[f"{e.role}:{e.name}" for e in BUNDLED])
def test_every_bundled_component_conforms(entry: Entry) -> None:
    _available(entry)
    parameters = NEEDED.get((entry.role, entry.name))
    component = entry if parameters is None else build(entry.role, {"use": entry.full_name, **parameters}, REGISTRY)
    _holds(component, entry.role)


@pytest.mark.parametrize(("role", "table"), VARIANTS, ids=[f"{r}-{i}" for i, (r, _) in enumerate(VARIANTS)])
def test_a_bundled_component_conforms_in_other_configurations(role: str, table: dict[str, Any]) -> None:
    _holds(build(role, table, REGISTRY), role)


def test_a_tracker_is_asked_about_targets_that_it_really_finds() -> None:
    """Claims about misses and rows would be empty if the kit's scans were too hard for a tracker."""
    import numpy as np

    from sonobench.testing import fixtures, trackers

    tracker = build("tracker", "ek-phd", REGISTRY)
    setup = trackers.told(tracker)
    estimates = trackers.run(tracker, setup, fixtures.scans(setup, fixtures.regular(8)))
    assert np.mean([trackers.number(e) for e in estimates[3:]]) == pytest.approx(2.0, abs=0.7)
