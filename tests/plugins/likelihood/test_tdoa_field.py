"""Delay tables as evidence."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from echo_scans import REACH_S, SPACE, TALKERS, setup
from echo_tables import field_scan

from sonobench.errors import InputError, SetupError
from sonobench.filtering.fields import calibrated, log_shown
from sonobench.types import DelayTable, Detections, Scan, Sensor, Space
from sonobench_plugins.likelihood.tdoa_field import TdoaField
from sonobench_plugins.measurement.tdoa import Tdoa
from sonobench_plugins.measurement.tdoa_images import TdoaImages

FIVE = TdoaImages(reach_s=REACH_S, p_d=0.9, p_d_echo=0.6)


def bound(measurement=FIVE, resolution_s=1 / 8000, where=None):
    return TdoaField(measurement, resolution_s=resolution_s).bind(SPACE, setup() if where is None else where)


def test_the_ratio_is_the_sum_over_modes_whose_delays_lie_apart():
    rng = np.random.default_rng(1)
    scan, model = field_scan(0.1, TALKERS[:1], rng), bound()
    x = np.array([[0.9, 0, 1.3, 0]])
    delays = model.model.h(x, 0)[0, :, 0]
    assert np.diff(np.sort(delays)).min() > 1 / 8000
    table = scan.fields["gcc"]
    values = table.at(delays[:, None], np.zeros(5, int))
    by_hand = log_shown(values, np.array([0.9, 0.6, 0.6, 0.6, 0.6]), calibrated(table.values[0])).sum()
    assert model.log_ratio(x, scan)[0] == pytest.approx(by_hand, rel=1e-12)


def test_each_lag_counts_once():
    """Who stands at the wall x = 0 coincides with the image behind it: three modes show one and the same peak."""
    x = np.array([[0.0, 0, 1.2, 0]])
    scan = field_scan(0.1, x, np.random.default_rng(2))
    model = bound()
    delays = model.model.h(x, 0)[0, :, 0]
    distinct = np.unique(np.round(delays, 9))
    assert len(distinct) == 3
    table = scan.fields["gcc"]
    values = table.at(distinct[:, None], np.zeros(3, int))
    peaks, at_wall = calibrated(table.values[0]), int(np.argmin(np.abs(distinct - delays[0])))
    direct, echo = (log_shown(values, p, peaks) for p in (0.9, 0.6))
    by_hand = np.delete(echo, at_wall).sum() + (direct[at_wall] + 2 * echo[at_wall]) / 3
    assert model.log_ratio(x, scan)[0] == pytest.approx(by_hand, rel=1e-6)
    each_for_itself = bound(resolution_s=1e-15).log_ratio(x + np.array([[1e-6, 0, 0, 0]]), scan)[0]
    assert each_for_itself > by_hand + 1.0


def test_the_talker_explains_the_table_better_than_anywhere_else():
    rng = np.random.default_rng(3)
    grid = np.stack(np.meshgrid(np.arange(0.1, 3, 0.05), np.arange(0.1, 3, 0.05)), -1).reshape(-1, 2)
    x = np.c_[grid[:, 0], np.zeros(len(grid)), grid[:, 1], np.zeros(len(grid))]
    for talker in TALKERS:
        total = sum(bound().log_ratio(x, field_scan(0.1, talker[None], rng)) for _ in range(4))
        assert np.linalg.norm(x[np.argmax(total)] - talker) < 0.08


def test_noise_speaks_against_a_talker_on_average():
    rng = np.random.default_rng(4)
    x = np.c_[rng.uniform(0.2, 2.8, 300), np.zeros(300), rng.uniform(0.2, 2.8, 300), np.zeros(300)]
    found = np.stack([bound().log_ratio(x, field_scan(0.1, np.zeros((0, 4)), rng)) for _ in range(20)])
    assert found.mean() < -1.0
    assert np.log(np.exp(found).mean()) < 0.3  # but E ratio = 1, were the noise what it is calibrated to be


def test_scale_and_unit_of_the_table_do_not_matter():
    scan = field_scan(0.1, TALKERS[:1], np.random.default_rng(5))
    table = scan.fields["gcc"]
    louder = dataclasses.replace(scan, fields={"gcc": DelayTable(64 * table.values, table.start_s, table.step_s, "Pa²")})
    np.testing.assert_allclose(bound().log_ratio(TALKERS, scan), bound().log_ratio(TALKERS, louder), rtol=1e-9)


def test_modes_outside_the_table_and_out_of_reach_say_nothing():
    scan = field_scan(0.1, TALKERS[:1], np.random.default_rng(6))
    table = scan.fields["gcc"]
    middle = len(table.values[0]) // 2
    short = DelayTable(table.values[:, middle - 60 : middle + 61], table.start_s + (middle - 60) * table.step_s, table.step_s)
    scan = dataclasses.replace(scan, fields={"gcc": short})
    direct = TdoaImages(reach_s=1.5e-3, p_d=0.9, p_d_echo=0.6, walls=())
    x = TALKERS[:1]
    assert np.abs(bound().model.h(x, 0)[0, 1:, 0]).min() > 60 * table.step_s
    assert bound().log_ratio(x, scan)[0] == pytest.approx(bound(direct).log_ratio(x, scan)[0], rel=1e-12)


def test_a_pair_that_was_not_heard_and_a_scan_without_tables_say_nothing():
    where = setup(pairs=2)
    one = field_scan(0.1, TALKERS[:1], np.random.default_rng(7)).fields["gcc"]
    half = DelayTable(np.stack([one.values[0], np.zeros_like(one.values[0])]), one.start_s, one.step_s)
    scan = Scan(0.1, np.array([True, False]), (), {"gcc": half})
    np.testing.assert_allclose(bound(where=where).log_ratio(TALKERS, scan), bound().log_ratio(TALKERS, Scan(0.1, [True], (), {"gcc": one})))
    assert bound().log_ratio(TALKERS, Scan(0.1, np.array([False]))) is None
    deaf = DelayTable(np.zeros((1, 9)), 0.0, 1e-4)
    assert bound().log_ratio(TALKERS, Scan(0.1, np.array([False]), (), {"gcc": deaf})) is None


def test_what_cannot_be_read_is_refused_with_both_sides_named():
    rows = Scan(0.1, np.ones(1, bool), (Detections(np.zeros((1, 1)), np.zeros(1, int)),))
    with pytest.raises(InputError, match=r"field 'gcc'.*none.*gcc-peaks"):
        bound().log_ratio(TALKERS, rows)
    with pytest.raises(SetupError, match="rate_hz; set resolution_s"):
        bound(resolution_s=None)
    elements = setup(pairs=4).sensors[0].elements
    stack = Sensor("stack", "a", "tdoa", elements, Space.of("tau0_s", "tau1_s"), np.array([[0, 1], [1, 0]]))
    with pytest.raises(SetupError, match="one delay a sensor"):
        bound(Tdoa(), where=dataclasses.replace(setup(), sensors=(stack,)))
    with pytest.raises(ValueError, match="resolution_s is 0"):
        TdoaField(resolution_s=0.0)
