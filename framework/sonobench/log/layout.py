"""How a recording lies in its topics, and a rendering in memory as the messages that a file of it would hold.

| group | topics | messages |
| --- | --- | --- |
| header | /header, /array/NAME/geometry | one each |
| truth | /truth/targets, /truth/tracks | one; one for every evaluation time |
| scans | /scans | one a recorded measurement scan |
| samples | /array/NAME/samples | 100 ms each, float32, on a grid that starts at sample 0 |
| sources | /source/LABEL/samples | 100 ms each of a clean signal |

Log times are nanoseconds of the recording's own clock.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import partial
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from sonobench.errors import LogError
from sonobench.log.codec import Samples, encode, encode_samples, encode_truth
from sonobench.log.reader import Message
from sonobench.log.writer import canonical_json, nanoseconds
from sonobench.protocols import Rendering
from sonobench.types import Block, MicArray

#: in the order of the file; what is read alone lies in chunks of its own
GROUPS = ("header", "truth", "scans", "samples", "sources")
#: what a pipeline may read
INPUT = ("header", "scans", "samples")

HEADER, TARGETS, TRACKS, SCANS = "/header", "/truth/targets", "/truth/tracks", "/scans"
_SCHEMAS = {HEADER: "RecordingHeader", TARGETS: "Targets", TRACKS: "TrackFrame", SCANS: "MeasurementFrame"}
_BLOCK_S = 0.1
_Run = tuple[int, NDArray[np.float32]]  # first sample, samples (n, channels)


def group_of(topic: str) -> str:
    """The group of a topic; "other" for those that some other program added."""
    if topic == HEADER or (topic.startswith("/array/") and topic.endswith("/geometry")):
        return "header"
    if topic in (TARGETS, TRACKS):
        return "truth"
    if topic == SCANS:
        return "scans"
    if topic.endswith("/samples"):
        return {"array": "samples", "source": "sources"}.get(topic.split("/")[1], "other")
    return "other"


def schema_of(topic: str) -> str:
    """The message that a topic holds."""
    return _SCHEMAS.get(topic) or ("ArrayGeometry" if topic.endswith("/geometry") else "SampleBlock")


class Encoded:
    """The messages of a rendering, encoded as they are asked for.

    Raises:
        LogError: from `messages`; the rendering cannot be recorded. The message begins with `where`.
    """

    path = None  # of the file: there is none

    def __init__(self, rendering: Rendering, where: str) -> None:
        self.where = where
        self._rendering = rendering

    def messages(self, groups: Collection[str]) -> Iterator[Message]:
        """Messages of the named groups, group by group."""
        try:
            for group in GROUPS:
                if group in groups:
                    yield from _ENCODERS[group](self._rendering)
        except ValueError as error:
            raise LogError(f"{self.where}: cannot be recorded: {error}") from error

    def provenance(self) -> bytes:
        """Canonical JSON."""
        try:
            return canonical_json(self._rendering.provenance)
        except ValueError as error:
            raise LogError(f"{self.where}: its provenance cannot be recorded: {error}") from error


def _header(rendering: Rendering) -> Iterator[Message]:
    header = rendering.header
    names = [a.name for a in header.arrays]
    if len(set(names)) != len(names):
        raise ValueError(f"two arrays have one name: {names}")
    start = nanoseconds(header.start_s)
    yield HEADER, start, encode("RecordingHeader", header)
    for array in header.arrays:
        yield f"/array/{quote(array.name, safe='')}/geometry", start, encode("ArrayGeometry", array)


def _truth(rendering: Rendering) -> Iterator[Message]:
    targets, frames = encode_truth(rendering.truth)
    yield TARGETS, nanoseconds(rendering.header.start_s), targets
    for time_s, frame in zip(rendering.truth.time_s, frames, strict=True):
        yield TRACKS, nanoseconds(float(time_s)), frame


def _scans(rendering: Rendering) -> Iterator[Message]:
    for scan in rendering.scans:
        yield SCANS, nanoseconds(scan.time_s), encode("MeasurementFrame", scan)


def _samples(rendering: Rendering) -> Iterator[Message]:
    arrays = rendering.header.arrays
    unknown = sorted({b.array for b in rendering.blocks} - {a.name for a in arrays})
    if unknown:
        raise ValueError(f"samples of arrays {unknown}, which the header does not have")
    streams = (_array_blocks(array, [b for b in rendering.blocks if b.array == array.name]) for array in arrays)
    messages = (map(partial(_sample_message, "array", rendering.header.start_s), stream) for stream in streams)
    yield from heapq.merge(*messages, key=lambda message: message[1])  # at equal times in the header's order of arrays


def _sources(rendering: Rendering) -> Iterator[Message]:
    for label in sorted(rendering.sources):
        rate_hz, samples = rendering.sources[label]
        signal = np.asarray(samples, np.float32).reshape(-1, 1)
        runs = on_grid([(0, signal)], rate_hz) if len(signal) else [(0, signal)]
        for first_sample, run in runs:
            yield _sample_message("source", rendering.header.start_s, Samples(label, first_sample, float(rate_hz), run))


_ENCODERS: Mapping[str, Callable[[Rendering], Iterator[Message]]] = {
    "header": _header,
    "truth": _truth,
    "scans": _scans,
    "samples": _samples,
    "sources": _sources,
}


def _sample_message(kind: str, start_s: float, block: Samples) -> Message:
    time_ns = nanoseconds(start_s + block.first_sample / block.rate_hz)
    return f"/{kind}/{quote(block.name, safe='')}/samples", time_ns, encode_samples(block)


def _array_blocks(array: MicArray, blocks: Iterable[Block]) -> Iterator[Samples]:
    def runs() -> Iterator[_Run]:
        for block in blocks:
            if block.samples.shape[1] != array.channels:
                raise ValueError(f"a block of {array.name} has {block.samples.shape[1]} channels; the array has {array.channels}")
            yield block.first_sample, block.samples

    for first_sample, samples in on_grid(runs(), array.rate_hz, array.name):
        yield Samples(array.name, first_sample, array.rate_hz, samples)


def on_grid(runs: Iterable[_Run], rate_hz: float, name: str = "samples") -> Iterator[_Run]:
    """The same samples cut at multiples of 100 ms, whatever lengths they come in; a gap also cuts.

    Raises:
        ValueError: a run begins before the last one ended.
    """
    n = max(1, round(rate_hz * _BLOCK_S))
    pieces: list[Any] = []
    first = position = 0
    for start, samples in runs:
        if not len(samples):
            continue
        if start < position:
            raise ValueError(f"a block of {name} begins at sample {start}, before sample {position} where the last one ended")
        if start > position and pieces:
            yield first, _joined(pieces)
            pieces = []
        position = start
        for cut in np.split(samples, range(n - start % n, len(samples), n)):
            first = first if pieces else position
            pieces.append(cut)
            position += len(cut)
            if position % n == 0:
                yield first, _joined(pieces)
                pieces = []
    if pieces:
        yield first, _joined(pieces)


def _joined(pieces: list[Any]) -> NDArray[np.float32]:
    return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)
