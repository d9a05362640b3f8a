"""How near the error of directions comes to the Cramér-Rao bound of one frame: their ratio, and the bound itself.

The bound is that of an unbiased estimator that looks at the snapshots of one frame and at nothing else; a tracker may pass below it
(`direction-posterior-bound` is its own). It is worked out from the scene's powers, which the truth's parameters name:
source_variance (source_variance_LABEL of one target, where they differ), pressure_noise_variance, velocity_noise_variance
(…_x, …_y, …_z along the array's axes), noise_correlation_px, …_py, …_pz, …_xy, …_xz, …_yz, and snapshots a frame.
Each of several targets counts as if it were alone, which bounds it from below all the same.
Source: Nehorai & Paldi 1994, section III; see `sonobench.filtering.bounds`.
Deviations: Hu, Li & Jin 2014 print the bound of the MSAE; here it is compared as a root mean square, in rad and in degrees.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sonobench.directions import axes, looks, origin
from sonobench.errors import SetupError
from sonobench.filtering.bounds import Signal, Unknown, direction_information
from sonobench.geometry import angles
from sonobench.protocols import Series
from sonobench.sphere import tangents
from sonobench.types import Array, Estimate, Space, Truth
from sonobench_plugins.metric.direction_error import DirectionError


@dataclass(frozen=True)
class DirectionBound:
    """Root mean square of error over bound, frame by frame; 1 is as good as one frame allows, below 1 takes memory."""

    error: DirectionError = field(default_factory=DirectionError)  #: gate, window and targets of the error that is compared
    signal: Signal = "gaussian"  #: what the source is taken for: "gaussian", or "deterministic", samples each of its own
    unknown: Unknown = "known"  #: whether the estimator knows the noise: "known", or "diagonal", four variances to be found

    def evaluate(self, truth: Truth, output: Sequence[Estimate], space: Space | None) -> Mapping[str, Series]:
        """Columns "" (error over bound), "bound", "azimuth" and "elevation" (rad), and "deg" (the bound in degrees)."""
        return compared(self.error, truth, output, space, np.asarray(np.linalg.inv(self.information(truth)), float))

    def information(self, truth: Truth) -> Array:
        """Information (k, n, 2, 2) of a frame about each target's direction."""
        p, turn = powers(truth), axes(truth)
        source = np.array([p.get(f"source_variance_{label}", p["source_variance"]) for label in truth.label])
        z = np.asarray(angles((truth.position - origin(truth)) @ turn))
        inside = direction_information(z, source, noise_covariance(p), p["snapshots"], self.signal, self.unknown)
        T = tangents(angles(truth.position - origin(truth))) @ turn @ np.swapaxes(tangents(z), -1, -2)
        return np.asarray(T @ inside @ np.swapaxes(T, -1, -2))


def powers(truth: Truth) -> Mapping[str, float]:
    """The truth's parameters, with all that a bound takes.

    Raises:
        SetupError: one is missing.
    """
    p = dict(truth.parameters)
    for axis in "xyz":
        p.setdefault(f"velocity_noise_variance_{axis}", p.get("velocity_noise_variance", -1.0))
    needed = ["source_variance", "pressure_noise_variance", *(f"velocity_noise_variance_{a}" for a in "xyz"), "snapshots"]
    missing = [n for n in needed if not p.get(n, -1.0) > 0]
    if missing:
        raise SetupError(
            f"a bound on directions takes the scene's {', '.join(missing)}, above 0; the truth's parameters are {sorted(truth.parameters)}: "
            "render the scene with a simulator of vector sensors"
        )
    return p


def noise_covariance(p: Mapping[str, float]) -> Array:
    """Noise (4, 4) of the pressure and of the scaled velocities, in the array's axes."""
    std = np.sqrt([p["pressure_noise_variance"], *(p[f"velocity_noise_variance_{a}"] for a in "xyz")])
    correlation = np.eye(4)
    for i, j in zip(*np.triu_indices(4, 1), strict=True):
        correlation[i, j] = correlation[j, i] = p.get(f"noise_correlation_{'pxyz'[i]}{'pxyz'[j]}", 0.0)
    return std[:, None] * correlation * std


def compared(error: DirectionError, truth: Truth, output: Sequence[Estimate], space: Space | None, least: Array) -> Mapping[str, Series]:
    """Columns of the error against the least covariances (k, n, 2, 2) that each target's direction can have."""
    seen = looks(truth, output, space, error.hold_s, error.targets)
    errors = error.errors(seen)
    valid = np.ones(len(truth.time_s), bool) if truth.valid is None else truth.valid
    there = (truth.exists if error.targets == "exists" else truth.active)[valid] & (errors.counted > 0)[:, None]
    cosine = np.cos(np.asarray(angles(truth.position - origin(truth)))[valid][..., 1])
    east, north = least[valid][..., 0, 0], least[valid][..., 1, 1]
    squares = {"bound": east + north, "azimuth": east / np.maximum(cosine, 1e-9) ** 2, "elevation": north}
    number = np.maximum(there.sum(axis=1), 1)
    bound = {name: np.sqrt(np.where(there, s, 0.0).sum(axis=1) / number) for name, s in squares.items()}
    counted, matched = there.any(axis=1).astype(float), (errors.matched > 0).astype(float)
    ratio = np.divide(np.sqrt(errors.squares[:, 0]), bound["bound"], out=np.zeros(len(number)), where=bound["bound"] > 0)
    share = float(errors.matched.sum() / errors.counted.sum()) if errors.counted.sum() > 0 else 0.0
    columns = {"": Series(ratio, matched, "1", pool="rms", coverage=share)}
    columns |= {name: Series(values, counted, "rad", pool="frame-rms") for name, values in bound.items()}
    columns["deg"] = Series(np.degrees(bound["bound"]), counted, "°", pool="frame-rms")
    return columns
