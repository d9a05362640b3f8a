from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from signal_sounds import BOX_M, RATE_HZ, WALL_PAIRS, WALLS_M, delayed, every_pair, free_field, header, scans

from sonobench import Block, Header, MicArray, SetupError, identical
from sonobench.geometry import pair_delays
from sonobench_plugins.activity.always import Always
from sonobench_plugins.front_end.gcc_max import GccMax

VOICED = GccMax(activity=Always(), frame_s=0.128, hop_s=0.064)
TALKERS_M = [[1.0, 0.9, 1.5], [3.0, 2.1, 1.5], [2.2, 0.7, 1.5]]


class Sounding:
    """Voice where there is any sound, in whole frames."""

    def start(self, rate_hz):
        return None

    def active(self, state, frames):
        return state, np.abs(frames[:, -1]).max(axis=-1) > 0


def isolated(names=("a/x", "a/y", "a/z"), lengths=None):
    """A recording with a copy of the array a talker, and its blocks of 0.1 s in order of time."""
    arrays = tuple(MicArray(name, "microphones", WALLS_M, RATE_HZ, WALL_PAIRS) for name in names)
    made = Header("test", arrays, np.tile(np.eye(4), (len(names), 1, 1)), box_m=BOX_M, nominal={"height_m": 1.5})
    sounds = {n: free_field(seed, [at], WALLS_M) for seed, (n, at) in enumerate(zip(names, TALKERS_M, strict=False))}
    if lengths:
        sounds = {n: x[:length] for (n, x), length in zip(sounds.items(), lengths, strict=True)}
    blocks = [Block(n, k, x[k : k + 800]) for k in range(0, 12000, 800) for n, x in sounds.items() if k < len(x)]
    return made, blocks


def played(front_end, made, blocks):
    setup, state = front_end.open(made)
    out = []
    for block in blocks:
        state, done = front_end.step(state, block)
        out += done
    return setup, out + front_end.flush(state)


@pytest.mark.parametrize("delays", [(0, 3, -5, 8), (0.5, -0.5, 4.25, -4.75)])
def test_the_delays_of_one_sound_are_one_row_right_to_a_twentieth_of_a_sample(delays):
    pairs, d = every_pair(4), np.array(delays)
    mics = np.array([[0, 0, 0], [0.5, 0, 0], [0, 0.6, 0], [0, 0, 0.7]], float)
    x = delayed(np.random.default_rng(1).standard_normal(8000), d / RATE_HZ).astype(np.float32)
    setup, out = scans(VOICED, header(mics, pairs), x)
    assert [s.name for s in setup.sensors] == ["stack"]
    for scan in out:
        assert scan.detections[0].z.shape == (1, 6)
        assert np.abs(scan.detections[0].z[0] * RATE_HZ - (d[pairs[:, 0]] - d[pairs[:, 1]])).max() < 0.05


def test_a_delay_beyond_the_aperture_is_never_reported():
    pairs = every_pair(2)
    mics = np.array([[0.0, 0, 0], [0.1, 0, 0]])
    x = delayed(np.random.default_rng(2).standard_normal(8000), np.array([0.0, 20 / RATE_HZ])).astype(np.float32)
    _, out = scans(VOICED, header(mics, pairs), x)
    assert all(np.abs(s.detections[0].z).max() <= 0.1 / 343.0 for s in out)


def test_isolated_talkers_are_rows_of_one_sensor():
    made, blocks = isolated()
    setup, out = played(VOICED, made, blocks)
    assert [(s.name, s.array) for s in setup.sensors] == [("stack", "a/x")]
    true = np.array([pair_delays(np.array(at), WALLS_M, WALL_PAIRS, 343.0) for at in TALKERS_M])
    assert len(out) == 22
    for scan in out:
        assert np.abs(scan.detections[0].z - true[np.lexsort(true.T[::-1])]).max() < 1e-5


def test_rows_do_not_tell_which_copy_they_came_from():
    (made, blocks), names = isolated(), ["a/x", "a/y", "a/z"]
    swapped = dict(zip(names, ["a/z", "a/x", "a/y"], strict=True))
    renamed = [Block(swapped[b.array], b.first_sample, b.samples) for b in blocks]
    _, plain = played(VOICED, made, blocks)
    _, moved = played(VOICED, made, renamed)
    assert identical(plain, moved)


def test_a_copy_in_whose_frame_nobody_talks_gives_no_row():
    made, blocks = isolated()
    quiet = [Block(b.array, b.first_sample, 0 * b.samples) if b.array == "a/y" or b.first_sample >= 6400 else b for b in blocks]
    _, out = played(replace(VOICED, activity=Sounding()), made, quiet)
    assert {len(s.detections[0]) for s in out if s.detections} == {2}
    assert [s.searched.tolist() for s in out[-2:]] == [[False], [False]]
    assert not out[-1].detections


def test_copies_of_unequal_length_wait_for_each_other_and_the_shorter_ends_first():
    made, blocks = isolated(lengths=[12000, 7000, 12000])
    whole = played(VOICED, *isolated())[1]
    _, out = played(VOICED, made, blocks)
    assert [len(s.detections[0]) for s in out] == [3] * 12 + [2] * 10
    assert identical(out[:8], whole[:8])


@settings(max_examples=10, deadline=None)
@given(st.lists(st.integers(0, 9000), max_size=8))
def test_scans_are_the_same_bit_for_bit_however_blocks_are_cut(cuts):
    x = free_field(6, [[1.0, 1.0, 1.5]], WALLS_M, seconds=9000 / RATE_HZ)
    whole, pieces = (scans(GccMax(memory_s=0.1), header(WALLS_M, WALL_PAIRS), x, c)[1] for c in ([], cuts))
    assert identical(whole, pieces)


def test_a_dead_microphone_silences_only_its_pairs():
    x = free_field(1, [[1.0, 1.0, 1.5]], WALLS_M)
    x[:, 2] = 0.0
    _, out = scans(VOICED, header(WALLS_M, WALL_PAIRS), x)
    assert out[0].detections[0].valid.tolist() == [[True, False, True, True]]


def test_arrays_that_differ_in_their_copies_are_refused():
    made, _ = isolated()
    other = MicArray("b", "microphones", WALLS_M + 0.1, RATE_HZ, WALL_PAIRS)
    mixed = replace(made, arrays=(*made.arrays, other), array_names=(*made.array_names, "b"), poses=np.tile(np.eye(4), (4, 1, 1)))
    with pytest.raises(SetupError, match=r"unequal numbers \{'a/x': 3, 'b': 1\}"):
        VOICED.open(mixed)
    with pytest.raises(SetupError, match="gcc-max reads samples of microphones"):
        VOICED.open(Header("nothing"))
