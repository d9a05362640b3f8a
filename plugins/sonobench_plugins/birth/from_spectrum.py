"""Births where a spectrum over directions has a peak in two frames running and nobody is known.

A peak is born when one of the frame before lies within `gate_deg` of it and no live target within `taken_deg`, as wide as it is and with
rates around none. The probability of birth is `acceptance` times the peak's height, as a share of the highest.
Source: Zhang et al., "Cum-AMMS-GLMB", eq. 16 and the acceptance coefficient .3.
Deviations: the paper leaves out nobody who is there already, and uses the scan that proposes a target to confirm it too; here births
join after the update (`uses_scan`). Peaks of several sensors are looked at one after the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sonobench.errors import InputError, SetupError
from sonobench.filtering.mixture import empty, take
from sonobench.protocols import BoundMeasurement, Mixture, State
from sonobench.signal.sphere_peaks import FieldPeaks, field_peaks
from sonobench.sphere import apart, in_angles
from sonobench.types import Array, Scan, Setup, Space

_ANGLES = ("azimuth_rad", "elevation_rad")


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The space, the sensors, and the peaks of each in the last scan that had a spectrum."""

    space: Space
    sensors: tuple[int, ...]
    peaks: tuple[FieldPeaks, ...] = ()


@dataclass(frozen=True)
class FromSpectrum:
    """Births from persistent peaks; memory is the last scan's."""

    field: str = "spectrum"  #: name of the scans' field
    threshold: float = 0.1  #: peaks reach this share of the highest
    most: int = 8  #: peaks looked at in a scan
    acceptance: float = 0.3  #: probability of birth of the highest peak
    gate_deg: float = 8.0  #: a peak has persisted where the last scan has one within this
    taken_deg: float = 12.0  #: no birth this near to a live target
    taken_existence: float = 0.1  #: targets that exist more probably are live
    rate_std_deg_s: float = 1.0  #: spread of each rate
    acceleration_std_deg_s2: float = 0.05  #: spread of each acceleration, where states have some

    def __post_init__(self) -> None:
        if not (0 < self.threshold <= 1 and self.most >= 1 and 0 <= self.acceptance <= 1):
            raise ValueError("threshold and acceptance must lie between 0 and 1, most be at least 1")
        if min(self.gate_deg, self.taken_deg, self.rate_std_deg_s, self.acceleration_std_deg_s2, self.taken_existence) < 0:
            raise ValueError("gates, spreads and taken_existence must be at least 0")

    @property
    def uses_scan(self) -> bool:
        """From the scan's own field."""
        return True

    def start(self, space: Space, setup: Setup, measurement: BoundMeasurement) -> State:
        """No peaks yet.

        Raises:
            SetupError: states without azimuth and elevation, or sensors that do not measure directions.
        """
        who = "birth from-spectrum"
        space.index(*_ANGLES)
        others = [setup.sensors[q] for q in measurement.sensors if setup.sensors[q].kind != "direction"]
        if others:
            raise SetupError(
                f"{who} reads sensors of kind 'direction'; the tracker reads {[f'{s.name} ({s.kind})' for s in others]}: use another birth"
            )
        return Seen(space, tuple(measurement.sensors))

    def propose(self, rng: np.random.Generator, memory: State, scan: Scan, live: Mixture) -> tuple[State, Mixture]:
        """A component at each persistent peak where nobody is; a scan without fields leaves the memory as it is.

        Raises:
            InputError: the scan has other fields than this one.
        """
        seen: Seen = memory
        spectrum = scan.fields.get(self.field)
        if spectrum is None and scan.fields:
            raise InputError(f"birth from-spectrum reads the field {self.field!r}; the scan at {scan.time_s} s has {sorted(scan.fields)}")
        if spectrum is None:
            return memory, empty(len(seen.space))
        now = tuple(field_peaks(spectrum, q, self.threshold, self.most) for q in seen.sensors)
        taken = take(live, live.w > self.taken_existence).m[:, seen.space.index(*_ANGLES)]
        w, z, R = [], [], []
        for before, peaks in zip(seen.peaks, now, strict=False):
            for k, at in enumerate(peaks.z):
                if _within(at, before.z, self.gate_deg) and not _within(at, taken, self.taken_deg):
                    w.append(self.acceptance * peaks.height[k] / peaks.height[0])
                    z.append(at)
                    R.append(in_angles(peaks.R[k], at))
                    taken = np.concatenate([taken, at[None]])
        return replace(seen, peaks=now), self._mixture(seen.space, np.array(w), np.array(z).reshape(-1, 2), np.array(R).reshape(-1, 2, 2))

    def _mixture(self, space: Space, w: Array, z: Array, R: Array) -> Mixture:
        J, columns = len(w), space.index(*_ANGLES)
        std = {"s": self.rate_std_deg_s, "s2": self.acceleration_std_deg_s2}
        variance = [math.radians(std.get(n.rsplit("_", 1)[1], 0.0)) ** 2 for n in space.names]
        m, P = np.zeros((J, len(space))), np.tile(np.diag(variance), (J, 1, 1))
        m[:, columns] = z
        P[:, np.array(columns)[:, None], columns] = R
        return Mixture(w, m, P, np.zeros(J, np.int64))


def _within(z: Array, others: Array, gate_deg: float) -> bool:
    return len(others) > 0 and bool(np.linalg.norm(apart(others, z), axis=-1).min() <= math.radians(gate_deg))
