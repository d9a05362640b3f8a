"""Directions where the subspace of the covariance matrix is met: up to two sources, in white noise that is equal on all channels.

Source: Schmidt 1986 (MUSIC); for vector sensors Wong & Zoltowski 2000, "Self-initiating MUSIC-based direction finding".
Peaks are refined off the grid; R follows from the sampling error of the covariances (`sonobench.signal.subspace`), and knows nothing of
noise that is unequal or correlated. The score is −10 log10 of the share of a(u) outside the subspace, dB.
"""

from __future__ import annotations

from dataclasses import dataclass

from sonobench.protocols import Directions
from sonobench.signal.cumulants import Mean, moments
from sonobench.signal.subspace import Order, Rule, found_peaks
from sonobench.types import Floats


@dataclass(frozen=True)
class CovariancePeaks:
    """Peaks of the covariance spectrum, as many as the order says."""

    order: Rule = "error"  #: "error" (what is left is sampling error), "threshold", "gap" or "given"
    sources: int = 1  #: how many, for "given"
    threshold: float = 0.1  #: share of the largest eigenvalue less the smallest, for "threshold"
    significance: float = 0.003  #: for "error": how improbable what is left must be for there to be one more
    most: int = 2  #: at most this many sources; three already make a circle of directions
    mean: Mean = "unknown"  #: "zero" where samples are known to have none

    def __post_init__(self) -> None:
        self._order()
        if not 1 <= self.most <= 2:
            raise ValueError(f"most is {self.most}; 1 or 2 is needed")

    def directions(self, samples: Floats) -> Directions:
        """Frames (f, N, 4) → up to `most` directions each, the best first."""
        return found_peaks(moments(samples, self.mean, error=True), False, self._order())

    def _order(self) -> Order:
        return Order(self.order, self.sources, self.threshold, self.significance, self.most)
