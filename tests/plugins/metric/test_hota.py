"""HOTA of the library against its definition written out."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scoring_tracks import SPACE, made, random

from sonobench.errors import InputError, SetupError
from sonobench.scoring import score
from sonobench_plugins.metric.hota import Hota


def line(frames, y=0.0):
    return {k: (0.1 * k, y) for k in frames}


def test_without_the_library_the_error_says_what_to_install(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "trackeval", None)
    with pytest.raises(SetupError, match=r"pip install 'sonobench\[mot\]'"):
        Hota().evaluate(*made({1: line([1])}, {5: line([1])}), SPACE)
    with pytest.raises(InputError):
        Hota(c_m=0.0)


def by_definition(truth, found, c, frames=8):
    """Luiten et al. 2021, eq. 13 to 17: matches at each threshold, then for each how well its two tracks agree."""
    likeness = {
        (k, i, j): max(0.0, 1 - np.hypot(*np.subtract(truth[i][k], found[j][k])) / c)
        for k in range(1, frames + 1)
        for i in truth
        for j in found
        if k in truth[i] and k in found[j]
    }
    potential = dict.fromkeys(((i, j) for i in truth for j in found), 0.0)
    for (k, i, j), s in likeness.items():
        all_ = sum(v for (q, a, b), v in likeness.items() if q == k and (a == i or b == j))
        potential[i, j] += s / all_ if all_ else 0.0
    together = {(i, j): p / (len(truth[i]) + len(found[j]) - p) for (i, j), p in potential.items()}
    scores = []
    for alpha in np.arange(0.05, 0.99, 0.05):
        matched = []
        for k in range(1, frames + 1):
            here, there = [i for i in truth if k in truth[i]], [j for j in found if k in found[j]]
            table = np.array([[together[i, j] * likeness[k, i, j] for j in there] for i in here]).reshape(len(here), len(there))
            matched += [
                (here[a], there[b])
                for a, b in zip(*linear_sum_assignment(-table), strict=True)
                if likeness[k, here[a], there[b]] >= alpha - 1e-15
            ]
        tp = len(matched)
        total = sum(map(len, truth.values())) + sum(map(len, found.values()))
        agree = [matched.count((i, j)) / (len(truth[i]) + len(found[j]) - matched.count((i, j))) for i, j in matched]
        scores.append((np.sqrt(sum(agree) / (total - tp)), tp / (total - tp), np.mean(agree) if agree else 0.0))
    return np.mean(scores, axis=0)


@pytest.mark.parametrize("seed", range(4))
def test_it_is_the_definition(seed):
    pytest.importorskip("trackeval")
    rng = np.random.default_rng(seed)
    truth, found = random(rng, 3), random(rng, 3)
    columns = Hota(c_m=0.8).evaluate(*made(truth, found), SPACE)
    ours = [columns[name].values[0] for name in ("", "detection", "association")]
    np.testing.assert_allclose(ours, by_definition(truth, found, 0.8), atol=1e-9)


def test_a_perfect_track_is_one_and_a_split_one_loses_association_only():
    pytest.importorskip("trackeval")
    truth = {1: line(range(1, 9))}
    assert Hota().evaluate(*made(truth, {5: line(range(1, 9))}), SPACE)[""].values[0] == pytest.approx(1)
    split = Hota().evaluate(*made(truth, {5: line(range(1, 5)), 6: line(range(5, 9))}), SPACE)
    assert [split[n].values[0] for n in ("", "detection", "association")] == pytest.approx([np.sqrt(0.5), 1.0, 0.5])


def test_unlabelled_estimates_are_undefined():
    pytest.importorskip("trackeval")
    known, estimates = made({1: line([1, 2])}, {5: line([1, 2])})
    rows = score(Hota(), known, [dataclasses.replace(e, labels=None) for e in estimates], SPACE)
    assert all(np.isnan(r.value) and r.coverage == 0 for r in rows)
