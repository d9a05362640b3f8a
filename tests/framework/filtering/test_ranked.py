"""Ranked assignments against all of them, sorted."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sonobench.filtering.ranked import ranked


def every(log_start, tables, private):
    """All assignments of all tables, the heaviest first."""
    found = []
    for h, table in enumerate(tables):
        n, c = table.shape
        for choice in itertools.product(range(c), repeat=n):
            used = [j for j in choice if j >= private]
            weight = log_start[h] + sum(table[i, j] for i, j in enumerate(choice))
            if len(set(used)) == len(used) and np.isfinite(weight):
                found.append((weight, h, choice))
    return sorted(found, reverse=True)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.lists(st.integers(0, 3), min_size=1, max_size=3), st.integers(1, 2), st.integers(0, 3))
def test_it_is_the_sorted_list_of_all(seed, sizes, private, rows):
    rng = np.random.default_rng(seed)
    tables = [rng.normal(0, 3, (n, private + rows)) for n in sizes]
    tables = [np.where(rng.random(t.shape) < 0.15, -np.inf, t) for t in tables]
    log_start = rng.normal(0, 2, len(sizes))
    ours, theirs = list(ranked(log_start, tables, private)), every(log_start, tables, private)
    assert [(h, tuple(c)) for _, h, c in ours] == [(h, c) for _, h, c in theirs]
    assert [w for w, _, _ in ours] == pytest.approx([w for w, _, _ in theirs], abs=1e-9)


def test_tables_are_not_changed():
    table = np.zeros((2, 3))
    table.flags.writeable = False
    assert len(list(ranked(np.zeros(1), [table], 1))) == len(every([0.0], [table], 1)) == 7
