"""Directions by generalised least squares: all sources at once, fitted to cumulants and covariances weighted by their sampling error.

Starts: the peaks of the cumulant subspace, an orthogonal matching pursuit, and several that are drawn once for all. With order "fit" the number
of sources is the smallest, from what the subspace shows on, whose misfit sampling error explains; where none does (the model does
not hold) it is what the subspace shows. R is the inverse of the fit's Fisher matrix; the score is the cumulant over its deviation.
Source: `sonobench.signal.direction_fit`. Not in Zhang et al. (Cum-AMMS-GLMB): a stronger front end beside the paper's spectrum.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sonobench.protocols import Directions
from sonobench.signal.cumulants import Mean, Moments, moments
from sonobench.signal.direction_fit import Fit, Noise, explained, fit_directions, pursued, random_starts
from sonobench.signal.subspace import Order, gathered, peaks, subspace
from sonobench.types import Array, Floats


@dataclass(frozen=True)
class Gls:
    """Generalised least squares on moments."""

    order: Literal["fit", "error", "threshold", "gap", "given"] = (
        "fit"  #: how the number of sources is told; "error" to "given": by subspace
    )
    sources: int = 1  #: how many, for "given"
    threshold: float = 0.1  #: share of the largest eigenvalue's magnitude, for "threshold"
    significance: float = 0.001  #: for "fit" and "error": how improbable what is left must be for there to be one more
    most: int = 6  #: at most this many sources
    noise: Noise = "diagonal"  #: covariance of the noise: "equal", "diagonal", or "any", with which only cumulants are fitted
    mean: Mean = "unknown"  #: "zero" where samples are known to have none
    starts: int = 12  #: drawn starts beside those from the subspace and the pursuit
    seed: int = 0  #: of the drawn starts

    def __post_init__(self) -> None:
        if self.order not in ("fit", "error", "threshold", "gap", "given"):
            raise ValueError(f"order is {self.order!r}; 'fit', 'error', 'threshold', 'gap' or 'given' is needed")
        if self.noise not in ("equal", "diagonal", "any"):
            raise ValueError(f"noise is {self.noise!r}; 'equal', 'diagonal' or 'any' is needed")
        if not (1 <= self.most <= 8 and self.starts >= 0):
            raise ValueError(f"most is {self.most}, starts {self.starts}; 1 to 8 and at least 0 is needed")
        self._order()

    def directions(self, samples: Floats) -> Directions:
        """Frames (f, N, 4) → up to `most` directions each, the surest first."""
        return gathered([_told(one) for one in self.fits(samples)], self.most)

    def fits(self, samples: Floats) -> list[Fit | None]:
        """A fit a frame, with powers and cumulants of the sources; None where there is no source."""
        found = moments(samples, self.mean, error=True)
        return [self._of(found, k) for k in range(len(found.cumulant))]

    def _of(self, found: Moments, frame: int) -> Fit | None:
        shown = subspace(found, frame, True, self._order())
        if shown.m == 0:
            return None
        tops = peaks(shown, self.most).u
        first = self._fit(found, frame, shown.m, tops)
        if self.order != "fit" or explained(first) >= self.significance:
            return first
        for m in range(shown.m + 1, self.most + 1):
            fit = self._fit(found, frame, m, tops)
            if explained(fit) >= self.significance:
                return fit
        return first

    def _fit(self, found: Moments, frame: int, m: int, tops: Array) -> Fit:
        drawn = random_starts(self.starts, m, self.seed)
        pursuit = pursued(found, frame, self.noise, m)
        spare = random_starts(1, m, self.seed + 1)[0]
        informed = np.concatenate([tops[:m], spare[len(tops[:m]) :]])
        return fit_directions(found, frame, self.noise, np.concatenate([informed[None], pursuit[None], drawn]))

    def _order(self) -> Order:
        rule = "error" if self.order == "fit" else self.order
        return Order(rule, self.sources, self.threshold, self.significance, self.most)


def _told(fit: Fit | None) -> tuple[Array, Array, Array]:
    if fit is None:
        return np.zeros((0, 3)), np.zeros((0, 2, 2)), np.zeros(0)
    score = np.abs(fit.cumulant) / np.maximum(fit.deviation, np.finfo(float).tiny)
    order = np.argsort(-score, kind="stable")
    return fit.u[order], fit.R[order], score[order]
