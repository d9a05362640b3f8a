"""What a front end must do with any samples."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np

from sonobench import pipeline
from sonobench.errors import SetupError, SonobenchError
from sonobench.testing import directions, fixtures
from sonobench.testing.fixtures import MemoryRecording
from sonobench.testing.kit import Case, Skip, broken, claim, need, unmet
from sonobench.types import Scan

_FRONT_END = ("front_end",)


def _reads_samples(front_end: Any) -> bool:
    return bool(getattr(front_end, "consumes", "samples") == "samples")


def _samples_only(case: Case) -> None:
    if not _reads_samples(case.component):
        raise Skip("it reads recorded scans, no samples")


def recording(front_end: Any) -> MemoryRecording:
    """The synthetic recording that suits what it consumes."""
    return _sounding(front_end).sampled() if _reads_samples(front_end) else fixtures.measured()


def _sounding(front_end: Any) -> Any:
    """The module whose `samples` and `sampled` suit it: microphones', or vector sensors' where it takes these alone; eight channels each."""
    return directions if directions.reads_vectors(front_end) else fixtures


def run(front_end: Any, source: MemoryRecording) -> list[Scan]:
    """All scans, without the pipeline's guard."""
    _, state = front_end.open(source.header)
    scans: list[Scan] = []
    for item in source.blocks() if _reads_samples(front_end) else source.scans():
        state, ready = front_end.step(state, item)
        scans += ready
    return [*scans, *front_end.flush(state)]


def differ(a: list[Scan], b: list[Scan], tolerance: float = 1e-9) -> str:
    """Where two lists of scans differ by more than rounding, or ""."""
    if len(a) != len(b):
        return f"{len(a)} and {len(b)} scans"
    for x, y in zip(a, b, strict=True):
        if abs(x.time_s - y.time_s) > tolerance:
            return f"scans at {x.time_s} s and {y.time_s} s"
        if not np.array_equal(x.searched, y.searched):
            return f"searched at {x.time_s} s"
        if not np.allclose(_rows(x), _rows(y), rtol=1e-6, atol=tolerance) if _rows(x).shape == _rows(y).shape else True:
            return f"detections at {x.time_s} s"
    return ""


def _rows(scan: Scan) -> Any:
    flat = [(float(q), *(float(v) for v in z)) for g in scan.detections for q, z in zip(g.sensor, g.z, strict=True)]
    width = max((len(r) for r in flat), default=0)
    return np.array(sorted((*r, *[0.0] * (width - len(r))) for r in flat)).reshape(len(flat), width)


@claim("front_end.runs", _FRONT_END)
def runs(case: Case) -> None:
    """A front end takes an ordinary recording and gives scans."""
    source = recording(case.component)
    try:
        case.component.open(source.header)
    except SetupError as error:
        raise unmet([error]) from None
    need(run(case.component, source), "gave no scan of 1.2 s of sound")


@claim("front_end.scans", _FRONT_END, ["front_end.runs"])
def scans_fit(case: Case) -> None:
    """Its scans come in order and fit its setup."""
    source: Any = recording(case.component)
    try:
        pipeline.scans_of(case.component, source, fixtures.given())
    except pipeline.InvalidOutput as fault:
        broken(str(fault))


@claim("front_end.repeats", _FRONT_END, ["front_end.runs"])
def repeats(case: Case) -> None:
    """The same recording gives the same scans."""
    source = recording(case.component)
    where = differ(run(case.component, source), run(case.component, source), 0.0)
    need(not where, f"two runs over one recording differ: {where}; keep all memory in the state")


@claim("front_end.blocks", _FRONT_END, ["front_end.repeats"])
def blocks(case: Case) -> None:
    """How the samples are cut into blocks does not matter."""
    _samples_only(case)
    of = _sounding(case.component)
    signal = of.samples()
    usual = run(case.component, of.sampled(signal))
    for lengths in ((37, 1601, 4096), (len(signal),)):
        where = differ(usual, run(case.component, of.sampled(signal, lengths)))
        need(not where, f"blocks of {lengths} samples and of 1600 give different scans: {where}")


@claim("front_end.mutation", _FRONT_END, ["front_end.repeats"])
def mutation(case: Case) -> None:
    """A step changes neither its state nor the block: two steps from one state give the same."""
    front_end, source = case.component, recording(case.component)
    _, state = front_end.open(source.header)
    items = list(source.blocks() if _reads_samples(front_end) else source.scans())
    for item in items[:4]:
        state, _ = front_end.step(state, item)
    branches = []
    for _ in range(2):
        own, scans = state, []
        for item in items[4:7]:
            own, ready = front_end.step(own, item)
            scans += ready
        branches.append(scans)
    where = differ(branches[0], branches[1], 0.0)
    need(not where, f"stepping twice from one state gives different scans: {where}; build a new state, do not write into the old one")


@claim("front_end.state", _FRONT_END, ["front_end.repeats"])
def state_travels(case: Case) -> None:
    """A front end's state survives pickling and goes on the same."""
    front_end, source = case.component, recording(case.component)
    _, state = front_end.open(source.header)
    items = list(source.blocks() if _reads_samples(front_end) else source.scans())
    for item in items[:4]:
        state, _ = front_end.step(state, item)
    try:
        again = pickle.loads(pickle.dumps(state))
    except Exception as error:
        broken(f"its state cannot be pickled ({type(error).__name__}: {error}); hold arrays and dataclasses only")
    here, there = front_end.step(copy.deepcopy(state), items[4])[1], front_end.step(again, items[4])[1]
    where = differ(here, there, 0.0)
    need(not where, f"a pickled state goes on with other scans: {where}")


@claim("front_end.silence", _FRONT_END, ["front_end.runs"])
def silence(case: Case) -> None:
    """Digital silence gives scans without detections."""
    _samples_only(case)
    for scan in run(case.component, _sounding(case.component).sampled(np.zeros((9600, 8)))):
        rows = sum(map(len, scan.detections))
        need(rows == 0, f"{rows} detections in digital silence at {scan.time_s} s")


@claim("front_end.every_frame", _FRONT_END, ["front_end.runs"])
def every_frame(case: Case) -> None:
    """Every frame yields a scan, also where nothing sounds."""
    _samples_only(case)
    of = _sounding(case.component)
    steady = [s.time_s for s in run(case.component, of.sampled())]
    paused = [s.time_s for s in run(case.component, of.sampled(of.samples(sounding=(0.2, 0.6))))]
    need(
        steady == paused,
        f"{len(steady)} scans of steady sound, {len(paused)} of sound with pauses; give a scan with `searched` False where nothing sounds",
    )


@claim("front_end.nan", _FRONT_END, ["front_end.runs"])
def nan(case: Case) -> None:
    """Samples that are NaN are refused."""
    _samples_only(case)
    of = _sounding(case.component)
    signal = of.samples()
    signal[7000:7010, 2] = np.nan
    try:
        run(case.component, of.sampled(signal))
    except (ValueError, SonobenchError):
        return
    broken("took NaN samples without a word; raise a ValueError that names the array and the sample")


@claim("front_end.foreign", _FRONT_END, ["front_end.runs"])
def foreign(case: Case) -> None:
    """A recording without what it reads is refused at open by a SetupError that says what it has."""
    other = fixtures.measured() if _reads_samples(case.component) else fixtures.sampled()
    try:
        case.component.open(other.header)
    except SetupError as error:
        need(other.header.name in str(error), f"open refuses a recording without naming it ({other.header.name}): {error}")
    except Exception as error:
        broken(f"open meets a recording without what it reads with {type(error).__name__}: {error}; raise a SetupError")
    else:
        broken("open takes a recording that lacks what it reads; raise a SetupError that says what it has and what is needed")
