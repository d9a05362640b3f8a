"""A front end and a tracker on a recording: the pure function that every trial is."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sonobench.errors import SetupError, SonobenchError
from sonobench.protocols import FrontEnd, Tracker
from sonobench.types import Estimate, Scan, Setup, Space

if TYPE_CHECKING:
    from sonobench.log import Recording


class InvalidOutput(SonobenchError):
    """A component that returned what its role forbids; the message names component, scan and fault."""


@dataclass(frozen=True)
class Pipeline:
    """One fully parametrised entry of a board; without a tracker it ends at its scans."""

    front_end: FrontEnd
    tracker: Tracker | None = None
    given: tuple[str, ...] = ()  #: names of what the scene hands out that this pipeline asks for; its board rows are marked


def scans_of(front_end: FrontEnd, recording: Recording, given: Iterable[str] = ()) -> tuple[Setup, list[Scan]]:
    """Run a front end over a whole recording.

    Raises:
        SetupError: the recording lacks what the front end reads.
        InvalidOutput: a scan that does not fit the setup, or is out of order.
    """
    setup, state = front_end.open(recording.header.offering(given))
    scans: list[Scan] = []
    consumes = getattr(front_end, "consumes", "samples")
    for item in recording.scans() if consumes == "scans" else recording.blocks():
        state, ready = front_end.step(state, item)
        scans += ready
    scans += front_end.flush(state)
    _check_scans(front_end, setup, scans)
    return setup, scans


def track(tracker: Tracker, setup: Setup, scans: Sequence[Scan], rng: np.random.Generator) -> list[Estimate]:
    """Run a tracker over scans; one estimate a scan.

    Raises:
        SetupError: the setup lacks what the tracker needs.
        InvalidOutput: an estimate with a wrong type, shape, time or with NaN.
    """
    if not setup.sensors:
        raise SetupError(f"{type(tracker).__name__} needs sensors; the front end lists none")
    offline = getattr(tracker, "run", None)
    if callable(offline):
        estimates = list(offline(rng, setup, scans))
    else:
        state, estimates = tracker.init(rng, setup), []
        for scan in scans:
            state, estimate = _step(tracker, rng, state, scan)
            estimates.append(estimate)
    _check_estimates(tracker, scans, estimates)
    return estimates


def replay(pipeline: Pipeline, recording: Recording, run: int = 0) -> list[Estimate]:
    """The estimates of a pipeline on a recording; the same bits in every process."""
    if pipeline.tracker is None:
        raise SetupError("this pipeline ends at its scans; replay needs one with a tracker")
    setup, scans = scans_of(pipeline.front_end, recording, pipeline.given)
    return track(pipeline.tracker, setup, scans, generator(recording.input_sha, run))


def generator(input_sha: str, run: int) -> np.random.Generator:
    """A tracker's random numbers: seeded by what it reads and the run's number, never by a name."""
    seed = hashlib.sha256(f"{input_sha}/{run}".encode()).digest()
    return np.random.default_rng(np.frombuffer(seed, np.uint32))


def _step(tracker: Tracker, rng: np.random.Generator, state: Any, scan: Scan) -> tuple[Any, Estimate]:
    result = tracker.step(rng, state, scan)
    if not isinstance(result, tuple) or len(result) != 2:
        raise InvalidOutput(f"{type(tracker).__name__}.step must return (state, Estimate), got {type(result).__name__} at {scan.time_s} s")
    return result


def _check_scans(front_end: FrontEnd, setup: Setup, scans: Sequence[Scan]) -> None:
    who = type(front_end).__name__
    previous = -np.inf
    for index, scan in enumerate(scans):
        if not isinstance(scan, Scan):
            raise InvalidOutput(f"{who}: scan {index} is {type(scan).__name__}, a Scan is needed")
        where = f"{who}: scan {index} at {scan.time_s} s"
        if scan.time_s <= previous:
            raise InvalidOutput(f"{where} does not come after the one at {previous} s")
        if len(scan.searched) != len(setup.sensors):
            raise InvalidOutput(f"{where}: searched has {len(scan.searched)} entries, the setup {len(setup.sensors)} sensors")
        for group in scan.detections:
            if len(group) and not (0 <= group.sensor.min() and group.sensor.max() < len(setup.sensors)):
                raise InvalidOutput(f"{where}: a detection names sensor {group.sensor.max()}, the setup has {len(setup.sensors)}")
            if any(len(setup.sensors[q].space) != group.z.shape[1] for q in np.unique(group.sensor)):
                raise InvalidOutput(f"{where}: detections of {group.z.shape[1]} components for a sensor with another dimension")
        previous = scan.time_s


def _check_estimates(tracker: Tracker, scans: Sequence[Scan], estimates: Sequence[Estimate]) -> None:
    who = type(tracker).__name__
    space = tracker.space
    if not isinstance(space, Space):
        raise InvalidOutput(f"{who}.space is {type(space).__name__}, a Space is needed")
    if len(estimates) != len(scans):
        raise InvalidOutput(f"{who} gave {len(estimates)} estimates for {len(scans)} scans; one a scan is needed")
    for scan, estimate in zip(scans, estimates, strict=True):
        if not isinstance(estimate, Estimate):
            raise InvalidOutput(f"{who} gave {type(estimate).__name__} at {scan.time_s} s; an Estimate is needed")
        if estimate.time_s != scan.time_s:
            raise InvalidOutput(f"{who}: the estimate of the scan at {scan.time_s} s says {estimate.time_s} s")
        if estimate.states.shape[1] != len(space):
            raise InvalidOutput(
                f"{who}: states {estimate.states.shape} at {scan.time_s} s for a space of {len(space)} names {list(space.names)}"
            )
    if len({e.labels is None for e in estimates}) > 1:
        raise InvalidOutput(f"{who} gives labels at some times and None at others; always or never")
