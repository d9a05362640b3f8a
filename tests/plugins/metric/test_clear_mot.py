"""CLEAR MOT of the library against stories and against the bundled counts of switches."""

import dataclasses

import numpy as np
import pytest
from scoring_tracks import SPACE, made, random

from sonobench.errors import InputError, SetupError
from sonobench.scoring import score
from sonobench_plugins.metric import clear_mot
from sonobench_plugins.metric.clear_mot import ClearMot


def line(frames, y=0.0):
    return {k: (0.1 * k, y) for k in frames}


def test_without_the_library_the_error_says_what_to_install(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "motmetrics", None)
    with pytest.raises(SetupError, match=r"pip install 'sonobench\[mot\]'"):
        ClearMot().evaluate(*made({1: line([1])}, {5: line([1])}), SPACE)
    assert clear_mot.ClearMot(c_m=2.0).c_m == 2.0


def test_parameters_are_checked_without_the_library():
    with pytest.raises(InputError):
        ClearMot(c_m=0.0)


def values(truth, found, **more):
    pytest.importorskip("motmetrics")
    return {name: s.values[0] for name, s in ClearMot(**more).evaluate(*made(truth, found), SPACE).items()}


def test_mota_counts_misses_false_ones_and_switches():
    truth = {1: line(range(1, 9)), 2: line(range(1, 9), 3.0)}
    perfect = values(truth, {5: line(range(1, 9)), 6: line(range(1, 9), 3.0)})
    assert (perfect[""], perfect["idf1"], perfect["motp"]) == (1.0, 1.0, 0.0)
    found = {5: line(range(1, 5)), 6: line(range(5, 9)), 7: line([1, 2], 9.0)}  # a switch, eight misses, two false ones
    poor = values(truth, found)
    assert poor[""] == pytest.approx(1 - (1 + 8 + 2) / 16)
    assert [16 * poor[n] for n in ("switches", "missed", "false")] == pytest.approx([1, 8, 2])


@pytest.mark.parametrize("seed", range(4))
def test_errors_add_up(seed):
    rng = np.random.default_rng(seed)
    found = values(random(rng, 3), random(rng, 4), c_m=0.5)
    assert found[""] == pytest.approx(1 - found["switches"] - found["missed"] - found["false"])


def test_unlabelled_estimates_are_undefined():
    pytest.importorskip("motmetrics")
    known, estimates = made({1: line([1, 2])}, {5: line([1, 2])})
    rows = score(ClearMot(), known, [dataclasses.replace(e, labels=None) for e in estimates], SPACE)
    assert all(np.isnan(r.value) and r.coverage == 0 for r in rows)
