"""What it costs to watch what components use: a trial's question, and an import statement inside a function."""

from __future__ import annotations

import pytest

from sonobench import Registry
from sonobench.components import build
from sonobench.harness.code import closure
from sonobench.harness.parts import covered
from sonobench.uses import beyond, watching


def importing():
    import json
    from math import pi

    return json, pi


def test_what_a_tracker_used_beyond_its_key(benchmark):
    known = covered(closure(build("pipeline", "smc-phd", Registry.load()).tracker, "sonobench.pipeline"))
    assert benchmark(beyond, known["names"], known["sources"], ("cache", "recording")) == []


@pytest.mark.parametrize("watched", [False, True])
def test_two_imports_inside_a_function(benchmark, watched):
    if not watched:
        benchmark(importing)
        return
    with watching():
        benchmark(importing)
