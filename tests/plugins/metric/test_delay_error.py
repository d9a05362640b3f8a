"""Delay errors counted by hand, and what a front end's scans must hold."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from sonobench.errors import InputError, SetupError
from sonobench.geometry import max_delay, sensor_delays
from sonobench.scoring import score
from sonobench.testing import fixtures
from sonobench.types import DelayTable, Detections, Scan
from sonobench_plugins.metric.delay_error import DelayError

SETUP = fixtures.setup("pairs")
TRUTH = fixtures.truth(6)


def rows(scans, metric=None, truth=TRUTH, setup=SETUP):
    return {r.metric: r.value for r in score(metric or DelayError(), truth, scans, setup, "delay-error")}


def delays(k: int) -> np.ndarray:
    """True delays (talker, pair) at an evaluation time."""
    return np.stack([sensor_delays(TRUTH.position[k], SETUP, q)[:, 0] for q in range(4)], axis=1)


def scan(k: int, z, sensor, searched=(True,) * 4, score=None, fields=None) -> Scan:
    found = Detections(np.asarray(z, float)[:, None], np.asarray(sensor), score=score)
    return Scan(float(TRUTH.time_s[k]), np.array(searched), (found,), fields or {})


def test_errors_are_those_of_the_strongest_row_to_the_nearest_talker():
    true = delays(2)
    z = [true[0, 0] + 1e-5, true[1, 0] + 9e-5, true[1, 1] - 3e-5, true[0, 2] + 4e-4]
    found = rows([scan(2, z, [0, 0, 1, 2], score=[2.0, 1.0, 1.0, 1.0])], DelayError(gross_s=1e-4))
    error = np.array([1e-5, -3e-5, 4e-4])
    error[2] = min((z[3] - t for t in true[:, 2]), key=abs)
    widest = 2 * max(max_delay(u.elements, u.pairs, SETUP.c_m_s).max() for u in SETUP.sensors)
    assert found["delay-error"] == pytest.approx(np.sqrt((error @ error + widest**2) / 4))  # the fourth pair found nothing
    assert found["delay-error.bias"] == pytest.approx(error.mean())
    assert found["delay-error.gross"] == pytest.approx(2 / 4)
    assert found["delay-error.inlier"] == pytest.approx(np.sqrt(np.mean(error[:2] ** 2)))
    assert found["delay-error.mae"] == pytest.approx(np.mean(np.abs(error[:2])))
    assert found["delay-error.missed"] == pytest.approx(0.25)
    assert found["delay-error.skipped"] == 0


def test_a_missed_frame_weighs_as_a_gross_error_also_where_nothing_at_all_was_found():
    wrong = [scan(k, [1.0] * 4, range(4)) for k in range(6)]
    silent = [scan(k, [], []) for k in range(6)]
    half = [scan(k, delays(k)[0] if k % 2 else [], range(4) if k % 2 else []) for k in range(6)]
    gross = [next(r for r in score(DelayError(), TRUTH, scans, SETUP) if r.metric.endswith("gross")) for scans in (wrong, silent, half)]
    assert [r.value for r in gross] == [1.0, 1.0, 0.5]
    assert [r.weight for r in gross] == [24.0] * 3
    assert [r.coverage for r in gross] == [1.0] * 3


def test_frames_that_the_front_end_skips_while_a_talker_sounds_are_told_and_those_without_a_talker_are_not():
    quiet = dataclasses.replace(TRUTH, active=TRUTH.active & (np.arange(6) != 3)[:, None])
    idle = [scan(k, [], [], searched=(False,) * 4) for k in (2, 3)]
    found = rows([scan(1, delays(1)[0], range(4)), *idle], truth=quiet)
    assert found["delay-error.skipped"] == 0.5
    assert found["delay-error.gross"] == found["delay-error.missed"] == 0


def test_frames_without_activity_or_without_a_sounding_talker_count_nowhere():
    quiet = dataclasses.replace(TRUTH, active=TRUTH.active & (np.arange(6) != 3)[:, None])
    right = [scan(k, delays(k)[0], range(4)) for k in (1, 3)]
    silent = scan(2, [], [], searched=(False,) * 4)
    (weight,) = {r.weight for r in score(DelayError(), quiet, [right[0], silent, right[1]], SETUP) if r.metric == "delay-error.missed"}
    assert weight == 4


def test_the_true_delay_moves_between_evaluation_times():
    half = dataclasses.replace(scan(2, 0.5 * (delays(2) + delays(3))[0], range(4)), time_s=float(TRUTH.time_s[2:4].mean()))
    assert rows([half])["delay-error"] < 1e-7


def test_the_sidelobe_ratio_is_the_peak_over_the_highest_beside_it():
    values = np.zeros((4, 101), np.float32)
    values[:, 50], values[:, 52], values[:, 80] = 0.8, 0.7, 0.2
    table = DelayTable(values, -5e-3, 1e-4)
    found = rows([scan(1, delays(1)[0], range(4), fields={"gcc": table})], DelayError(lobe_s=3e-4))
    assert found["delay-error.sidelobe"] == pytest.approx(4.0)


def test_rows_without_scores_count_each():
    true = delays(1)[:, 0]
    found = rows([scan(1, [true[0] + 1e-5, true[1] - 3e-5], [0, 0], searched=(True, False, False, False))])
    assert found["delay-error"] == pytest.approx(np.sqrt(5) * 1e-5)


def test_a_failed_trial_misses_nothing_and_ranks_nowhere():
    found = rows([], setup=None)
    assert np.isnan(found["delay-error"])
    assert found["delay-error.gross"] == found["delay-error.missed"] == found["delay-error.skipped"] == 1


def test_what_cannot_be_scored_is_named():
    with pytest.raises(SetupError, match=r"one microphone pair each; there are \['stack'\]"):
        rows([scan(1, [], [])], setup=fixtures.setup("stack"))
    with pytest.raises(InputError, match="gross_s is 0"):
        DelayError(gross_s=0.0)
