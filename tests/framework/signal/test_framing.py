import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sonobench import Block, InputError, SetupError
from sonobench.signal import drain, empty_tail, framing, push, window


def _frames(plan, tail, blocks):
    groups = []
    for block in blocks:
        tail, done = push(plan, tail, block)
        groups += done
    groups += drain(plan, tail)
    return groups


@given(n=st.integers(0, 400), cuts=st.lists(st.integers(0, 400), max_size=8), length=st.integers(2, 60), share=st.floats(0.05, 1.0))
def test_frames_are_the_plain_slices_however_blocks_are_cut(n, cuts, length, share):
    hop = max(1, int(share * length))
    samples = np.random.default_rng(n).standard_normal((n, 2)).astype(np.float32)
    plan = framing({"a": 2}, length / 100.0, hop / 100.0, 100.0)
    edges = [0, *sorted(c for c in cuts if c <= n), n]
    groups = _frames(plan, empty_tail(plan), [Block("a", a, samples[a:b]) for a, b in itertools.pairwise(edges)])
    starts = range(0, n - length + 1, hop)
    frames = [f for g in groups for f in g.samples]
    assert len(frames) == len(starts)
    assert all(np.array_equal(f, samples[s : s + length]) for f, s in zip(frames, starts, strict=True))
    assert [g.first for g in groups] == list(range(0, len(starts), 8))


def test_arrays_of_one_clock_wait_for_each_other_and_stand_side_by_side():
    a, b = np.arange(40, dtype=np.float32)[:, None], -np.arange(40, dtype=np.float32)[:, None]
    plan = framing({"a": 1, "b": 1}, 0.08, 0.04, 100.0)
    groups = _frames(plan, empty_tail(plan), [Block("a", 0, a), Block("x", 0, a), Block("b", 0, b[:25]), Block("b", 25, b[25:])])
    frames = np.concatenate([g.samples for g in groups])
    assert frames.shape == (9, 8, 2)
    assert np.array_equal(frames[..., 0], -frames[..., 1])


def test_time_is_the_centre_of_the_samples():
    plan = framing({"a": 1}, 0.05, 0.02, 100.0, start_s=3.0)
    assert plan.time_s(0) == pytest.approx(3.0 + np.mean(np.arange(5)) / 100)
    assert plan.time_s(4) == pytest.approx(3.0 + np.mean(np.arange(8, 13)) / 100)


@pytest.mark.parametrize("name", ["hann", "hamming"])
def test_half_overlapped_windows_add_up_to_a_constant(name):
    w = window(name, 64)
    assert np.ptp(w[:32] + w[32:]) < 1e-12


def test_unknown_window_is_named():
    with pytest.raises(ValueError, match="hanning"):
        window("hanning", 8)


@pytest.mark.parametrize(("frame_s", "hop_s"), [(0.0, 0.1), (0.1, 0.0), (0.1, 0.2)])
def test_impossible_frames_are_refused(frame_s, hop_s):
    with pytest.raises(SetupError, match="hop_s"):
        framing({"a": 1}, frame_s, hop_s, 100.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_samples_that_are_not_finite_are_named(bad):
    samples = np.zeros((9, 2), np.float32)
    samples[4, 1] = bad
    plan = framing({"a": 2}, 0.05, 0.05, 100.0)
    with pytest.raises(InputError, match=r"array a: sample 4 of channel 1"):
        push(plan, empty_tail(plan), Block("a", 0, samples))


def test_lost_blocks_and_wrong_channels_are_refused():
    plan = framing({"a": 2}, 0.05, 0.05, 100.0)
    with pytest.raises(InputError, match="sample 0 was due"):
        push(plan, empty_tail(plan), Block("a", 7, np.zeros((3, 2), np.float32)))
    with pytest.raises(InputError, match="3 channels"):
        push(plan, empty_tail(plan), Block("a", 0, np.zeros((3, 3), np.float32)))
