"""Recordings: what a simulator rendered, or a corpus holds, in an MCAP file or in memory; both read alike."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sonobench.log.codec import Samples, decode, decode_samples, decode_truth
from sonobench.log.hashing import combined, digests
from sonobench.log.layout import GROUPS, HEADER, INPUT, TARGETS, TRACKS, Encoded, group_of, schema_of
from sonobench.log.reader import Fault, Log, Message, saying_path
from sonobench.log.writer import log_writer
from sonobench.protocols import Rendering
from sonobench.types import Block, Header, Scan, Truth

PROFILE = "sonobench.recording/1"
_PROVENANCE = "provenance.json"


def write_recording(path: Path | str, rendering: Rendering) -> None:
    """Write a rendering to an MCAP file, whole or not at all; equal renderings give equal bytes.

    Raises:
        LogError: the rendering cannot be recorded (a time before 0, overlapping blocks, a plugin's own field, …).
        InputError: the folder cannot be written.
    """
    path = Path(path)
    encoded = Encoded(rendering, str(path))
    with log_writer(path, PROFILE) as log:
        log.attach(_PROVENANCE, encoded.provenance())
        for group in GROUPS:
            for topic, time_ns, data in encoded.messages({group}):
                log.add(topic, schema_of(topic), time_ns, data)
            log.flush()


def open_recording(path: Path | str) -> Recording:
    """A recording; its index and header are read and checked now, everything else when asked for.

    Raises:
        LogError: the file is missing, not an MCAP, not a Sonobench recording, unfinished or damaged.
    """
    recording = Recording(_Stored(Path(path)))
    _ = recording.header
    return recording


class _Source(Protocol):
    """Where the messages of a recording come from."""

    where: str

    @property
    def path(self) -> Path | None: ...
    def messages(self, groups: Collection[str]) -> Iterator[Message]: ...
    def provenance(self) -> bytes: ...


class _Stored:
    """The messages of a file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.where = str(path)
        self._log = Log(path, PROFILE)

    def messages(self, groups: Collection[str]) -> Iterator[Message]:
        return self._log.messages({t for t in self._log.topics if group_of(t) in groups})

    def provenance(self) -> bytes:
        return self._log.attachment(_PROVENANCE)


class Recording:
    """Header, truth, samples, recorded scans, clean sources, provenance and hashes of one recording.

    Every method and property raises LogError where the file turns out to be damaged; the message begins with its path.
    """

    def __init__(self, source: _Source) -> None:
        self._source = source
        self._digests: dict[str, dict[str, str]] = {}

    @classmethod
    def of(cls, rendering: Rendering) -> Recording:
        """A rendering in memory as the recording that a file of it would be, with the same hashes and blocks."""
        return cls(Encoded(rendering, f"recording {rendering.header.name}"))

    def __repr__(self) -> str:
        return f"Recording({self._source.where!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        return Recording, (self._source,)

    @property
    def path(self) -> Path | None:
        """The file, None for a recording in memory."""
        return self._source.path

    @cached_property
    def header(self) -> Header:
        """What the recording says of itself before its first sample."""
        with saying_path(self._source.where):
            messages = list(self._source.messages({"header"}))
            arrays = tuple(decode("ArrayGeometry", data) for topic, _, data in messages if topic != HEADER)
            header: Header = decode("RecordingHeader", _only(HEADER, messages), arrays=arrays)
            return header

    @cached_property
    def truth(self) -> Truth:
        """Where the targets are; for metrics only."""
        with saying_path(self._source.where):
            messages = list(self._source.messages({"truth"}))
            return decode_truth(_only(TARGETS, messages), (data for topic, _, data in messages if topic == TRACKS))

    @cached_property
    def provenance(self) -> dict[str, Any]:
        """Scene, seed, versions, units and licences, as JSON has them; in no hash."""
        with saying_path(self._source.where):
            return dict(json.loads(self._source.provenance()))

    def blocks(self) -> Iterator[Block]:
        """Sample blocks of about 100 ms in time order."""
        arrays = {a.name: (order, a) for order, a in enumerate(self.header.arrays)}
        ends = dict.fromkeys(arrays, 0)
        last = (0, 0)
        with saying_path(self._source.where):
            for topic, time_ns, data in self._source.messages({"samples"}):
                block = decode_samples(data)
                if block.name not in arrays:
                    raise Fault(f"{topic} holds samples of {block.name!r}, the header has arrays {sorted(arrays)}; write it again")
                order, array = arrays[block.name]
                if (block.rate_hz, block.samples.shape[1]) != (array.rate_hz, array.channels):
                    raise Fault(
                        f"{topic} holds {block.samples.shape[1]} channels at {block.rate_hz:g} Hz, array {array.name} has "
                        f"{array.channels} at {array.rate_hz:g} Hz; write it again"
                    )
                if block.first_sample < ends[block.name] or (time_ns, order) < last:
                    raise Fault(f"{topic} is out of order at sample {block.first_sample}; write it again")
                ends[block.name], last = block.first_sample + len(block.samples), (time_ns, order)
                yield Block(block.name, block.first_sample, block.samples)

    def scans(self) -> Iterator[Scan]:
        """Recorded measurement scans in time order."""
        with saying_path(self._source.where):
            for _, _, data in self._source.messages({"scans"}):
                yield decode("MeasurementFrame", data)

    def sources(self) -> Mapping[str, tuple[float, NDArray[np.float32]]]:
        """Clean source signals: label → (rate in Hz, samples (n,) float32)."""
        runs: dict[str, list[Samples]] = {}
        with saying_path(self._source.where):
            for _, _, data in self._source.messages({"sources"}):
                block = decode_samples(data)
                runs.setdefault(block.name, []).append(block)
            return {label: _signal(blocks) for label, blocks in sorted(runs.items())}

    @property
    def input_sha(self) -> str:
        """Hash of what a pipeline may read: header, samples, recorded scans."""
        return self._sha(INPUT)

    @property
    def truth_sha(self) -> str:
        """Hash of the truth."""
        return self._sha(("truth",))

    @property
    def content_sha(self) -> str:
        """Hash of every message; the provenance is not in it."""
        return self._sha((*GROUPS, "other"))

    def _sha(self, groups: Collection[str]) -> str:
        missing = set(groups) - self._digests.keys()
        if missing:
            found = digests(self._source.messages(missing))
            for group in missing:
                self._digests[group] = {t: d for t, d in found.items() if group_of(t) == group}
        return combined({t: d for group in groups for t, d in self._digests[group].items()})


def _only(topic: str, messages: list[Message]) -> bytes:
    """The bytes of the one message on `topic`."""
    found = [data for name, _, data in messages if name == topic]
    if len(found) != 1:
        raise Fault(f"has {len(found)} messages on {topic}, one is needed; write it again")
    return found[0]


def _signal(blocks: list[Samples]) -> tuple[float, NDArray[np.float32]]:
    ends = np.cumsum([0, *(len(b.samples) for b in blocks)])
    if len({b.rate_hz for b in blocks}) > 1 or any(
        b.samples.shape[1] != 1 or b.first_sample != e for b, e in zip(blocks, ends, strict=False)
    ):
        raise Fault(f"the blocks of source {blocks[0].name!r} do not fit together; write it again")
    signal = np.concatenate([b.samples[:, 0] for b in blocks])
    signal.flags.writeable = False
    return blocks[0].rate_hz, signal
