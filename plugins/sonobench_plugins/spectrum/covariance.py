"""Sources per steradian from the subspace of the covariance matrix: up to two sources, in white noise that is equal on all channels.

The rival of the cumulants in Zhang et al. (Cum-AMMS-GLMB), section 5.2 (Cov-GLMB).
Source: Schmidt 1986; for vector sensors Wong & Zoltowski 2000, "Self-initiating MUSIC-based direction finding".
Deviations: scaled to the number of sources by the sampling error of the covariances, not to a maximum of 1. Noise is presumed equal on the
four channels; unequal or correlated noise turns the subspace, and nothing here can know.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sonobench.signal.cumulants import Mean, moments
from sonobench.signal.subspace import Order, Rule, spectrum, subspace
from sonobench.types import DirectionSpectrum, Floats


@dataclass(frozen=True)
class CovarianceSpectrum:
    """MUSIC spectrum of covariances."""

    order: Rule = "error"  #: "error" (what is left is sampling error), "threshold", "gap" or "given"
    sources: int = 1  #: how many, for "given"
    threshold: float = 0.1  #: share of the largest eigenvalue less the smallest, for "threshold"
    significance: float = 0.003  #: for "error": how improbable what is left must be for there to be one more
    most: int = 2  #: at most this many sources; three already make a circle of directions
    mean: Mean = "unknown"  #: "zero" where samples are known to have none
    width_rad: float = 0.017453  #: no peak is narrower: motion within a frame, errors of the sensor

    def __post_init__(self) -> None:
        self._order()
        if not (1 <= self.most <= 2 and self.width_rad > 0):
            raise ValueError(f"most is {self.most}, width_rad {self.width_rad}; 1 or 2 and above 0 is needed")

    def fields(self, samples: Floats) -> Sequence[DirectionSpectrum]:
        """A spectrum a frame."""
        found = moments(samples, self.mean, error=True)
        return [spectrum(subspace(found, k, False, self._order()), self.width_rad) for k in range(len(found.cumulant))]

    def _order(self) -> Order:
        return Order(self.order, self.sources, self.threshold, self.significance, self.most)
