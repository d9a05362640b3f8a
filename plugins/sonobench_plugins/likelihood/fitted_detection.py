"""A likelihood of spectra times a probability of detection that is fitted to each spectrum: Gaussians around its peaks.

    log ratio(x) = inner(x) + Σ over sensors log max(floor, min(1, Σ_i A_i exp(−½ |x − z_i|² in R_i)))

with places z_i, heights A_i as shares of the highest and widths R_i of the peaks that reach `threshold`. Between peaks it takes evidence
away that the inner likelihood left there; at the highest it changes nothing.
Source: Zhang et al., "Cum-AMMS-GLMB", eq. 17.
Deviations: `floor` keeps a target alive whose peak is missing in a frame, which the paper's p_D of 0 would end. With a calibrated inner
likelihood (`direction-spectrum`), which has a probability of detection of its own, the spectrum counts twice; that is the paper's way.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sonobench.protocols import BoundLikelihood, Likelihood
from sonobench.signal.sphere_peaks import field_peaks
from sonobench.sphere import apart
from sonobench.types import Array, DirectionSpectrum, Floats, Scan, Setup, Space
from sonobench_plugins.likelihood.direction_spectrum import SpectrumLikelihood


@dataclass(frozen=True)
class FittedDetection:
    """Detection where the spectrum has peaks, on top of another likelihood."""

    likelihood: Likelihood = field(default_factory=SpectrumLikelihood)  #: what is multiplied
    field: str = "spectrum"  #: name of the scans' field that is fitted
    threshold: float = 0.05  #: peaks reach this share of the highest
    most: int = 8  #: peaks that are fitted
    floor: float = 0.1  #: least probability of detection

    def __post_init__(self) -> None:
        if not (0 < self.threshold <= 1 and self.most >= 1 and 0 < self.floor <= 1):
            raise ValueError("threshold and floor must lie above 0 and at most at 1, most be at least 1")

    def bind(self, space: Space, setup: Setup) -> BoundFittedDetection:
        """Bind the inner likelihood.

        Raises:
            SetupError: it does not fit, or states hold no directions.
        """
        inner = self.likelihood.bind(space, setup)
        return BoundFittedDetection(self, inner, tuple(space.index("azimuth_rad", "elevation_rad")))


@dataclass(frozen=True, eq=False)
class BoundFittedDetection:
    """`FittedDetection` that knows its inner likelihood."""

    fit: FittedDetection
    inner: BoundLikelihood
    columns: tuple[int, ...]

    @property
    def sensors(self) -> tuple[int, ...]:
        """Those of the inner likelihood."""
        return self.inner.sensors

    def log_ratio(self, x: Floats, scan: Scan) -> Array | None:
        """(n,); None where the inner likelihood says nothing."""
        found = self.inner.log_ratio(x, scan)
        spectrum = scan.fields.get(self.fit.field)
        if found is None or spectrum is None:
            return found
        z = np.asarray(x)[..., list(self.columns)]
        for q in self.sensors:
            if not isinstance(spectrum, DirectionSpectrum) or spectrum.heard[q]:
                peaks = field_peaks(spectrum, q, self.fit.threshold, self.fit.most)
                off = apart(z[:, None, :], peaks.z)
                square = np.einsum("nki,kij,nkj->nk", off, np.linalg.inv(peaks.R), off)
                share = peaks.height / max(peaks.height.max(initial=0.0), np.finfo(float).tiny)
                found = found + np.log(np.clip(np.exp(-0.5 * square) @ share, self.fit.floor, 1.0))
        return found
