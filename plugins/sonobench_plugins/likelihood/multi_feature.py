"""Several features of sound as evidence for one talker: candidate delays of each pair, and the power of beams steered to a place.

Delays: a pair's candidates z_n say of a talker at x

    l(x) = floor + (1 − floor) Σ_n exp(−(z_n − h(x))² / 2 s²),

over the mean of the same for delays anywhere within the pair's aperture. `floor` is the share of frames in which no candidate is the
talker's; without it one false delay rules the truth out. Power: max(P(x), 0) over its mean over the tables, P being SRP (the mean of the
field "gcc" over pairs), SBF (the power of a delay-and-sum beam, from the field "energy") or µ SBF + (1 − µ) SRP.

`focused` first finds, pair by pair, the candidate that the predicted particles make likeliest, and keeps that one alone; and takes µ from
how far each power is from agreeing with the delays, µ = v_SRP² / (v_SBF² + v_SRP²).
Source: "Multi-feature adaptive unscented particle filter" (in Chinese; Chinese Journal of Scientific Instrument 43, 2022), eq. 9 to 14 and
22 to 30. Deviations: the N^D joint hypotheses of eq. 24 are independent by pair, so each pair is searched by itself; candidates are judged
by all particles, not by the predicted mean alone. No floor is printed (`floor = 0`). Eq. 12 to 14 at a single point cancel the delays, and
leave µ to the powers' levels (`mu_at = "point"`); by default v² is the mean over the cloud of (p − p_τ)², p and p_τ being P and P times the
delays' likelihood, each over its mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sonobench.errors import InputError, SetupError
from sonobench.filtering.evidence import rows_of, searched
from sonobench.filtering.steps import pose_of
from sonobench.geometry import lift
from sonobench.protocols import BoundMeasurement, Focused
from sonobench.signal import Steering, steering
from sonobench.types import Array, DelayTable, Floats, Scan, Setup, Space
from sonobench_plugins.measurement.tdoa import Tdoa

_TINY = 1e-300


@dataclass(frozen=True)
class MultiFeature:
    """Candidate delays and steered powers; reads single-pair "tdoa" sensors."""

    delays: Literal["selected", "all", "none"] = "all"  #: every candidate, one a pair once particles are known, or no delays
    power: Literal["fused", "srp", "sbf", "none"] = "srp"  #: steered power; "fused" and "sbf" need a front end with an "energy" field
    candidates: str = "pair"  #: what the names of the sensors begin with whose rows are candidates
    steered: str = ""  #: what those begin with whose tables are summed; "" is all
    spread_m: float = 0.0316  #: deviation of a delay from the talker's, times the speed of sound
    floor: float = 0.1  #: share of frames in which a pair's candidates are all false
    least_power: float = 1.0  #: power counts as at least this share of the mean over the tables
    sharpness: float = 1.0  #: exponent of the power
    mu: float | None = None  #: share of SBF in "fused"; None: from how far each agrees with the delays
    mu_at: Literal["cloud", "point"] = "cloud"  #: where that is asked; "point", the cloud's mean, is the printed form
    height_m: float | None = None  #: height of planar states; None: the recording's nominal height_m, else 0

    def __post_init__(self) -> None:
        if (
            self.delays not in ("selected", "all", "none")
            or self.power not in ("fused", "srp", "sbf", "none")
            or self.mu_at not in ("cloud", "point")
        ):
            raise ValueError(
                f"delays is {self.delays!r}, power {self.power!r}, mu_at {self.mu_at!r}; 'selected', 'all' or 'none', 'fused', 'srp', 'sbf' or "
                "'none', and 'cloud' or 'point' are needed"
            )
        if self.delays == "none" and self.power == "none":
            raise ValueError("delays and power are both 'none'; one feature at least is needed")
        if not (0 <= self.floor < 1 and self.least_power > 0 and self.spread_m > 0 and self.sharpness >= 0):
            raise ValueError(
                f"floor is {self.floor}, least_power {self.least_power}, spread_m {self.spread_m}, sharpness {self.sharpness}; "
                "a floor in [0, 1), least_power and spread_m above 0 and sharpness of at least 0 are needed"
            )
        if self.mu is not None and not 0 <= self.mu <= 1:
            raise ValueError(f"mu is {self.mu}; 0 to 1, or none, is needed")

    def bind(self, space: Space, setup: Setup) -> BoundMultiFeature:
        """Look up sensors and places.

        Raises:
            SetupError: no sensors of single pairs of these names, or states without positions.
        """
        who = "likelihood multi-feature"
        delays = Tdoa(self.candidates, self.spread_m / setup.c_m_s, 1.0 - self.floor, 1.0, self.height_m).bind(space, setup)
        summed = setup.of_kind("tdoa", who, self.steered)
        several = [setup.sensors[q].name for q in (*delays.sensors, *summed) if len(setup.sensors[q].space) != 1]
        if several:
            raise SetupError(f"{who} reads one delay a sensor; {sorted(set(several))} measure several: set `candidates` and `steered`")
        axes = [n for n in ("x_m", "y_m", "z_m") if n in space.names]
        height_m = setup.nominal.get("height_m", 0.0) if self.height_m is None else self.height_m
        apertures_m = {q: _aperture_m(setup, q) for q in delays.sensors}
        return BoundMultiFeature(self, delays, steering(setup, summed), tuple(space.index(*axes)), height_m, setup, apertures_m)


def _aperture_m(setup: Setup, q: int) -> float:
    unit = setup.sensors[q]
    return float(np.linalg.norm(np.subtract(*unit.elements[unit.pairs[0]])))


@dataclass(frozen=True, eq=False)
class BoundMultiFeature:
    """`MultiFeature` that knows its sensors."""

    own: MultiFeature
    delays: BoundMeasurement
    steering: Steering
    columns: tuple[int, ...]
    height_m: float
    setup: Setup
    apertures_m: dict[int, float]

    @property
    def sensors(self) -> tuple[int, ...]:
        """Those of the delays and those of the tables."""
        more = self.steering.sensors.tolist() if self.own.power != "none" else []
        return tuple(sorted({*(self.delays.sensors if self.own.delays != "none" else ()), *more}))

    def log_ratio(self, x: Floats, scan: Scan) -> Array | None:
        """Log ratio (n,) with every candidate, and µ = 1/2 where it is not set; None of a scan that searched nothing.

        Raises:
            InputError: the scan lacks a field.
        """
        if not scan.searched[list(self.sensors)].any():
            return None
        return self._delays(x, scan, self._rows(scan)) + self._log_power(x, scan, 0.5 if self.own.mu is None else self.own.mu)

    def focused(self, x: Floats, w: Floats, scan: Scan) -> Focused | None:
        """The same with µ found and, if `delays` is "selected", one candidate a pair; rows: those that are likelier the talker's than false."""
        if not scan.searched[list(self.sensors)].any():
            return None
        rows, chosen, trusted = self._rows(scan), {}, []
        for q, z in rows.items():
            shown = np.asarray(w) @ self._shown(x, q, z, scan)  # (m,)
            best = int(np.argmax(shown))
            chosen[q] = z[best : best + 1]
            if (1 - self.own.floor) * shown[best] > self.own.floor * self._chance(q, len(z)):
                trusted.append((q, z[best], self.delays.R(q)))
        weighed = chosen if self.own.delays == "selected" else rows
        mu = self._mu(x, w, scan, weighed)
        return Focused(lambda at: self._delays(at, scan, weighed) + self._log_power(at, scan, mu), self.delays, tuple(trusted))

    def _rows(self, scan: Scan) -> dict[int, Array]:
        """Candidates (m, 1) by sensor; sensors without any are left out, they say nothing."""
        if self.own.delays == "none":
            return {}
        found = {q: rows_of(scan, q, 1).z for q in searched(scan, self.delays.sensors)}
        return {q: z for q, z in found.items() if len(z)}

    def _shown(self, x: Floats, q: int, z: Array, scan: Scan) -> Array:
        """exp(−(z − h)² / 2 s²) (n, m)."""
        h = self.delays.h(x, q, pose_of(self.setup, scan, q))[:, 0]  # (n, 1)
        return np.asarray(np.exp(-0.5 * ((z[:, 0] - h) / (self.own.spread_m / self.setup.c_m_s)) ** 2))

    def _delays(self, x: Floats, scan: Scan, rows: dict[int, Array]) -> Array:
        """Sum over pairs of log l(x) over its mean (n,)."""
        total, floor = np.zeros(len(x)), self.own.floor
        for q, z in rows.items():
            with np.errstate(divide="ignore"):
                total += np.log(floor + (1 - floor) * self._shown(x, q, z, scan).sum(axis=1)) - np.log(
                    floor + (1 - floor) * self._chance(q, len(z))
                )
        return total

    def _chance(self, q: int, m: int) -> float:
        """Mean of Σ_n exp(−(z_n − h)² / 2 s²) over delays h anywhere within a pair's aperture, of m candidates."""
        return min(float(m * np.sqrt(2 * np.pi) * self.own.spread_m / max(2 * self.apertures_m[q], _TINY)), 1.0)

    def _log_power(self, x: Floats, scan: Scan, mu: float) -> Array:
        power = self.own.power
        if power == "none":
            return np.zeros(len(x))
        shares = {"srp": (0.0, 1.0), "sbf": (1.0, 0.0), "fused": (mu, 1.0 - mu)}[power]
        at, mean = np.zeros(len(x)), 0.0
        for share, name in zip(shares, ("sbf", "srp"), strict=True):
            if share > 0:
                if self._table(scan, name) is None:
                    return np.zeros(len(x))
                one, chance = self._power(x, scan, name)
                at, mean = at + share * one, mean + share * chance
        return np.asarray(self.own.sharpness * np.log(np.maximum(at / max(mean, _TINY), self.own.least_power)))

    def _power(self, x: Floats, scan: Scan, name: str) -> tuple[Array, float]:
        """Steered power (n,), 1 of a coherent source where all microphones agree, and its mean over the tables."""
        table = self._table(scan, name)
        if table is None:
            return np.ones(len(x)), 1.0
        plan = self.steering if scan.pose is None else steering(self.setup, self.steering.sensors.tolist(), scan)
        sums = plan.sums(table, lift(np.asarray(x)[:, list(self.columns)], self.height_m))
        heard, m = max(int(scan.searched[plan.sensors].sum()), 1), len(plan.elements)
        level = float(np.maximum(table.values[plan.sensors], 0.0).mean(axis=1).sum())
        if name == "srp":
            return np.maximum(sums, 0.0) / heard, level / heard
        return np.maximum(m + 2 * sums, 0.0) / (m + 2 * heard), (m + 2 * level) / (m + 2 * heard)

    def _table(self, scan: Scan, power: str) -> DelayTable | None:
        """The tables of a power; None of a scan that says nothing at all.

        Raises:
            InputError: the front end offers rows, and not these tables.
        """
        name = "energy" if power == "sbf" else "gcc"
        table = scan.fields.get(name)
        if isinstance(table, DelayTable):
            return table
        if not scan.fields and not any(np.isin(group.sensor, self.sensors).any() for group in scan.detections):
            return None
        hint = ' with energy = "cc"' if name == "energy" else ""
        raise InputError(
            f"likelihood multi-feature with power = {self.own.power!r} reads the delay tables {name!r}; the scan at {scan.time_s} s has "
            f"{sorted(scan.fields) or 'none'}: use a front end that offers them, such as gcc-peaks{hint}"
        )

    def _mu(self, x: Floats, w: Floats, scan: Scan, rows: dict[int, Array]) -> float:
        """Share of SBF by eq. 14."""
        if self.own.mu is not None or self.own.power != "fused":
            return 0.5 if self.own.mu is None else self.own.mu
        x, w = np.asarray(x), np.asarray(w)
        if self.own.mu_at == "point":  # P − P l(x) = P (1 − l(x)): the delays cancel from the ratio
            sbf, srp = (float(self._power((w @ x)[None], scan, name)[0][0]) ** 2 for name in ("sbf", "srp"))
        else:
            log_l = self._delays(x, scan, rows)
            likely = np.exp(log_l - log_l.max()) if np.isfinite(log_l.max()) else np.ones(len(x))
            sbf, srp = (_disagreement(self._power(x, scan, name)[0], likely, w) for name in ("sbf", "srp"))
        return srp / (sbf + srp) if sbf + srp > 0 else 0.5


def _disagreement(power: Array, likely: Array, w: Floats) -> float:
    """v² of a power (n,): how far multiplying it by the delays' likelihood changes its shape over the cloud."""
    both = power * likely
    p, p_tau = power / max(float(w @ power), _TINY), both / max(float(w @ both), _TINY)
    return float(w @ (p - p_tau) ** 2)
