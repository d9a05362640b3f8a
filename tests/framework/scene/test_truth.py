"""Where sources are, when they exist and when they are active."""

import numpy as np
from scene_tables import MEASURED, scene

from sonobench.scene.truth import evaluation_times, given_of, loud, truth_of


def test_evaluation_times_are_multiples_of_the_period_up_to_the_end():
    np.testing.assert_allclose(evaluation_times(3.2, 0.032), 0.032 * np.arange(1, 101))
    np.testing.assert_allclose(evaluation_times(1.05, 0.1)[[0, -1]], [0.1, 1.0])


def test_a_source_exists_through_its_pauses_and_is_active_within_its_intervals():
    truth = truth_of(scene(MEASURED))
    tenth = np.round(truth.time_s * 10).astype(int)
    np.testing.assert_array_equal(truth.exists[:, 0], tenth >= 2)
    np.testing.assert_array_equal(truth.active[:, 0], ((tenth >= 2) & (tenth <= 8)) | (tenth >= 12))
    assert truth.exists[:, 1].all()
    assert not (truth.active & ~truth.exists).any()


def test_the_walk_begins_with_the_first_interval_and_its_velocity_is_its_speed():
    truth = truth_of(scene(MEASURED))
    walked = np.maximum(truth.time_s - 0.2, 0)
    np.testing.assert_allclose(truth.position[:, 0], np.stack([1 + walked, 1 + 0 * walked, 1.5 + 0 * walked], 1), atol=1e-12)
    np.testing.assert_allclose(truth.velocity[2:-1, 0], np.tile([1.0, 0, 0], (len(walked) - 3, 1)), atol=1e-9)
    np.testing.assert_allclose(truth.velocity[1, 0], [1.0, 0, 0], atol=1e-9)  # exactly at the start: one-sided
    np.testing.assert_array_equal(truth.velocity[0, 0], np.zeros(3))
    np.testing.assert_array_equal(truth.velocity[:, 1], 0)


def test_a_silence_longer_than_the_window_is_not_loud():
    rate = 8000
    time = np.arange(2 * rate) / rate
    samples = np.where((time > 0.5) & (time < 1.0), 0.0, np.sin(2 * np.pi * 300 * time))
    at = np.array([0.3, 0.55, 0.75, 0.95, 1.5])
    np.testing.assert_array_equal(loud(samples, rate, at), [True, True, False, True, True])


def test_loudness_is_measured_against_the_sounds_own_loudest_tenth_of_a_second():
    rate = 1000
    samples = np.concatenate([np.ones(rate), np.full(rate, 0.02), np.full(rate, 0.005)])  # −34 and −46 dB
    np.testing.assert_array_equal(loud(samples, rate, np.array([0.5, 1.5, 2.5])), [True, True, False])
    np.testing.assert_array_equal(loud(1e-6 * samples, rate, np.array([0.5, 1.5, 2.5])), [True, True, False])


def test_given_arrays_are_computed_from_the_truth():
    given = given_of(
        scene(
            {**MEASURED, "given": ["births", "starts", "source_count", "activity", "snr_db"]},
            noise={"snr_db": 12.0},
            given_arrays={"own": [[1, 2]]},
        ),
        seed=1,
    )
    np.testing.assert_allclose(given["starts"], [[0.2, 1, 1, 1.5, 1, 0, 0], [0, 2, 2, 1.5, 0, 0, 0]], atol=1e-9)
    np.testing.assert_array_equal(given["births"], given["starts"][:, 1:4])
    np.testing.assert_array_equal(given["source_count"][:, 1], [1] + [2] * 19)
    np.testing.assert_array_equal(given["activity"][:, 2], np.ones(20))
    assert given["activity"][:, 1].sum() == 7 + 9
    assert given["snr_db"] == [12.0]
    np.testing.assert_array_equal(given["own"], [[1, 2]])
