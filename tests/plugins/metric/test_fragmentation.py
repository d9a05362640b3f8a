"""Pieces of tracks against stories, and against an enumeration of runs."""

import dataclasses
import itertools

import numpy as np
import pytest
from scoring_tracks import SPACE, made, random

from sonobench.errors import InputError
from sonobench.scoring import score
from sonobench_plugins.metric.fragmentation import Fragmentation


def counts(truth, found, **values):
    columns = Fragmentation(**values).evaluate(*made(truth, found), SPACE)
    return [columns[name].values.tolist() for name in ("", "longest", "strays")]


def line(frames, y=0.0):
    return {k: (0.1 * k, y) for k in frames}


def test_a_track_of_one_label_is_one_piece():
    assert counts({1: line(range(1, 9))}, {5: line(range(1, 9))}) == [[0], [1.0], [0]]
    assert counts({1: line(range(1, 9))}, {5: line([3, 4, 5, 6])}) == [[0], [0.5], [0]]
    assert counts({1: line([1, 2, 5, 6])}, {5: line([1, 2, 5, 6])}) == [[0], [1.0], [0]]  # away is no break


def test_a_new_label_and_a_gap_begin_a_piece_each():
    truth = {1: line(range(1, 9))}
    assert counts(truth, {5: line(range(1, 5)), 6: line(range(5, 9))}) == [[1], [0.5], [0]]
    assert counts(truth, {5: line([1, 2, 5, 6, 7, 8])}) == [[1], [0.5], [0]]
    assert counts(truth, {5: line([1, 2, 3]), 6: line([6, 7, 8])}) == [[1], [0.375], [0]]


def test_a_label_that_no_target_has_is_a_stray():
    assert counts({1: line(range(1, 9))}, {5: line(range(1, 9)), 6: line([1, 2], 5.0)}) == [[0], [1.0], [1]]
    assert counts({1: line(range(1, 3))}, {}) == [[0], [0.0], [0]]


def by_enumeration(truth, found, c, frames=8):
    """Matches as CLEAR MOT says it, over every assignment, then runs of equal labels over each target's frames."""
    last, told = {}, {n: [] for n in truth}
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
        for i in here:
            told[i].append(now.get(i))
        last |= now
    runs = {i: [len(list(g)) for label, g in itertools.groupby(x) if label is not None] for i, x in told.items()}
    strays = len(found) - len({j for x in told.values() for j in x if j is not None})
    return [max(len(r) - 1, 0) for r in runs.values()], [max(r, default=0) / len(told[i]) for i, r in runs.items()], strays


@pytest.mark.parametrize("seed", range(10))
def test_counts_are_those_of_an_enumeration(seed):
    rng = np.random.default_rng(seed)
    truth, found = random(rng, 3), random(rng, 4)
    beyond, longest, strays = counts(truth, found, c_m=0.5)
    assert (beyond, longest, sum(strays)) == (*by_enumeration(truth, found, 0.5)[:2], pytest.approx(by_enumeration(truth, found, 0.5)[2]))


def test_the_score_is_a_number_a_target_and_needs_labels():
    known, estimates = made({1: line(range(1, 9)), 2: line(range(1, 9), 5.0)}, {5: line(range(1, 5)), 6: line(range(5, 9))})
    rows = {r.metric: r for r in score(Fragmentation(), known, estimates, SPACE)}
    assert rows["fragmentation"].value == 0.5
    assert rows["fragmentation.longest"].value == 0.25
    bare = score(Fragmentation(), known, [dataclasses.replace(e, labels=None) for e in estimates], SPACE)
    assert all(np.isnan(r.value) and r.coverage == 0 for r in bare)
    with pytest.raises(InputError):
        Fragmentation(c_m=0.0)
