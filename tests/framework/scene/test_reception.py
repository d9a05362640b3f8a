"""Noise of sensors, frames of vector sensors, and what a recording says of them."""

import numpy as np
import pytest
from scene_tables import MEASURED, copies, scene

from sonobench.components import overlay
from sonobench.errors import TableError
from sonobench.geometry import place
from sonobench.scene.render import assemble
from sonobench.scene.truth import given_of, truth_of

AVS = {"arrays": {"walls": {"kind": "avs", "elements_m": [[1.8, 0.1, 1.5]], "pairs": []}}}


def along_x(array, rate_hz, elements_m, signal, times_s, positions_m):
    """Every element receives the sound along the room's +x."""
    return np.tile(np.asarray(signal)[:, None] * [1.0, 1.0, 0.0, 0.0], (1, len(elements_m)))


def rendered(seed=1, **more):
    made = assemble(scene(overlay(AVS, {"room": None, **more})), seed, along_x, vector_sensors=True)
    return np.concatenate([b.samples for b in made.blocks]).astype(float), made


def test_velocities_come_in_the_frame_of_a_turned_array():
    turn = {"yaw_deg": 90.0, "pitch_deg": 30.0, "roll_deg": -50.0}
    flat, _ = rendered()
    turned, made = rendered(arrays={"walls": turn})
    back = place(made.header.poses[0], turned[:, 1:]) - made.header.poses[0][:3, 3]
    np.testing.assert_allclose(back, flat[:, 1:], atol=1e-6)
    np.testing.assert_array_equal(turned[:, 0], flat[:, 0])
    yawed, _ = rendered(arrays={"walls": {"yaw_deg": 90.0}})  # the array's y axis looks towards −x
    np.testing.assert_allclose(yawed[:, 2], -flat[:, 0], atol=1e-7)


@pytest.mark.parametrize("kind", ["white", "pink"])
def test_noise_has_the_stated_covariance(kind):
    correlation = np.eye(4)
    correlation[0, 1] = correlation[1, 0] = 0.6
    correlation[2, 3] = correlation[3, 2] = -0.5
    stated = {"variance": 1.5, "velocity_variance": [0.5, 0.25, 1.0], "correlation": correlation.tolist(), "kind": kind}
    noise = rendered(noise=stated, duration_s=8.0, sources={"anna": {"gain_db": -300.0}, "carlo": {"gain_db": -300.0}})[0]
    std = np.sqrt([1.5, 0.5, 0.25, 1.0])
    found = noise.T @ noise / len(noise)
    deviation = 4 * np.sqrt(2 / len(noise)) * (1 if kind == "white" else 8)
    np.testing.assert_allclose(found / np.outer(std, std), correlation, atol=deviation)


def test_velocity_noise_is_the_pressures_unless_said_and_may_be_singular():
    ones = np.ones((4, 4)).tolist()
    noise, made = rendered(
        noise={"variance": 1.0, "velocity_db": -3.0, "correlation": ones},
        sources={"anna": {"gain_db": -300.0}, "carlo": {"gain_db": -300.0}},
    )
    np.testing.assert_allclose(noise[:, 1:], np.repeat(noise[:, :1], 3, axis=1) * 10 ** (-3 / 20), atol=1e-6)
    assert made.truth.parameters["velocity_noise_variance"] == pytest.approx(10**-0.3)
    _, equal = rendered(noise={"variance": 2.0})
    assert equal.truth.parameters["velocity_noise_variance_z"] == 2.0


def test_elements_have_noises_of_their_own():
    two = {"walls": {"elements_m": [[1.8, 0.1, 1.5], [2.2, 0.1, 1.5]]}}
    noise, _ = rendered(arrays=two, noise={"variance": 1.0}, sources={"anna": {"gain_db": -300.0}, "carlo": {"gain_db": -300.0}})
    np.testing.assert_allclose(np.corrcoef(noise.T), np.eye(8), atol=4 / np.sqrt(len(noise)))


def test_the_ratio_is_of_pressures_against_the_mixture_or_against_one_source():
    loud = {"anna": {"gain_db": 6.0, "intervals": [[0.5, 1.5]]}, "carlo": {"sound": {"use": "white"}}}
    _, mixed = rendered(noise={"snr_db": 10.0}, sources=loud)
    _, single = rendered(noise={"snr_db": 10.0, "against": "source"}, sources=loud)
    own = single.truth.parameters
    assert own["source_variance"] == pytest.approx((own["source_variance_1"] + own["source_variance_2"]) / 2)
    assert own["pressure_noise_variance"] == pytest.approx(own["source_variance"] / 10)
    both = own["source_variance_1"] / 2 + own["source_variance_2"]  # anna sounds half of the time
    assert mixed.truth.parameters["pressure_noise_variance"] == pytest.approx(both / 10, rel=0.02)


def test_microphones_take_absolute_variances_too():
    quiet = {"anna": {"gain_db": -300.0}, "carlo": {"gain_db": -300.0}}
    made = assemble(scene(noise={"variance": 0.04}, sources=quiet), 1, copies)
    noise = np.concatenate([b.samples for b in made.blocks])
    assert np.mean(noise**2) == pytest.approx(0.04, rel=0.05)
    assert made.truth.parameters == {}


def test_the_truth_says_where_the_sensor_is_and_how_many_snapshots_a_period_has():
    _, made = rendered(arrays={"walls": {"position_m": [1.0, 0.0, 0.0], "yaw_deg": 90.0}}, nominal={"snapshots": 7.0, "height_m": 1.5})
    found = made.truth.parameters
    np.testing.assert_allclose([found[f"origin_{a}_m"] for a in "xyz"], [0.9, 1.8, 1.5])
    assert found["origin_yaw_rad"] == pytest.approx(np.pi / 2)
    assert found["snapshots"] == 7.0  # the scene's own nominal values win
    assert rendered()[1].truth.parameters["snapshots"] == 800.0


@pytest.mark.parametrize(
    ("noise", "fault"),
    [
        ({}, "noise.snr_db: either snr_db or variance"),
        ({"snr_db": 1.0, "variance": 1.0}, "noise.snr_db: either snr_db or variance"),
        ({"variance": -1.0}, "noise.variance: is -1.0"),
        ({"variance": 1.0, "against": "source"}, "noise.against: says what snr_db compares with"),
        ({"variance": 1.0, "velocity_db": 0.0, "velocity_variance": 1.0}, "noise.velocity_db: either"),
        ({"variance": 1.0, "velocity_variance": [1.0, 2.0]}, r"noise.velocity_variance: is \(1.0, 2.0\); one finite number, or three"),
        ({"variance": 1.0, "velocity_variance": [1.0, 2.0, -1.0]}, "0 or more"),
        ({"variance": 1.0, "correlation": [[1.0]]}, "noise.correlation: is"),
        ({"variance": 1.0, "correlation": (2 * np.ones((4, 4)) - np.eye(4)).tolist()}, "no negative eigenvalue"),
    ],
)
def test_impossible_noises_are_refused(noise, fault):
    with pytest.raises(TableError, match=fault):
        scene(AVS, room=None, noise=noise)


def test_microphones_have_no_velocity_noise():
    with pytest.raises(TableError, match=r'noise\.velocity_db: no array is of kind "avs"'):
        scene(noise={"snr_db": 10.0, "velocity_db": 3.0})


def test_evaluation_at_centres_lies_half_a_period_before_the_ends():
    ends, centres = truth_of(scene(MEASURED)), truth_of(scene(MEASURED, evaluate_at="centre"))
    np.testing.assert_allclose(centres.time_s, ends.time_s - 0.05)
    assert centres.exists.sum() == ends.exists.sum() - 1  # anna comes at 0.2 s: the end of period 2, but no centre


def test_what_is_given_has_the_stated_errors_and_another_seed_others():
    std = [0.0, 3.0, 3.0, 3.0, 0.5, 0.5, 0.0]
    made = scene({**MEASURED, "given": ["starts"]}, given_std={"starts": std})
    exact = given_of(scene({**MEASURED, "given": ["starts"]}), 0)["starts"]
    errors = np.array([given_of(made, seed)["starts"] - exact for seed in range(400)])
    np.testing.assert_allclose(errors.std(axis=(0, 1)), std, rtol=0.12)  # 800 draws: 2.5 %, 4 to 5 deviations
    assert abs(errors.mean(axis=(0, 1))[1]) < 4 * 3 / np.sqrt(800)
    np.testing.assert_array_equal(given_of(made, 7)["starts"], given_of(made, 7)["starts"])
    np.testing.assert_array_equal(made.simulate(7).header.given["starts"], given_of(made, 7)["starts"])


def test_errors_of_what_is_not_given_are_refused():
    with pytest.raises(TableError, match=r"given_std\.start: only what is given can have errors; did you mean 'starts'"):
        scene(given=["starts"], given_std={"start": [1.0]})
    with pytest.raises(TableError, match=r"given_std\.starts: is \[1.0\]; 7 numbers"):
        scene(given=["starts"], given_std={"starts": [1.0]})
    with pytest.raises(TableError, match="snr_db is not known where the noise has a variance"):
        scene(given=["snr_db"], noise={"variance": 1.0})
