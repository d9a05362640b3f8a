"""Directions where the subspace of the fourth-order cumulants is met: up to six sources, in Gaussian noise of any covariance.

Source: Schmidt 1986 (MUSIC) on the cumulant matrix: Porat & Friedlander 1991; Zhang et al. (Cum-AMMS-GLMB), section 2.1.
Deviations: the direction that |u| = 1 leaves dead is projected out; eigenvalues are sorted by magnitude; peaks are refined off the grid. R
follows from the sampling error of the cumulants (`sonobench.signal.subspace`). The score is −10 log10 of the share of b(u) outside the
subspace, dB.
"""

from __future__ import annotations

from dataclasses import dataclass

from sonobench.protocols import Directions
from sonobench.signal.cumulants import Mean, moments
from sonobench.signal.subspace import Order, Rule, found_peaks
from sonobench.types import Floats


@dataclass(frozen=True)
class CumulantPeaks:
    """Peaks of the cumulant spectrum, as many as the order says."""

    order: Rule = "error"  #: "error" (what is left is sampling error), "threshold", "gap" or "given"
    sources: int = 1  #: how many, for "given"
    threshold: float = 0.1  #: share of the largest eigenvalue's magnitude, for "threshold"
    significance: float = 0.003  #: for "error": how improbable what is left must be for there to be one more
    most: int = 6  #: at most this many sources; with more, directions are not unique
    mean: Mean = "unknown"  #: "zero" where samples are known to have none

    def __post_init__(self) -> None:
        self._order()
        if not 1 <= self.most <= 8:
            raise ValueError(f"most is {self.most}; 1 to 8 is needed")

    def directions(self, samples: Floats) -> Directions:
        """Frames (f, N, 4) → up to `most` directions each, the best first."""
        return found_peaks(moments(samples, self.mean, error=True), True, self._order())

    def _order(self) -> Order:
        return Order(self.order, self.sources, self.threshold, self.significance, self.most)
