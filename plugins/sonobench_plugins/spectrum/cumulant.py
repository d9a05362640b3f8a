"""Sources per steradian from the subspace of the fourth-order cumulants: up to six sources, in Gaussian noise of any covariance.

Source: Zhang et al. (Cum-AMMS-GLMB), section 2.1, whose formulas follow Porat & Friedlander 1991 and Chevalier et al. 2005.
Deviations: the direction that |u| = 1 leaves dead is projected out, so that six sources are resolved, not the paper's eight; eigenvalues
are sorted by magnitude (a uniform source's is negative); the spectrum is scaled to the number of sources, by the sampling error of
the cumulants (`sonobench.signal.subspace`), not to a maximum of 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sonobench.signal.cumulants import Mean, moments
from sonobench.signal.subspace import Order, Rule, spectrum, subspace
from sonobench.types import DirectionSpectrum, Floats


@dataclass(frozen=True)
class CumulantSpectrum:
    """MUSIC-like spectrum of cumulants."""

    order: Rule = "error"  #: "error" (what is left is sampling error), "threshold", "gap" or "given"
    sources: int = 1  #: how many, for "given"
    threshold: float = 0.1  #: share of the largest eigenvalue's magnitude, for "threshold"
    significance: float = 0.003  #: for "error": how improbable what is left must be for there to be one more
    most: int = 6  #: at most this many sources; with more, directions are not unique
    mean: Mean = "unknown"  #: "zero" where samples are known to have none
    width_rad: float = 0.017453  #: no peak is narrower: motion within a frame, errors of the sensor

    def __post_init__(self) -> None:
        self._order()
        if not (1 <= self.most <= 8 and self.width_rad > 0):
            raise ValueError(f"most is {self.most}, width_rad {self.width_rad}; 1 to 8 and above 0 is needed")

    def fields(self, samples: Floats) -> Sequence[DirectionSpectrum]:
        """A spectrum a frame."""
        found = moments(samples, self.mean, error=True)
        return [spectrum(subspace(found, k, True, self._order()), self.width_rad) for k in range(len(found.cumulant))]

    def _order(self) -> Order:
        return Order(self.order, self.sources, self.threshold, self.significance, self.most)
