"""Chains of preprocessors in front ends: where samples end up, what is left of the band, what is refused."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from signal_sounds import BOX_M, RATE_HZ, WALL_PAIRS, WALLS_M, delayed, every_pair, free_field, header, scans

from sonobench import Block, Header, InputError, MicArray, PluginError, SetupError, identical
from sonobench.components import build, to_table
from sonobench.registry import Registry
from sonobench.signal.preprocessing import passed_hz
from sonobench_plugins.activity.always import Always
from sonobench_plugins.front_end.gcc_max import GccMax
from sonobench_plugins.front_end.gcc_peaks import GccPeaks
from sonobench_plugins.preprocessor.noise_reduction import NoiseReduction
from sonobench_plugins.preprocessor.normalise import Normalise
from sonobench_plugins.preprocessor.pre_emphasis import PreEmphasis
from sonobench_plugins.preprocessor.pre_filter import PreFilter

CHAIN = (PreFilter(200.0), NoiseReduction(), PreEmphasis())
LINE_M = np.array([[0, 0, 0], [0.5, 0, 0]], float)


@dataclass(frozen=True)
class Losing:
    """Drops the last sample of every call."""

    def start(self, rate_hz, channels):
        return channels

    def process(self, state, samples):
        return state, samples[:-1]

    def finish(self, state):
        return np.zeros((0, state))


@dataclass(frozen=True)
class Flat(Losing):
    def process(self, state, samples):
        return state, samples.mean(axis=1)


@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(0, 9000), max_size=12))
def test_scans_are_the_same_bit_for_bit_however_blocks_are_cut(cuts):
    x = free_field(2, [[1.0, 1.0, 1.5]], WALLS_M, seconds=9000 / RATE_HZ)
    front_end = GccPeaks(preprocess=CHAIN)
    whole, pieces = (scans(front_end, header(WALLS_M, WALL_PAIRS), x, c)[1] for c in ([], cuts))
    assert identical(whole, pieces)


def test_a_chain_that_answers_late_loses_no_scan_and_shifts_no_time():
    """A click is found in the same frames with and without."""
    x = np.full((9000, 2), 1e-6, np.float32) * np.random.default_rng(0).standard_normal((9000, 1)).astype(np.float32)
    x[4000:4040] = 0.5
    late = GccMax(preprocess=(NoiseReduction(floor=0.3),))
    plain, reduced = (scans(f, header(LINE_M, every_pair(2)), x)[1] for f in (GccMax(), late))
    assert [s.time_s for s in plain] == [s.time_s for s in reduced]
    assert [s.searched.tolist() for s in plain[14:18]] == [s.searched.tolist() for s in reduced[14:18]]


def test_an_identity_chain_changes_nothing_but_rounding():
    x = free_field(2, [[1.0, 1.0, 1.5]], WALLS_M)
    _, plain = scans(GccPeaks(activity=Always()), header(WALLS_M, WALL_PAIRS), x)
    _, same = scans(GccPeaks(activity=Always(), preprocess=(NoiseReduction(floor=1.0), PreEmphasis(0.0))), header(WALLS_M, WALL_PAIRS), x)
    assert len(plain) == len(same)
    for a, b in zip(plain, same, strict=True):
        np.testing.assert_allclose(a.fields["gcc"].values, b.fields["gcc"].values, atol=1e-5)


def _mixed(seed):
    """Above 2 kHz a sound 4 samples apart, below it a stronger one at −4."""
    from scipy.signal import butter, sosfilt

    rng = np.random.default_rng(seed)
    below, above = (butter(8, 2000.0, kind, output="sos", fs=RATE_HZ) for kind in ("low", "high"))
    high = delayed(sosfilt(above, rng.standard_normal(16000)), np.array([4, 0]) / RATE_HZ)
    low = delayed(sosfilt(below, rng.standard_normal(16000)), np.array([0, 4]) / RATE_HZ)
    return (high + 3.0 * low).astype(np.float32)


def test_what_a_filter_stops_is_left_out_of_whitened_correlations_only_when_the_band_is_narrowed():
    narrow, wide = (GccMax(activity=Always(), preprocess=(PreFilter(2100.0, narrow=n),)) for n in (True, False))
    lags = []
    for front_end in (narrow, wide):
        _, out = scans(front_end, header(LINE_M, every_pair(2)), _mixed(1))
        lags.append(np.array([s.detections[0].z[0, 0] * RATE_HZ for s in out[2:]]))
    assert np.abs(lags[0] - 4).max() < 0.2
    assert (np.abs(lags[1] - 4) > 1).mean() > 0.1  # PHAT divides the filter out and hears the other sound as before


def test_bands_meet_and_nothing_left_is_refused():
    chain = (PreFilter(200.0), PreEmphasis(), PreFilter(None, 3000.0))
    np.testing.assert_array_equal(passed_hz(chain, None, 8000.0), [200.0, 3000.0])
    np.testing.assert_array_equal(passed_hz(chain, np.array([300.0, 2000.0]), 8000.0), [300.0, 2000.0])
    assert passed_hz((PreEmphasis(), PreFilter(narrow=False)), None, 8000.0) is None
    with pytest.raises(SetupError, match="leave nothing of the recording's 0 to 4000 Hz"):
        passed_hz((PreFilter(3000.0), PreFilter(None, 2000.0)), None, 8000.0)


def test_every_array_has_a_chain_of_its_own():
    """Two arrays of very different levels are each brought to the level; one chain for both would follow the louder."""
    rng, normalise = np.random.default_rng(0), Normalise("peak", level=0.5)
    near, far = (MicArray(name, "microphones", LINE_M, RATE_HZ, np.array([[0, 1]])) for name in ("near", "far"))
    both = Header("test", (near, far), np.stack([np.eye(4)] * 2), box_m=BOX_M, array_names=("near", "far"))
    front_end = GccPeaks(activity=Always(), preprocess=(normalise,))
    _, state = front_end.open(both)
    for name, level in (("near", 0.3), ("far", 0.001)):
        state, _ = front_end.step(state, Block(name, 0, (level * rng.standard_normal((900, 2))).astype(np.float32)))
    peaks = [np.abs(np.concatenate(c)).max() for c in state.memory.tail.chunks]
    assert peaks == pytest.approx([0.5, 0.5])


def test_lost_blocks_and_nan_are_told_by_the_sample_that_came_in():
    x = np.random.default_rng(0).standard_normal((4000, 2)).astype(np.float32)
    x[3210, 1] = np.nan
    with pytest.raises(InputError, match="sample 3210 of channel 1 is nan"):
        scans(GccMax(preprocess=CHAIN), header(LINE_M, every_pair(2)), x)


@pytest.mark.parametrize(("part", "words"), [(Losing(), "took 4000 samples of array a and gave 399"), (Flat(), "gave shape")])
def test_a_preprocessor_that_loses_samples_or_channels_is_named(part, words):
    x = np.random.default_rng(0).standard_normal((4000, 2)).astype(np.float32)
    with pytest.raises(PluginError, match=words) as found:
        scans(GccMax(preprocess=(PreEmphasis(), part)), header(LINE_M, every_pair(2)), x, [1000])
    assert type(part).__name__ in str(found.value)


def test_chains_come_from_tables_and_go_back():
    registry = Registry.load()
    table = {"use": "gcc-peaks", "preprocess": ["pre-emphasis", {"use": "pre-filter", "low_hz": 150.0}]}
    front_end = build("front_end", table, registry)
    assert front_end.preprocess == (PreEmphasis(), PreFilter(150.0))
    assert build("front_end", to_table(front_end, registry, "front_end"), registry) == front_end
    assert replace(front_end, preprocess=()) == build("front_end", "gcc-peaks", registry)
