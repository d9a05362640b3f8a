"""Sources per steradian from a generalised-least-squares fit of all directions: the spectrum of the subspace that the fitted sources span.

As the cumulant spectrum, with sharper peaks: each is as wide as the fit's own error says (`sonobench.signal.direction_fit`).
Not in Zhang et al. (Cum-AMMS-GLMB): a stronger front end beside the paper's spectrum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sonobench.signal.direction_fit import fitted_spectrum
from sonobench.signal.subspace import Subspace, spectrum
from sonobench.types import DirectionSpectrum, Floats
from sonobench_plugins.direction.gls import Gls


@dataclass(frozen=True)
class GlsSpectrum:
    """Spectrum of fitted directions."""

    fit: Gls = field(default_factory=Gls)  #: the fit
    width_rad: float = 0.017453  #: no peak is narrower: motion within a frame, errors of the sensor

    def __post_init__(self) -> None:
        if self.fit.most > 6 or not self.width_rad > 0:
            raise ValueError(f"fit.most is {self.fit.most}, width_rad {self.width_rad}; at most 6 and above 0 is needed")

    def fields(self, samples: Floats) -> Sequence[DirectionSpectrum]:
        """A spectrum a frame."""
        nobody = Subspace(np.eye(10), np.zeros((10, 10)), 0, np.zeros(9))
        return [spectrum(nobody, self.width_rad) if one is None else fitted_spectrum(one, self.width_rad) for one in self.fit.fits(samples)]
