"""The generalised cross-correlation of microphone pairs as evidence, at the delays that a talker would have: no peaks are picked.

    log ratio(x) = Σ over pairs and modes  w_l(x) log[(1 − p_l(x)) + p_l(x) G(u_l) / (1 − eps + eps G(u_l))],   u_l = gcc(h_l(x)) / s

h_l are the delays of a measurement model's modes (the direct one; echoes with `tdoa-images`) and p_l its probabilities of detection. G, s
and eps are calibrated on each scan's own table (`filtering.fields`), nothing is tuned to a scene. Each lag counts once: modes whose
delays lie within `resolution_s` share one weight, or a talker on the axis of symmetry, of whom several modes coincide, would have
the same peak counted several times.
Source: Liang 2016, eq. 5-35 (modes); the idea of evidence before detection: Ristic, Vo, Vo & Farina 2013, section V; bounded evidence of
a delay among false peaks: Ward, Lehmann & Williamson 2003, "Particle filtering algorithms for tracking an acoustic source".
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sonobench.errors import InputError, SetupError
from sonobench.filtering.fields import calibrated, log_shown, once
from sonobench.filtering.steps import pose_of
from sonobench.protocols import BoundMeasurement, Measurement
from sonobench.types import Array, DelayTable, Floats, Scan, Setup, Space
from sonobench_plugins.measurement.tdoa import Tdoa


@dataclass(frozen=True)
class TdoaField:
    """Delay tables at the delays of a measurement model."""

    measurement: Measurement = field(default_factory=lambda: Tdoa(sensor="pair"))  #: delays of single pairs, and how probably each shows
    table: str = "gcc"  #: name of the scans' field, a delay table
    resolution_s: float | None = None  #: delays closer than this show the same peak; None: one sample

    def __post_init__(self) -> None:
        if self.resolution_s is not None and not self.resolution_s > 0:
            raise ValueError(f"resolution_s is {self.resolution_s}; above 0 is needed")

    def bind(self, space: Space, setup: Setup) -> BoundTdoaField:
        """Bind the measurement.

        Raises:
            SetupError: it does not fit, reads sensors of several delays, or no resolution is known.
        """
        who = "likelihood tdoa-field"
        model = self.measurement.bind(space, setup)
        several = [setup.sensors[q].name for q in model.sensors if len(setup.sensors[q].space) != 1]
        if several:
            raise SetupError(f"{who} reads one delay a sensor; {several} measure several: set the measurement's `sensor` to single pairs")
        if self.resolution_s is None and not setup.rate_hz:
            raise SetupError(f"{who} takes one sample as resolution_s and the setup has no rate_hz; set resolution_s")
        resolution_s = self.resolution_s or 1.0 / float(setup.rate_hz or 1.0)
        return BoundTdoaField(model=model, setup=setup, table=self.table, resolution_s=resolution_s)


@dataclass(frozen=True, eq=False)
class BoundTdoaField:
    """`TdoaField` that knows its measurement."""

    model: BoundMeasurement
    setup: Setup
    table: str
    resolution_s: float

    @property
    def sensors(self) -> tuple[int, ...]:
        """Those of the measurement."""
        return self.model.sensors

    def log_ratio(self, x: Floats, scan: Scan) -> Array | None:
        """Sum over pairs and modes (n,); None without a table.

        Raises:
            InputError: the scan has rows of these sensors and no table of this name, or the field is no table.
        """
        table = scan.fields.get(self.table)
        if table is None:
            if any(np.isin(group.sensor, self.sensors).any() for group in scan.detections):
                raise InputError(
                    f"likelihood tdoa-field reads the field {self.table!r}; the scan at {scan.time_s} s has "
                    f"{sorted(scan.fields) or 'none'}: use a front end that offers it, such as gcc-peaks"
                )
            return None
        if not isinstance(table, DelayTable):
            raise InputError(f"likelihood tdoa-field reads delay tables; field {self.table!r} is a {type(table).__name__}")
        parts = [self._of(table, x, scan, q) for q in self.sensors]
        told = [p for p in parts if p is not None]
        return np.sum(told, axis=0) if told else None

    def _of(self, table: DelayTable, x: Floats, scan: Scan, q: int) -> Array | None:
        peaks = calibrated(table.values[q])
        if peaks is None:  # a pair that was not heard
            return None
        delays = self.model.h(x, q, pose_of(self.setup, scan, q))  # (n, L, 1)
        p = self.model.p_d(x, q, scan)
        end_s = table.start_s + table.step_s * (table.values.shape[1] - 1)
        used = (p > 0) & (delays[..., 0] >= table.start_s) & (delays[..., 0] <= end_s)
        values = table.at(delays, np.full(delays.shape[-2], q))
        shown = log_shown(values, np.where(used, p, 0.0), peaks)
        return np.asarray((once(delays[..., 0], used, self.resolution_s) * shown).sum(axis=-1))
