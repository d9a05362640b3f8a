"""Chen et al. 2012: what one recursion of EK-, UK- and CK-PHD costs, beside the operation counts of their Table 1; and the whole study.

A recursion is prediction, moments through h and the update with every component formed, as the table counts; reduction is not in it.
J components, |Z| rows and M pairs are swept with the others fixed, all in turn in one run.
"""

from __future__ import annotations

import time
from itertools import product
from statistics import median

import numpy as np
import pytest
from bench_clock import in_turn, seconds

from sonobench.filtering.mixture import predict
from sonobench.filtering.phd import Moments, correct
from sonobench.harness.progress import Silent
from sonobench.protocols import Mixture
from sonobench.scene.study import Study
from sonobench.types import Detections, Scan, Sensor, Setup, Space
from sonobench_plugins.measurement.tdoa import Tdoa
from sonobench_plugins.motion.langevin import Langevin
from sonobench_plugins.transform.cubature import Cubature
from sonobench_plugins.transform.linearised import Linearised
from sonobench_plugins.transform.unscented import Unscented

TRANSFORMS = {"EK": Linearised(), "UK": Unscented(), "CK": Cubature()}
FIXED = {"J": 30, "Z": 10, "M": 4}
SWEEPS = {"J": (3, 10, 30, 100, 300), "Z": (1, 3, 10, 30, 100), "M": (1, 2, 4, 8, 16, 32)}
N, ROUNDS, PRUNED = 4, 51, 1e-5


def printed(name, J, Z, M):
    """Additions, subtractions and multiplications of Table 1, and its square roots, with J components predicted and J updated."""
    first, each, roots = {"EK": (2, N**2, 3 * M + Z), "UK": (8, 2 * N, M + Z), "CK": (5, 2 * N, M + Z)}[name]
    return first * N**3 * J + J * (M**3 + Z * each * M**2), 2 * J * roots


def case(J, Z, M):
    """A mixture, a measurement model of M pairs and a scan of Z rows, in the paper's room."""
    rng = np.random.default_rng(0)
    at = rng.uniform([0.3, 0.3, 1.5], [2.7, 2.7, 1.5], (M, 3))
    turn = rng.uniform(0, 2 * np.pi, M)
    half = 0.3 * np.stack([np.cos(turn), np.sin(turn), np.zeros(M)], axis=-1)
    pairs = np.arange(2 * M).reshape(M, 2)
    space = Space(tuple(f"tau{i}_s" for i in range(M)))
    sensor = Sensor("stack", "walls", "tdoa", np.stack([at - half, at + half], axis=1).reshape(-1, 3), space, pairs)
    setup = Setup((sensor,), ("walls",), np.eye(4)[None], period_s=0.032, nominal={"height_m": 1.5})
    bound = Tdoa(delay_std_s=125e-6, p_d=0.98, clutter_per_scan=7.0).bind(Langevin().space, setup)
    m = rng.uniform([0.3, -1, 0.3, -1], [2.7, 1, 2.7, 1], (J, N))
    prior = Mixture(np.full(J, 0.1), m, np.tile(np.diag([0.01, 0.1, 0.01, 0.1]), (J, 1, 1)), np.zeros(J, np.int64))
    reach = bound.tau_max[0]
    scan = Scan(0.032, np.ones(1, bool), (Detections(rng.uniform(-reach, reach, (Z, M)), np.zeros(Z, np.int64)),))
    return prior, bound, scan


def recursion(transform, prior, bound, scan, above=-1.0):
    predicted = predict(prior, Langevin(), 0.99, 0.032)
    moments = Moments(*transform.measure(predicted.m, predicted.P, bound, 0))
    return correct(predicted, moments, scan, bound, 0, above)


def measured():
    """Median seconds of every filter at every place of every sweep, all in turn, each after a call of its own that warms caches."""
    places = [(axis, value, name) for axis, values in SWEEPS.items() for value in values for name in TRANSFORMS]
    cases = {(axis, value): case(**{**FIXED, axis: value}) for axis, values in SWEEPS.items() for value in values}
    works = [lambda p=p: recursion(TRANSFORMS[p[2]], *cases[p[:2]]) for p in places]
    taken = [[(work(), seconds(work))[1] for work in works] for _ in range(ROUNDS)]
    return {place: median(column) for place, column in zip(places, zip(*taken, strict=True), strict=True)}


def exponent(values, costs):
    """The slope of the last two points in logarithms: where the costs that do not grow weigh least."""
    return float(np.log(costs[-1] / costs[-2]) / np.log(values[-1] / values[-2]))


def roots_taken(transform, J, M):
    """Square roots that the recursion takes: distances to microphones, the diagonals of Cholesky factors."""
    points = transform.points(np.zeros((1, N)), np.eye(N)[None])[0].shape[-2]
    distances = points * 2 * M + (2 * M if isinstance(transform, Linearised) else 0)  # the Jacobian has its own
    return J * (distances + (N if points > 1 else 0) + M)


def test_cost_of_a_recursion_beside_the_printed_counts(benchmark):
    taken = measured()
    info = benchmark.extra_info
    for axis, values in SWEEPS.items():
        base = FIXED[axis]
        for value in values:
            now = {**FIXED, axis: value}
            ms = [1e3 * taken[axis, value, name] for name in TRANSFORMS]
            grown = [taken[axis, value, name] / taken[axis, base, name] for name in TRANSFORMS]
            counted = [printed(name, **now)[0] / printed(name, **FIXED)[0] for name in TRANSFORMS]
            info[f"{axis} = {value}: ms of {', '.join(TRANSFORMS)} | over {axis} = {base} | printed counts over the same"] = " | ".join(
                " ".join(f"{v:.3g}" for v in row) for row in (ms, grown, counted)
            )
        for name in TRANSFORMS:
            costs, counts = [taken[axis, v, name] for v in values], [printed(name, **{**FIXED, axis: v})[0] for v in values]
            info[f"exponent in {axis} at its end, {name}, measured and printed"] = (
                f"{exponent(values, costs):.2f} {exponent(values, counts):.2f}"
            )
    for axis, (few, many) in {"J": (30, 300), "Z": (10, 100)}.items():
        more = [1e6 * (taken[axis, many, name] - taken[axis, few, name]) / (many - few) for name in TRANSFORMS]
        counts = [printed(name, **{**FIXED, axis: many})[0] - printed(name, **{**FIXED, axis: few})[0] for name in TRANSFORMS]
        each = " ".join(f"{v:.2f}" for v in more), " ".join(f"{c / (many - few):.0f}" for c in counts)
        info[f"one more of {axis}: us of {', '.join(TRANSFORMS)} | printed count"] = " | ".join(each)
    for name in ("EK", "CK"):
        ratios = [taken[axis, v, name] / taken[axis, v, "UK"] for axis, values in SWEEPS.items() for v in values]
        counted = [
            printed(name, **{**FIXED, axis: v})[0] / printed("UK", **{**FIXED, axis: v})[0] for axis, vs in SWEEPS.items() for v in vs
        ]
        info[f"{name} over UK: measured least, median, most; printed least, median, most"] = " ".join(
            f"{f(r):.2f}" for r, f in product((ratios, counted), (min, median, max))
        )
    benchmark.pedantic(recursion, (TRANSFORMS["CK"], *case(**FIXED)), rounds=10)
    assert exponent(SWEEPS["J"], [taken["J", v, "CK"] for v in SWEEPS["J"]]) < 1.4
    assert taken["J", 300, "CK"] < 1.3 * taken["J", 300, "UK"]


def test_square_roots_and_forming_only_what_stays(benchmark):
    info = benchmark.extra_info
    for name, transform in TRANSFORMS.items():
        parts = case(**FIXED)
        count = roots_taken(transform, FIXED["J"], FIXED["M"])
        numbers = np.random.default_rng(0).random(count)
        whole, kept, roots = in_turn(
            101,
            lambda transform=transform, parts=parts: recursion(transform, *parts),
            lambda transform=transform, parts=parts: recursion(transform, *parts, above=PRUNED),
            lambda numbers=numbers: np.sqrt(numbers),
        )
        info[f"{name}: square roots taken, printed"] = f"{count} {printed(name, **FIXED)[1]}"
        info[f"{name}: share of time in them"] = roots / whole
        info[f"{name}: ms of a recursion; only components above {PRUNED} formed"] = f"{1e3 * whole:.3f} {1e3 * kept:.3f}"
    benchmark.pedantic(recursion, (TRANSFORMS["CK"], *case(**FIXED)), rounds=10)


STUDY = """
scenes = ["chen2012"]
repetitions = {repetitions}
metrics = [{{ use = "ospa", c_m = 1.5, p = 2.0, components = ["x_m", "vx_m_s", "y_m", "vy_m_s"] }}, "cardinality"]
"""
ENTRY = """
[pipelines.{name}]
use = "pipeline"
front_end = "recorded"
given = ["births"]
tracker = {{ use = "{name}-phd", update = "stacked", birth = {{ use = "given", position_std_m = 0.01, velocity_std_m_s = 0.01, once = 2 }} }}
"""


@pytest.fixture
def study(tmp_path, monkeypatch):
    """The study of so many repetitions, with empty caches."""
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)

    def of(repetitions):
        table = STUDY.format(repetitions=repetitions) + "".join(ENTRY.format(name=name) for name in ("ek", "uk", "ck"))
        (tmp_path / "study.toml").write_text(table)
        return Study.load(tmp_path / "study.toml")

    return of


def test_processor_time_of_a_trial_with_all_that_belongs_to_it(benchmark, study):
    """Rendering, tracking, scores and journal of 3 × 100 trials in this process."""
    study(1).run(out="first", in_process=True, display=Silent())
    begin = time.process_time()
    found = benchmark.pedantic(lambda: study(100).run(out="run", in_process=True, display=Silent()), rounds=1)
    spent = time.process_time() - begin
    assert (found.trials.status == "ok").all()
    benchmark.extra_info |= {"processor time (s)": spent, "processor time of a trial (ms)": 1e3 * spent / len(found.trials)}


def test_a_thousand_runs_of_three_filters_as_a_user_runs_them(benchmark, study, monkeypatch):
    """Rendering, tracking, scores and journal of 3000 trials by two workers."""
    mine, ended = study(1000), []
    monkeypatch.setattr(mine.registry, "trial_finished", lambda row: ended.append((row["status"], time.perf_counter())))
    whole = benchmark.pedantic(lambda: seconds(lambda: mine.run(out="run", jobs=2, display=Silent())), rounds=1)
    assert [status for status, _ in ended] == ["ok"] * 3000
    benchmark.extra_info |= {
        "the whole run (s)": whole,
        "a trial, wall time × 2 workers, from the first one's end on (ms)": 2e3 * (ended[-1][1] - ended[0][1]) / (len(ended) - 1),
    }
