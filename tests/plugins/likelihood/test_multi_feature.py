"""Candidate delays and steered powers of one talker, against sums by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from signal_sounds import WALL_PAIRS, WALLS_M, free_field, header, scans

from sonobench.errors import InputError, SetupError
from sonobench.geometry import sensor_delays
from sonobench.signal import steered_power
from sonobench.types import Detections, Scan, Setup, Space
from sonobench_plugins.activity.always import Always
from sonobench_plugins.delay.cc import Cc
from sonobench_plugins.front_end.gcc_peaks import GccPeaks
from sonobench_plugins.likelihood.multi_feature import BoundMultiFeature, MultiFeature

SPACE = Space.of("x_m", "vx_m_s", "y_m", "vy_m_s")
TALKER = np.array([1.3, 1.1])
CLOUD = np.random.default_rng(5).normal([*TALKER], 0.2, (400, 2))[:, [0, 0, 1, 1]] * np.array([1, 0, 1, 0])
EVEN = np.full(400, 1 / 400)
HERE = np.array([[TALKER[0], 0, TALKER[1], 0]])


def heard(pairs: str = "widened", seed: int = 1) -> tuple[Setup, Scan]:
    front_end = GccPeaks(activity=Always(), pairs=pairs, energy=Cc(), oversampling=8)  # type: ignore[arg-type]
    x = free_field(seed, [[*TALKER, 1.5]], WALLS_M, seconds=0.3)
    setup, out = scans(front_end, header(WALLS_M, WALL_PAIRS), x)
    return setup, out[1]


SETUP, SCAN = heard()


def bound(**parameters: object) -> BoundMultiFeature:
    return MultiFeature(**parameters).bind(SPACE, SETUP)  # type: ignore[arg-type]


def with_rows(z_by_pair: list[list[float]]) -> Scan:
    z = np.concatenate([np.array(z)[:, None] for z in z_by_pair])
    sensor = np.repeat(np.arange(len(z_by_pair)), [len(z) for z in z_by_pair])
    return replace(SCAN, detections=(Detections(z, sensor),))


def truth(q: int) -> float:
    return float(sensor_delays(TALKER[None], SETUP, q)[0, 0])


def test_delays_are_the_sum_over_pairs_of_candidates_above_a_floor_over_chance() -> None:
    candidates = [[truth(q), truth(q) + 4e-4] for q in range(4)]
    scan, x = with_rows(candidates), CLOUD[:20]
    s, total = 0.0316 / 343.0, np.zeros(20)
    for q in range(4):
        delay = sensor_delays(x[:, [0, 2]], SETUP, q)[:, 0]
        shown = sum(np.exp(-0.5 * ((z - delay) / s) ** 2) for z in candidates[q])
        aperture = np.linalg.norm(np.subtract(*WALLS_M[WALL_PAIRS[q]])) / 343.0
        chance = 2 * np.sqrt(2 * np.pi) * s / (2 * aperture)
        total += np.log(0.2 + 0.8 * shown) - np.log(0.2 + 0.8 * min(chance, 1.0))
    np.testing.assert_allclose(bound(power="none", floor=0.2).log_ratio(x, scan), total, rtol=1e-12)


def test_one_false_pair_rules_the_truth_out_without_a_floor_and_costs_a_bounded_amount_with_one() -> None:
    right, wrong = [[truth(q)] for q in range(4)], [[truth(q)] for q in range(3)] + [[truth(3) - 5e-4]]
    for floor, least in ((0.0, 10.0), (0.1, 0.0)):
        model = bound(power="none", floor=floor)
        lost = float(model.log_ratio(HERE, with_rows(right))[0] - model.log_ratio(HERE, with_rows(wrong))[0])
        assert lost > least
    assert lost == pytest.approx(np.log(1 / 0.1), abs=1e-4)


def test_power_is_the_generic_steered_sum_over_its_level() -> None:
    table = SCAN.fields["gcc"]
    by_hand = np.maximum(steered_power(table, SETUP, CLOUD[:, [0, 2]]), 0) / 28
    level = float(np.maximum(table.values, 0).mean())
    found = bound(delays="none", sharpness=2.0, least_power=1e-3).log_ratio(CLOUD, SCAN)
    np.testing.assert_allclose(found, 2 * np.log(np.maximum(by_hand / level, 1e-3)), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("power", ["srp", "sbf", "fused"])
def test_power_is_highest_at_the_talker(power: str) -> None:
    axis = np.arange(0.2, 3.8, 0.05)
    at = np.stack(np.meshgrid(axis, np.arange(0.2, 2.8, 0.05)), -1).reshape(-1, 2)
    states = np.zeros((len(at), 4))
    states[:, [0, 2]] = at
    found = bound(delays="none", power=power).log_ratio(states, SCAN)
    assert np.linalg.norm(at[np.argmax(found)] - TALKER) < 0.08


def test_a_coherent_source_in_every_microphone_has_power_one() -> None:
    for name in ("sbf", "srp"):
        power, _ = bound()._power(HERE, SCAN, name)
        assert power[0] == pytest.approx(1.0, abs=0.15)


def test_focused_keeps_the_candidate_of_each_pair_that_the_cloud_expects() -> None:
    scan = with_rows([[truth(q) - 6e-4, truth(q) + 2e-5, truth(q) + 7e-4] for q in range(4)])
    model = bound(power="none", delays="selected")
    focus = model.focused(CLOUD, EVEN, scan)
    assert focus is not None
    assert [q for q, _, _ in focus.rows] == [0, 1, 2, 3]
    assert all(z[0] == pytest.approx(truth(q) + 2e-5, abs=1e-12) for q, z, _ in focus.rows)
    assert all(R[0, 0] == pytest.approx((0.0316 / 343.0) ** 2) for _, _, R in focus.rows)
    alone = model.log_ratio(CLOUD, with_rows([[truth(q) + 2e-5] for q in range(4)]))
    np.testing.assert_allclose(focus.log_ratio(CLOUD), alone, rtol=1e-12)


def test_every_candidate_is_weighed_by_default_and_the_likeliest_are_offered_as_rows() -> None:
    scan = with_rows([[truth(q) - 6e-4, truth(q) + 2e-5] for q in range(4)])
    model = bound(power="none")
    focus = model.focused(CLOUD, EVEN, scan)
    assert focus is not None
    assert [float(z[0]) for _, z, _ in focus.rows] == pytest.approx([truth(q) + 2e-5 for q in range(4)])
    np.testing.assert_allclose(focus.log_ratio(CLOUD), model.log_ratio(CLOUD, scan), rtol=1e-12)


@pytest.mark.parametrize("delays", ["selected", "all"])
def test_a_candidate_that_is_likelier_false_is_no_row_for_a_proposal(delays: str) -> None:
    scan = with_rows([[truth(0)], [truth(1)], [truth(2)], [truth(3) + 9e-4]])
    focus = bound(power="none", delays=delays).focused(CLOUD, EVEN, scan)
    assert focus is not None
    assert [q for q, _, _ in focus.rows] == [0, 1, 2]


def test_what_is_trusted_is_likelier_the_talkers_than_false_at_that_floor() -> None:
    """(1 − floor) × what the cloud expects of the candidate against floor × the same of a delay anywhere in the aperture."""
    off = 3.2e-4
    scan = with_rows([[truth(q) + off] for q in range(4)])
    model = bound(power="none")
    for q in range(4):
        shown = float(EVEN @ model._shown(CLOUD, q, model._rows(scan)[q], scan)[:, 0])
        even = shown / (shown + model._chance(q, 1))  # the floor at which both are as likely
        for floor, rows in ((even - 0.01, 1), (even + 0.01, 0)):
            focus = bound(power="none", floor=floor).focused(CLOUD, EVEN, scan)
            assert focus is not None
            assert sum(sensor == q for sensor, _, _ in focus.rows) == rows


def test_power_below_chance_is_not_counted_by_default() -> None:
    x = np.random.default_rng(3).uniform([0.2, 0, 0.2, 0], [3.8, 0, 2.8, 0], (300, 4))
    found = bound(delays="none").log_ratio(x, SCAN)
    assert found.min() == 0.0
    assert (found == 0.0).sum() > 30


def test_mu_at_a_point_forgets_the_delays_and_over_the_cloud_it_does_not() -> None:
    near, far = (with_rows([[truth(q) + off] for q in range(4)]) for off in (0.0, 3e-4))
    shares = {}
    for at in ("point", "cloud"):
        model = bound(power="fused", mu_at=at)
        shares[at] = [model._mu(CLOUD, EVEN, s, model._rows(s)) for s in (near, far)]
    assert shares["point"][0] == pytest.approx(shares["point"][1], rel=1e-12)
    assert shares["cloud"][0] != pytest.approx(shares["cloud"][1], rel=1e-3)
    sbf, srp = (bound()._power((EVEN @ CLOUD)[None], SCAN, n)[0][0] for n in ("sbf", "srp"))
    assert shares["point"][0] == pytest.approx(srp**2 / (sbf**2 + srp**2))


def test_a_silent_scan_says_nothing() -> None:
    silent = Scan(0.1, np.zeros(len(SETUP.sensors), bool))
    assert bound().log_ratio(CLOUD, silent) is None
    assert bound().focused(CLOUD, EVEN, silent) is None


def test_a_scan_without_the_field_is_refused_and_the_message_says_what_to_use() -> None:
    with pytest.raises(InputError, match='energy = "cc"'):
        bound(power="sbf").log_ratio(CLOUD, replace(SCAN, fields={"gcc": SCAN.fields["gcc"]}))


def test_stacks_and_meaningless_parameters_are_refused() -> None:
    with pytest.raises(SetupError, match="tdoa"):
        MultiFeature(candidates="stack").bind(SPACE, SETUP)
    for faulty in ({"delays": "none", "power": "none"}, {"floor": 1.0}, {"mu": 2.0}, {"mu_at": "room"}):
        with pytest.raises(ValueError, match="need"):
            MultiFeature(**faulty)  # type: ignore[arg-type]
