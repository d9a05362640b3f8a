"""What trajectories, simulators and whole pipelines must do."""

from __future__ import annotations

from typing import Any

import numpy as np

from sonobench import pipeline
from sonobench.errors import SetupError, SonobenchError
from sonobench.protocols import Rendering
from sonobench.testing import directions, fixtures
from sonobench.testing.kit import Case, Skip, broken, claim, need, unmet
from sonobench.types import identical

_TRAJECTORY, _SIMULATOR, _PIPELINE = ("trajectory",), ("simulator",), ("pipeline",)
_FASTEST_M_S = 50.0


@claim("trajectory.runs", _TRAJECTORY)
def trajectory_runs(case: Case) -> None:
    """Times (k,) give positions (k, 3), all finite, also for no time at all."""
    for times in (np.linspace(0, 20, 41), np.zeros(0)):
        found = np.asarray(case.component.position(times.copy()))
        need(found.shape == (len(times), 3), f"{len(times)} times give shape {found.shape}; ({len(times)}, 3) is needed")
        need(np.isfinite(found).all(), "a position is NaN or infinite")


@claim("trajectory.repeats", _TRAJECTORY, ["trajectory.runs"])
def trajectory_repeats(case: Case) -> None:
    """A position depends on its time only, not on the times beside it."""
    times = np.random.default_rng(1).uniform(0, 20, 30)
    whole = np.asarray(case.component.position(times.copy()))
    alone = np.concatenate([case.component.position(times[k : k + 1].copy()) for k in range(len(times))])
    need(np.allclose(whole, alone, rtol=0, atol=1e-9), "a time asked alone and among others gives different positions")


@claim("trajectory.mutation", _TRAJECTORY, ["trajectory.runs"])
def trajectory_mutation(case: Case) -> None:
    """The times are left as they came."""
    times = np.linspace(0, 20, 41)
    times.flags.writeable = False
    try:
        case.component.position(times)
    except ValueError as error:
        broken(f"writes into the times ({error})")


@claim("trajectory.continuity", _TRAJECTORY, ["trajectory.repeats"])
def trajectory_continuity(case: Case) -> None:
    """A source does not jump."""
    found = np.asarray(case.component.position(np.linspace(0, 20, 20001)))
    step = np.linalg.norm(np.diff(found, axis=0), axis=1).max()
    need(step < _FASTEST_M_S * 1e-3, f"jumps by {step:.3g} m within a millisecond")


@claim("trajectory.end", _TRAJECTORY, ["trajectory.repeats"])
def trajectory_end(case: Case) -> None:
    """It holds still after its end."""
    late = np.asarray(case.component.position(np.array([1e5, 1e5 + 1, 2e5])))
    need(np.allclose(late, late[0], rtol=0, atol=1e-6), f"still moves after a day: {late.tolist()}")


def _scene(case: Case, level: str) -> Any:
    from sonobench.scene import Scene

    where = [[1.0, 0.9, 1.2], [2.0, 1.5, 1.2]]
    line = {"use": "line", "from_m": where[0], "to_m": where[1], "speed_m_s": 0.5}
    mics = fixtures.microphones().tolist()
    arrays = {"walls": {"elements_m": mics, "pairs": fixtures.PAIRS.tolist()}}
    table = {
        "name": "tiny",
        "duration_s": 0.3,
        "rate_hz": 8000.0,
        "period_s": 0.1,
        "simulator": case.component,
        "arrays": arrays,
        "sources": {"anna": {"trajectory": line, "sound": {"use": "white"}, "intervals": [[0.0, 0.3]]}},
        "nominal": dict(fixtures.NOMINAL),
        "room": {"size_m": fixtures.BOX_M[1].tolist(), "reflections": [0.4] * 6},
    }
    if level == "vectors":
        del table["room"]
        table["arrays"] = {"mast": {"kind": "avs", "elements_m": mics[:1]}}
    if level == "measurements":
        table["sources"] = {"anna": {"trajectory": line, "intervals": [[0.0, 0.3]]}}
    return Scene.from_table(table, case.registry)


def _rendered(case: Case, seed: int = 1) -> Rendering:
    faults = []
    for level in ("samples", "vectors", "measurements"):
        try:
            return case.component.simulate(_scene(case, level), seed)
        except SonobenchError as error:
            faults.append(str(error))
    raise Skip(f"takes none of the kit's scenes: {'; '.join(dict.fromkeys(faults))}")


@claim("simulator.runs", _SIMULATOR)
def simulator_runs(case: Case) -> None:
    """A simulator renders a tiny scene."""
    found = _rendered(case)
    need(len(found) == 6, f"simulate gave {type(found).__name__}; a Rendering is needed")
    need(len(found[1]) or len(found[2]), "the rendering holds neither samples nor scans")


@claim("simulator.order", _SIMULATOR, ["simulator.runs"])
def simulator_order(case: Case) -> None:
    """Samples follow on without gaps, all finite, and scans and truth come in time order."""
    found = _rendered(case)
    following: dict[str, int] = {}
    for block in found[1]:
        need(
            block.first_sample == following.get(block.array, 0),
            f"a block of {block.array} begins at sample {block.first_sample}, not {following.get(block.array, 0)}",
        )
        need(np.isfinite(block.samples).all(), f"samples of {block.array} hold NaN or infinity")
        following[block.array] = block.first_sample + len(block.samples)
    need(np.all(np.diff([s.time_s for s in found[2]]) > 0), "scans are not in time order")
    need(np.all(np.diff(found[3].time_s) > 0), "the truth is not in time order")


@claim("simulator.seed", _SIMULATOR, ["simulator.runs"])
def simulator_seed(case: Case) -> None:
    """The same seed renders the same, bit for bit."""
    first, second = _rendered(case), _rendered(case)
    for name, a, b in zip(("header", "blocks", "scans", "truth"), first, second, strict=False):
        need(identical(_listed(a), _listed(b)), f"two renderings from one seed differ in their {name}")


def _listed(value: Any) -> Any:
    return value if hasattr(value, "__dataclass_fields__") else list(value)


@claim("pipeline.runs", _PIPELINE)
def pipeline_runs(case: Case) -> None:
    """A pipeline goes from a recording to estimates, or ends at its scans."""
    samples = getattr(case.component.front_end, "consumes", "samples") == "samples"
    recordings: list[Any] = (
        [fixtures.sampled(), directions.sampled()] if samples else [fixtures.measured(grouping=g) for g in ("pairs", "stack", "positions")]
    )
    reasons: list[str] = []
    for recording in recordings:
        try:
            setup, scans = pipeline.scans_of(case.component.front_end, recording, case.component.given)
            need(scans, "the front end gave no scan")
            if case.component.tracker is not None:
                pipeline.track(case.component.tracker, setup, scans, np.random.default_rng(0))
            return
        except SetupError as error:
            reasons.append(str(error))
    raise unmet(reasons)
