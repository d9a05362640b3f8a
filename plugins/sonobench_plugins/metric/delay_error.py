"""Errors of the delays that a front end finds: of each pair's strongest row against the nearest true delay of a sounding source.

Source: Liang 2016, eq. 3-11 (the mean error) and 3-12 (the root of the mean square), whose names are swapped there; gross errors
as in Ianniello 1982, "Time delay estimation via cross-correlation in the presence of large estimation errors".
The strongest row is that of the highest score; where rows have no scores, each counts. A frame whose microphones were
searched and gave no row is missed: a gross error that weighs as much as any other, and in the root mean square one of the
widest pair's whole range. Frames without a sounding source count nowhere; those in which one sounds but the front end
searched nothing (voice activity) are counted as skipped, and nowhere else.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from sonobench.errors import InputError, SetupError
from sonobench.geometry import max_delay, sensor_delays
from sonobench.protocols import Series
from sonobench.types import Array, DelayTable, Floats, Scan, Setup, Truth


class _Seen(NamedTuple):
    """Of one pair in one frame: whether it was searched, error of the strongest row (NaN: no row), and peak over the highest sidelobe (NaN: no table)."""

    searched: bool
    error_s: float = math.nan
    ratio: float = math.nan


@dataclass(frozen=True)
class DelayError:
    """Root mean square error, bias, share of gross errors, errors of the others, missed and skipped frames, peak to sidelobe ratio."""

    reads: ClassVar[str] = "scans"
    gross_s: float = 2e-4  #: an error above is gross: another peak, not this one's error
    lobe_s: float = 5e-4  #: half the width of the peak that is no sidelobe

    def __post_init__(self) -> None:
        if not (0 < self.gross_s < math.inf and 0 < self.lobe_s < math.inf):
            raise InputError(f"delay-error: gross_s is {self.gross_s} and lobe_s {self.lobe_s}; above 0 is needed")

    def evaluate(self, truth: Truth, output: Sequence[Scan], space: Setup | None) -> Mapping[str, Series]:
        """Columns "" (rms, s), "bias", "gross", "inlier" and "mae" (rms and mean of what is not gross), "missed", "skipped", "sidelobe"."""
        told = [] if space is None else list(self._seen(truth, output, space))
        seen = [s for s in told if s.searched]
        error = np.array([s.error_s for s in seen])
        found = ~np.isnan(error)
        near = found & (np.abs(error) <= self.gross_s)
        every = np.ones(len(seen), bool)
        ratio = np.array([s.ratio for s in seen])
        widest_s = None if space is None else _widest(space)

        def series(values: Array, counts: Array, unit: str, pool: str, **more: object) -> Series:
            share = float(counts.mean()) if len(counts) else 0.0
            return Series(np.where(counts, values, 0.0), counts.astype(float), unit, pool=pool, coverage=share, **more)  # type: ignore[arg-type]

        return {
            "": series(np.where(found, error, widest_s or 0.0), every, "s", "rms", worst=widest_s),
            "bias": series(error, found, "s", "mean"),
            "gross": series((~near).astype(float), every, "1", "rate", worst=1.0),
            "inlier": series(error, near, "s", "rms"),
            "mae": series(np.abs(error), near, "s", "mean"),
            "missed": series((~found).astype(float), every, "1", "rate", worst=1.0),
            "skipped": series(np.array([not s.searched for s in told], float), np.ones(len(told), bool), "1", "rate", worst=1.0),
            "sidelobe": series(ratio, ~np.isnan(ratio), "1", "mean", better="higher"),
        }

    def _seen(self, truth: Truth, scans: Sequence[Scan], setup: Setup) -> Iterator[_Seen]:
        pairs = _pairs(setup)
        for scan in scans:
            points = _sounding(truth, scan.time_s)
            if not len(points):
                continue
            for q in pairs:
                if not scan.searched[q]:
                    yield _Seen(searched=False)
                    continue
                true = sensor_delays(points, setup, q)[:, 0]
                ratio = self._ratio(scan.fields.get("gcc"), q)
                for found_s in _reported(scan, q) or [math.nan]:
                    yield _Seen(True, _error(found_s, true), ratio)

    def _ratio(self, table: object, q: int) -> float:
        if not isinstance(table, DelayTable):
            return math.nan
        values = table.values[q].astype(float)
        top = int(values.argmax())
        lobe = math.ceil(self.lobe_s / table.step_s)
        beside = np.concatenate([values[: max(top - lobe, 0)], values[top + lobe + 1 :]])
        return float(values[top] / beside.max()) if len(beside) and beside.max() > 0 else math.nan


def _pairs(setup: Setup) -> list[int]:
    """The sensors that are one microphone pair; SetupError where there is none."""
    pairs = [q for q, unit in enumerate(setup.sensors) if unit.kind == "tdoa" and len(unit.space) == 1]
    if not pairs:
        raise SetupError(f"metric delay-error reads sensors of one microphone pair each; there are {[u.name for u in setup.sensors]}")
    return pairs


def _widest(setup: Setup) -> float:
    """The range of delays of the widest pair."""
    units = [setup.sensors[q] for q in _pairs(setup)]
    return 2 * max(float(max_delay(u.elements, u.pairs, setup.c_m_s).max()) for u in units)


def _sounding(truth: Truth, time_s: float) -> Array:
    """Places (n, 3) of the sources that sound at the truth's evaluation time nearest to `time_s`, moved on to it."""
    k = int(np.argmin(np.abs(truth.time_s - time_s)))
    if truth.valid is not None and not truth.valid[k]:
        return np.zeros((0, 3))
    who = np.flatnonzero(truth.active[k])
    track = truth.position[:, who]
    return (
        np.stack([[np.interp(time_s, truth.time_s, track[:, i, axis]) for axis in range(3)] for i in range(len(who))]).reshape(-1, 3)
        if len(who)
        else np.zeros((0, 3))
    )


def _reported(scan: Scan, q: int) -> list[float]:
    """The delay of a pair's row of the highest score; all of them where they have none."""
    for group in scan.detections:
        own = np.flatnonzero(group.sensor == q)
        if len(own):
            best = own if group.score is None else own[[np.argmax(group.score[own])]]
            return [float(z) for z in group.z[best, 0]]
    return []


def _error(found_s: float, true_s: Floats) -> float:
    """Signed distance to the nearest true delay."""
    off = found_s - true_s
    return float(off[np.argmin(np.abs(off))]) if math.isfinite(found_s) else math.nan
