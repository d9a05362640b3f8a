import pickle
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from signal_sounds import RATE_HZ, WALL_PAIRS, WALLS_M, delayed, every_pair, free_field, header, scans

from sonobench import Header, InputError, MicArray, PluginError, SetupError, identical
from sonobench_plugins.activity.always import Always
from sonobench_plugins.delay.cc import Cc
from sonobench_plugins.front_end.gcc_peaks import GccPeaks

CLUSTER_M = np.array([[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.5]], float)
VOICED = GccPeaks(activity=Always())


def _delays(scan, pairs):
    rows = scan.detections[0]
    return np.array([rows.z[rows.sensor == q][0, 0] for q in range(pairs)])


def _white(delays_samples, seed=1, seconds=1.0):
    return delayed(np.random.default_rng(seed).standard_normal(int(seconds * RATE_HZ)), np.array(delays_samples) / RATE_HZ).astype(
        np.float32
    )


@pytest.mark.parametrize("delays", [(0, 3, -5, 8), (0.0, 3.3, -2.62, 5.05), (0.5, -0.5, 4.25, -4.75)])
@pytest.mark.parametrize("band_hz", [None, np.array([100.0, 2500.0])])
def test_delays_and_signs_are_right_to_a_twentieth_of_a_sample(delays, band_hz):
    pairs = every_pair(4)
    _, out = scans(VOICED, header(CLUSTER_M, pairs, band_hz=band_hz), _white(delays))
    d = np.array(delays)
    for scan in out:
        assert np.abs(_delays(scan, 6) * RATE_HZ - (d[pairs[:, 0]] - d[pairs[:, 1]])).max() < 0.05


def test_permuted_microphones_give_the_same_delays():
    order, pairs, x = np.array([2, 0, 3, 1]), every_pair(4), _white((0, 3.3, -2.62, 5.05))
    rank = np.argsort(order)
    _, plain = scans(VOICED, header(CLUSTER_M, pairs), x)
    _, moved = scans(VOICED, header(CLUSTER_M[order], rank[pairs]), x[:, order])
    for a, b in zip(plain, moved, strict=True):
        assert np.allclose(_delays(a, 6), _delays(b, 6), atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(0, 9000), max_size=12))
def test_scans_are_the_same_bit_for_bit_however_blocks_are_cut(cuts):
    x = free_field(2, [[1.0, 1.0, 1.5]], WALLS_M, seconds=9000 / RATE_HZ)
    front_end = GccPeaks(memory_s=0.1)
    whole, pieces = (scans(front_end, header(WALLS_M, WALL_PAIRS), x, c)[1] for c in ([], cuts))
    assert identical(whole, pieces)


def test_silence_is_not_searched_and_offers_nothing():
    _, out = scans(GccPeaks(), header(CLUSTER_M, every_pair(4)), np.zeros((8000, 4), np.float32))
    assert len(out) == 14
    assert not any(s.searched.any() or s.detections or s.fields for s in out)


def test_a_dead_microphone_silences_only_its_pairs():
    x = _white((0, 1, 2, 3))
    x[:, 2] = 0.0
    _, out = scans(VOICED, header(CLUSTER_M, every_pair(4)), x)
    assert out[0].searched.tolist() == [2 not in p for p in every_pair(4).tolist()]
    assert not np.isin(out[0].detections[0].sensor, np.flatnonzero(~out[0].searched)).any()


def test_the_field_is_the_table_and_peaks_lie_on_it():
    setup, out = scans(VOICED, header(CLUSTER_M, every_pair(4)), _white((0, 3.3, -2.6, 5.0)))
    table, rows = out[2].fields["gcc"], out[2].detections[0]
    columns = table.start_s + table.step_s * np.arange(table.values.shape[1])
    for q in range(6):
        assert np.allclose(table.at(columns[:-1, None, None], np.array([q]))[:, 0], table.values[q, :-1], atol=1e-4)
    on_curve = [table.at(z[None], np.array([q]))[0] for z, q in zip(rows.z, rows.sensor, strict=True)]
    assert np.allclose(on_curve, rows.score, atol=0.02)
    assert setup.period_s == 0.064
    assert [s.name for s in setup.sensors] == [f"pair-{p}" for p in range(6)]


def test_averaging_weighs_the_past_exponentially():
    x = free_field(5, [[1.0, 1.0, 1.5]], WALLS_M)
    recording = header(WALLS_M, WALL_PAIRS)
    plain = [s.fields["gcc"].values.astype(float) for s in scans(VOICED, recording, x)[1]]
    mean = scans(replace(VOICED, memory_s=0.2), recording, x)[1][5].fields["gcc"].values
    weight = np.exp(-0.064 / 0.2) ** np.arange(5, -1, -1)
    assert np.allclose(mean, np.tensordot(weight / weight.sum(), plain[:6], 1), atol=1e-6)


def test_two_arrays_are_one_rig_in_the_first_ones_frame():
    pose = np.eye(4)
    pose[:3, 3] = [1.0, 0.5, 0.0]
    a, b = (MicArray(n, "microphones", CLUSTER_M, RATE_HZ, np.array([[0, 1]])) for n in "ab")
    setup, _ = VOICED.open(Header("two", (a, b), np.stack([pose, np.eye(4)])))
    assert np.allclose(setup.sensors[1].elements, CLUSTER_M[:2] - pose[:3, 3])


def test_state_can_be_pickled_between_blocks():
    x, recording = free_field(3, [[1.0, 1.0, 1.5]], WALLS_M), header(WALLS_M, WALL_PAIRS)
    _, state = VOICED.open(recording)
    from sonobench import Block

    state, first = VOICED.step(state, Block("a", 0, x[:7000]))
    state = pickle.loads(pickle.dumps(state))
    state, more = VOICED.step(state, Block("a", 7000, x[7000:]))
    assert identical(first + more + VOICED.flush(state), scans(VOICED, recording, x)[1])


def test_samples_with_nan_are_refused():
    x = _white((0, 1, 2, 3))
    x[99, 1] = np.nan
    with pytest.raises(InputError, match="sample 99 of channel 1"):
        scans(VOICED, header(CLUSTER_M, every_pair(4)), x)


def test_a_recording_without_samples_names_both_sides():
    sensors = VOICED.open(header(CLUSTER_M, every_pair(4)))[0].sensors
    with pytest.raises(SetupError, match=r"gcc-peaks reads samples.*no samples.*'recorded'"):
        VOICED.open(Header("scans only", (), np.eye(4)[None], sensors, ("a",)))


@dataclass(frozen=True)
class _Broken:
    def correlate(self, spectra, pairs):
        return np.full((len(spectra), len(pairs), 2 * (spectra.shape[-1] - 1)), np.nan)


def test_a_delay_estimator_that_gives_nan_is_named():
    with pytest.raises(PluginError, match="_Broken gave NaN"):
        scans(replace(VOICED, delay=_Broken()), header(CLUSTER_M, every_pair(4)), _white((0, 1, 2, 3)))


def test_a_wider_margin_finds_delays_beyond_the_pairs_aperture():
    pairs = np.array([[0, 1]])
    _, out = scans(GccPeaks(activity=Always(), margin_s=0.006), header(CLUSTER_M, pairs), _white((0, 50, 0, 0)))
    assert 50 / RATE_HZ > 3 * 0.5 / 344.0
    for scan in out:
        assert abs(_delays(scan, 1)[0] * RATE_HZ + 50) < 0.05


def test_a_second_field_is_the_one_of_a_front_end_with_that_estimator():
    x = free_field(3, [[1.0, 1.0, 1.5]], WALLS_M, seconds=1.0)
    both = scans(replace(VOICED, energy=Cc()), header(WALLS_M, WALL_PAIRS), x)[1]
    alone = scans(replace(VOICED, delay=Cc()), header(WALLS_M, WALL_PAIRS), x)[1]
    plain = scans(VOICED, header(WALLS_M, WALL_PAIRS), x)[1]
    for one, other, old in zip(both, alone, plain, strict=True):
        assert identical(one.fields["energy"], other.fields["gcc"])
        assert identical(replace(one, fields={"gcc": one.fields["gcc"]}), old)


def test_widened_pairs_are_the_scenes_first_and_then_every_other_two():
    x = free_field(3, [[1.0, 1.0, 1.5]], WALLS_M, seconds=0.5)
    setup, out = scans(replace(VOICED, pairs="widened"), header(WALLS_M, WALL_PAIRS), x)
    few = scans(VOICED, header(WALLS_M, WALL_PAIRS), x)[1]
    n, m = len(WALLS_M), len(WALL_PAIRS)
    assert [s.name for s in setup.sensors] == [f"pair-{p}" for p in range(m)] + [f"wide-{p}" for p in range(n * (n - 1) // 2 - m)]
    rows = out[2].detections[0]
    assert np.allclose(np.sort(rows.z[rows.sensor < m], axis=0), np.sort(few[2].detections[0].z, axis=0), atol=1e-9)
