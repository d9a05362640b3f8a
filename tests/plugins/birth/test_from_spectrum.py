"""Births at peaks of spectra: what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from sonobench import DelayTable, InputError, Scan, Space
from sonobench.filtering.mixture import empty
from sonobench_plugins.birth.from_spectrum import FromSpectrum, Seen

_SPACE = Space.of("azimuth_rad", "azimuth_rad_s", "elevation_rad", "elevation_rad_s")


def test_another_field_than_the_named_one_is_refused_and_no_field_proposes_nobody() -> None:
    birth, memory, rng = FromSpectrum(field="spectra"), Seen(_SPACE, (0,)), np.random.default_rng(0)
    after, born = birth.propose(rng, memory, Scan(0.5, np.zeros(1, bool)), empty(4))
    assert after is memory
    assert len(born.w) == 0
    other = Scan(0.5, np.zeros(1, bool), fields={"spectrum": DelayTable(np.zeros((1, 3)), 0.0, 1.0)})
    with pytest.raises(InputError, match=r"'spectra'; the scan at 0.5 s has \['spectrum'\]"):
        birth.propose(rng, memory, other, empty(4))
