"""The sources per steradian that a vector sensor's spectrum shows as evidence for a target in a direction: no peaks are picked.

    log ratio(x) = Σ over sensors log[(1 − p_D) + p_D rho(x) / kappa],      kappa = clutter_per_scan / 4π

A spectrum of m sources, rho, stands for m detections whose places are known up to a density, among clutter that is uniform over the sphere: a
target either does not show (1 − p_D), or is one of those. As the spectrum integrates to the number of sources, a peak raises the
existence of who is there and a plain lowers it; where nothing was found a target has the ratio 1 − p_D, as in a missed scan.
Source: the detection-type likelihood ratio of Bernoulli filters (Ristic, Vo, Vo & Farina 2013, eq. 27), for the spectrum of
Schmidt 1986; Zhang et al. (Cum-AMMS-GLMB), section 2.1.2, which uses the spectrum as it is.
Deviations: the paper's spectrum is scaled to at most 1, which can never raise a probability of existence; this one is calibrated.
States hold azimuth and elevation in the array's frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sonobench.errors import InputError, SetupError
from sonobench.types import Array, DirectionSpectrum, Floats, Ints, Scan, Setup, Space


@dataclass(frozen=True)
class SpectrumLikelihood:
    """Direction spectra at the directions of states."""

    field: str = "spectrum"  #: name of the scans' field, a direction spectrum
    sensor: str = ""  #: of the sensors of kind "direction", those whose name starts so
    p_d: float | None = None  #: probability that a target is among the sources found; None: nominal
    clutter_per_scan: float | None = None  #: mean number of sources that are no targets; None: nominal

    def __post_init__(self) -> None:
        if self.p_d is not None and not 0 < self.p_d < 1:
            raise ValueError(f"p_d is {self.p_d}; between 0 and 1 is needed")
        if self.clutter_per_scan is not None and not self.clutter_per_scan > 0:
            raise ValueError(f"clutter_per_scan is {self.clutter_per_scan}; above 0 is needed: nothing bounds the evidence otherwise")

    def bind(self, space: Space, setup: Setup) -> BoundSpectrumLikelihood:
        """Look up columns, sensors and nominal values.

        Raises:
            SetupError: states without directions, no such sensor, or a missing nominal value.
        """
        who = "likelihood direction-spectrum"
        sensors = tuple(setup.of_kind("direction", who, self.sensor))
        turned = [setup.sensors[q].name for q in sensors if not np.allclose(setup.pose(setup.sensors[q])[:3, :3], np.eye(3))]
        if turned:
            raise SetupError(
                f"{who} takes states for directions in the array's frame; sensors {turned} are turned against the room: use detections with "
                "the measurement 'direction', which turns them"
            )
        p_d = setup.value("p_d", self.p_d, who)
        clutter = setup.value("clutter_per_scan", self.clutter_per_scan, who)
        columns = tuple(space.index("azimuth_rad", "elevation_rad"))
        return BoundSpectrumLikelihood(
            field=self.field,
            sensors=sensors,
            columns=columns,
            p_d=min(max(p_d, 1e-6), 1 - 1e-6),
            kappa=max(clutter, 1e-6) / (4 * math.pi),
        )


@dataclass(frozen=True, eq=False)
class BoundSpectrumLikelihood:
    """`SpectrumLikelihood` that knows columns and numbers."""

    field: str
    sensors: tuple[int, ...]
    columns: tuple[int, ...]
    p_d: float
    kappa: float

    def log_ratio(self, x: Floats, scan: Scan) -> Array | None:
        """Sum over sensors (n,); None without a spectrum, or where no sensor was heard.

        Raises:
            InputError: the scan has rows of these sensors, or other fields, and no spectrum of this name, or the field is none.
        """
        spectrum = scan.fields.get(self.field)
        if spectrum is None:
            if scan.fields or any(np.isin(group.sensor, self.sensors).any() for group in scan.detections):
                raise InputError(
                    f"likelihood direction-spectrum reads the field {self.field!r}; the scan at {scan.time_s} s has "
                    f"{sorted(scan.fields) or 'none'}: give the front end avs a `spectrum`, whose field is 'spectrum'"
                )
            return None
        if not isinstance(spectrum, DirectionSpectrum):
            raise InputError(f"likelihood direction-spectrum reads direction spectra; field {self.field!r} is a {type(spectrum).__name__}")
        heard: Ints = np.array([q for q in self.sensors if q < len(spectrum.heard) and spectrum.heard[q]], np.int64)
        if not len(heard):
            return None
        z = np.asarray(x)[..., list(self.columns)]
        rho = spectrum.at(np.broadcast_to(z[..., None, :], (*z.shape[:-1], len(heard), 2)), heard)
        return np.asarray(np.log((1.0 - self.p_d) + self.p_d / self.kappa * rho).sum(axis=-1))
