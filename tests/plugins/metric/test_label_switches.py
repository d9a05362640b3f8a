"""Label switches and fragments against stories, and against matching by enumeration."""

import dataclasses
import itertools

import numpy as np
import pytest
from scoring_tracks import SPACE, made, random

from sonobench.errors import InputError
from sonobench.scoring import score
from sonobench_plugins.metric.label_switches import LabelSwitches


def counts(truth, found, **values):
    columns = LabelSwitches(**values).evaluate(*made(truth, found), SPACE)
    return columns[""].values.sum(), columns["fragments"].values.sum(), columns[""].coverage


def line(frames, y=0.0):
    return {k: (0.1 * k, y) for k in frames}


def test_a_track_of_one_label_neither_switches_nor_breaks():
    assert counts({1: line(range(1, 9))}, {5: line(range(1, 9))}) == (0, 0, 1.0)


def test_a_new_label_is_a_switch_and_a_gap_a_fragment():
    truth = {1: line(range(1, 9))}
    assert counts(truth, {5: line(range(1, 5)), 6: line(range(5, 9))}) == (1, 0, 1.0)
    assert counts(truth, {5: line([1, 2, 5, 6, 7, 8])}) == (0, 1, 0.75)
    assert counts(truth, {5: line([1, 2]), 6: line([5, 6, 7, 8])}) == (1, 1, 0.75)
    assert counts(truth, {5: line([3, 4, 5])}) == (0, 0, 3 / 8)  # late and short, in one piece


def test_a_target_that_was_away_is_no_fragment():
    assert counts({1: line([1, 2, 5, 6])}, {5: line([1, 2, 5, 6])}) == (0, 0, 1.0)


def test_labels_that_swap_are_two_switches():
    truth = {1: line(range(1, 9)), 2: line(range(1, 9), 0.5)}
    found = {5: line(range(1, 5)) | line(range(5, 9), 0.5), 6: line(range(1, 5), 0.5) | line(range(5, 9))}
    assert counts(truth, found, c_m=0.3) == (2, 0, 1.0)
    assert counts(truth, found, c_m=1.0) == (0, 0, 1.0)  # a label is kept within the gate, though another is nearer


def by_enumeration(truth, found, c, frames=8):
    """CLEAR MOT in words: keep what was matched and is near, then the best assignment of the rest over all there are."""
    last, lost, switches, fragments = {}, set(), 0, 0
    for k in range(1, frames + 1):
        here, there = ({n: np.array(t[k]) for n, t in side.items() if k in t} for side in (truth, found))
        d = {(i, j): float(np.linalg.norm(here[i] - there[j])) for i in here for j in there}
        now = {}
        for i, j in sorted(((i, last[i]) for i in here if last.get(i) in there), key=d.get):
            if d[i, j] < c and j not in now.values():
                now[i] = j
        free, others = [i for i in here if i not in now], [j for j in there if j not in now.values()]
        choices = [list(zip(free, o, strict=True)) for o in itertools.permutations(others + [None] * len(free), len(free))]
        best = min(choices, key=lambda pairs: sum(min(d.get(pair, c), c) ** 2 for pair in pairs))
        now |= {i: j for i, j in best if d.get((i, j), c) < c}
        switches += sum(last.get(i, j) != j for i, j in now.items())
        fragments += sum(i in lost for i in now)
        lost = (lost | {i for i in here if i in last and i not in now}) - now.keys()
        last |= now
    return switches, fragments


@pytest.mark.parametrize("seed", range(12))
def test_counts_are_those_of_an_enumeration(seed):
    rng = np.random.default_rng(seed)
    truth, found = random(rng, 3), random(rng, 4)
    assert counts(truth, found, c_m=0.5)[:2] == by_enumeration(truth, found, 0.5)


def test_the_score_is_a_number_a_target():
    known, estimates = made({1: line(range(1, 9)), 2: line(range(1, 9), 5.0)}, {5: line(range(1, 5)), 6: line(range(5, 9))})
    rows = {r.metric: r for r in score(LabelSwitches(), known, estimates, SPACE)}
    assert rows["label-switches"].value == 0.5
    assert rows["label-switches"].coverage == 0.5


def test_unlabelled_estimates_are_undefined():
    known, estimates = made({1: line([1, 2])}, {5: line([1, 2])})
    rows = score(LabelSwitches(), known, [dataclasses.replace(e, labels=None) for e in estimates], SPACE)
    assert all(np.isnan(r.value) and r.coverage == 0 for r in rows)
    with pytest.raises(InputError):
        LabelSwitches(c_m=0.0)
