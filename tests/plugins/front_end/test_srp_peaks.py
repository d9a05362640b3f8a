from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from signal_sounds import WALL_PAIRS, WALLS_M, free_field, header, scans

from sonobench import Header, SetupError, identical
from sonobench.geometry import pair_delays
from sonobench_plugins.activity.always import Always
from sonobench_plugins.front_end.srp_peaks import SrpPeaks

VOICED = SrpPeaks(activity=Always())


def _expected(position):
    return pair_delays(np.array(position), WALLS_M, WALL_PAIRS, 343.0)


@pytest.mark.parametrize("search", ["own", "all"])
@pytest.mark.parametrize("volume", [False, True])
def test_one_talker_is_one_row_at_its_delays(search, volume):
    source = [1.3, 1.1, 1.5]
    front_end = replace(VOICED, search=search, volume=volume, grid_m=0.1 if volume else 0.07)
    setup, out = scans(front_end, header(WALLS_M, WALL_PAIRS), free_field(1, [source], WALLS_M))
    assert [s.name for s in setup.sensors] == ["stack"]
    for scan in out:
        rows = scan.detections[0]
        assert len(rows) == 1
        assert rows.valid.all()
        assert np.abs(rows.z[0] - _expected(source)).max() < 1e-5


def test_two_talkers_are_two_rows():
    sources = [[1.0, 0.9, 1.5], [3.0, 2.1, 1.5]]
    _, out = scans(VOICED, header(WALLS_M, WALL_PAIRS), free_field(2, sources, WALLS_M))
    for scan in out[2:]:
        rows = scan.detections[0]
        assert len(rows) == 2
        for source in sources:
            error = np.where(rows.valid, np.abs(rows.z - _expected(source)), 0.0).max(axis=1)
            assert error.min() < 3e-5


def test_unrelated_noise_is_nobody():
    noise = np.random.default_rng(3).standard_normal((24000, 8)).astype(np.float32)
    _, out = scans(VOICED, header(WALLS_M, WALL_PAIRS), noise)
    assert all(s.searched.all() for s in out)
    assert np.mean([len(s.detections[0]) for s in out]) < 0.05


def test_a_pair_without_a_peak_is_invalid():
    x = free_field(4, [[1.3, 1.1, 1.5]], WALLS_M)
    x[:, :2] = 0.1 * np.random.default_rng(4).standard_normal((len(x), 2))
    _, out = scans(replace(VOICED, pair_share=1.0, window_s=3e-5), header(WALLS_M, WALL_PAIRS), x)
    valid = np.concatenate([s.detections[0].valid for s in out])
    assert valid[:, 1:].mean() > 0.9
    assert valid[:, 0].mean() < 0.3


def test_silence_is_not_searched():
    _, out = scans(SrpPeaks(), header(WALLS_M, WALL_PAIRS), np.zeros((8000, 8), np.float32))
    assert not any(s.searched.any() or s.detections or s.fields for s in out)


def test_tables_come_with_sensors_of_their_own_that_are_only_a_field():
    setup, out = scans(replace(VOICED, tables=True), header(WALLS_M, WALL_PAIRS), free_field(1, [[1.3, 1.1, 1.5]], WALLS_M))
    assert [s.name for s in setup.sensors] == ["stack", "pair-0", "pair-1", "pair-2", "pair-3"]
    assert out[0].searched.tolist() == [True, False, False, False, False]
    at = out[0].fields["gcc"].at(_expected([1.3, 1.1, 1.5])[:, None], np.arange(1, 5))
    assert at.min() > 0.8


@settings(max_examples=8, deadline=None)
@given(st.lists(st.integers(0, 9000), max_size=8))
def test_scans_are_the_same_bit_for_bit_however_blocks_are_cut(cuts):
    x = free_field(6, [[1.0, 1.0, 1.5], [3.0, 2.0, 1.5]], WALLS_M, seconds=9000 / 8000)
    whole, pieces = (scans(SrpPeaks(grid_m=0.2), header(WALLS_M, WALL_PAIRS), x, c)[1] for c in ([], cuts))
    assert identical(whole, pieces)


def test_a_recording_without_room_or_height_is_refused():
    recording = header(WALLS_M, WALL_PAIRS)
    with pytest.raises(SetupError, match="box_m"):
        VOICED.open(replace(recording, box_m=None))
    with pytest.raises(SetupError, match="height_m"):
        VOICED.open(replace(recording, nominal={}))
    with pytest.raises(SetupError, match="grid_m"):
        replace(VOICED, grid_m=0.0).open(recording)
    with pytest.raises(SetupError, match="srp-peaks reads samples"):
        VOICED.open(Header("nothing"))
