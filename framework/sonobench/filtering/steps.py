"""What every tracker checks at init and works out before a step."""

from __future__ import annotations

from typing import Literal

from sonobench.errors import InputError, SetupError
from sonobench.filtering.mixture import empty
from sonobench.protocols import Birth, BoundMeasurement, Measurement, Mixture, Motion, State
from sonobench.types import Array, Scan, Setup

Update = Literal["iterated", "stacked"]
JointUpdate = Literal["iterated", "stacked", "joint"]


def bound(
    motion: Motion,
    measurement: Measurement,
    setup: Setup,
    update: JointUpdate,
    who: str,
    *,
    several: bool = False,
    modes: bool = False,
    adaptive: bool = False,
) -> BoundMeasurement:
    """The measurement model on this setup, for a tracker of one motion mode, unless `modes`, that does not adapt, unless `adaptive`,
    and one detection a target and sensor, unless `several`.

    Raises:
        SetupError: the models do not fit each other, the setup or the tracker; names both sides.
    """
    if motion.n_modes != 1 and not modes:
        raise SetupError(f"{who} tracks one motion mode; motion {type(motion).__name__} has {motion.n_modes}")
    if not adaptive:
        refuse_adaptive(motion, who)
    model = measurement.bind(motion.space, setup)
    if model.n_modes != 1 and not several:
        raise SetupError(
            f"{who} takes one detection a target and sensor; measurement {type(measurement).__name__} predicts up to {model.n_modes}"
        )
    if update == "stacked" and len(model.sensors) != 1:
        names = [setup.sensors[q].name for q in model.sensors]
        raise SetupError(
            f'{who} with update = "stacked" reads one sensor, measurement {type(measurement).__name__} reads {len(names)}: {names}; '
            'name one stack in the measurement\'s `sensor`, or use update = "iterated"'
        )
    return model


def adapts(motion: Motion) -> bool:
    """Whether updates change the motion (`adapt` in the protocol)."""
    return hasattr(motion, "adapt") and bool(getattr(motion, "adaptive", True))


def refuse_adaptive(motion: Motion, who: str) -> None:
    """For trackers that hold no target's own motion.

    Raises:
        SetupError: the motion would stay as it is at its start.
    """
    if adapts(motion):
        raise SetupError(
            f"{who} does not carry what motion {type(motion).__name__} learns from updates, so that it would never adapt: use a motion that does "
            "not, such as constant-velocity, or a tracker of one target that adapts it (particle-filter, gaussian-filter)"
        )


def initial(birth: Birth, memory: State, d: int) -> Mixture:
    """Components that exist at the setup's start, before the first scan, which the first step predicts; most births know of none."""
    known = getattr(birth, "initial", None)
    return empty(d) if known is None else known(memory)


def elapsed(time_s: float, scan: Scan) -> float:
    """Time from the state to the scan.

    Raises:
        InputError: the scan is older than the state.
    """
    dt_s = scan.time_s - time_s
    if dt_s < 0:
        raise InputError(f"a scan at {scan.time_s} s came after the state had reached {time_s} s; scans must come in time order")
    return dt_s


def survival(p_s: float, dt_s: float, period_s: float | None) -> float:
    """Probability of surviving dt_s, `p_s` being that of one period; `p_s` itself where scans have no period."""
    return p_s if period_s is None else float(p_s ** (dt_s / period_s))


def pose_of(setup: Setup, scan: Scan, sensor: int) -> Array | None:
    """The pose that overrides the setup's for this scan, None where arrays stand still."""
    return None if scan.pose is None else setup.pose(setup.sensors[sensor], scan)
