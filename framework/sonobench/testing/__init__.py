"""The conformance kit: puts a component through every claim that its role makes.

    from sonobench.testing import check
    findings = check(MyTracker(), "tracker")

`CHECKS` is the one table of what is checked. Every signal, setup and scan is synthetic and made here.
"""

from __future__ import annotations

from sonobench.testing import (  # noqa: F401  (fill CHECKS)
    directions,
    front_ends,
    general,
    likelihoods,
    metrics,
    mixtures,
    models,
    preprocessors,
    scenes,
    signals,
    trackers,
    weighing,
)
from sonobench.testing.kit import CHECKS, Check, Finding, check, check_file

__all__ = ["CHECKS", "Check", "Finding", "check", "check_file"]
