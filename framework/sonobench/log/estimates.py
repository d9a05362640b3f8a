"""The estimates of one trial, in an MCAP file of their own."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from sonobench.errors import LogError
from sonobench.log.codec import decode, encode
from sonobench.log.hashing import combined, digests
from sonobench.log.reader import Fault, Log, Message, saying_path
from sonobench.log.writer import canonical_json, log_writer, nanoseconds
from sonobench.types import Estimate, Space

PROFILE = "sonobench.estimates/1"
_META, _SPACE, _TRACKS = "meta.json", "/estimates/space", "/estimates/tracks"
_SCHEMAS = {_SPACE: "Space", _TRACKS: "EstimateFrame"}


def write_estimates(path: Path | str, estimates: Iterable[Estimate], space: Space, meta: Mapping[str, Any]) -> None:
    """Write estimates, the space of their states, and what `meta` says of the trial (JSON values).

    Raises:
        LogError: a time before 0, or `meta` holds what JSON does not have.
        InputError: the folder cannot be written.
    """
    path = Path(path)
    try:
        with log_writer(path, PROFILE) as log:
            log.attach(_META, canonical_json(meta))
            for topic, time_ns, data in _messages(estimates, space):
                log.add(topic, _SCHEMAS[topic], time_ns, data)
    except ValueError as error:
        raise LogError(f"{path}: the estimates cannot be written: {error}") from error


def read_estimates(path: Path | str) -> tuple[list[Estimate], Space, dict[str, Any]]:
    """What `write_estimates` was given, bit for bit; `meta` as JSON has it.

    Raises:
        LogError: the file is missing, not such a file, unfinished or damaged.
    """
    path = Path(path)
    with saying_path(path):
        log = Log(path, PROFILE)
        spaces: list[Space] = []
        estimates: list[Estimate] = []
        for topic, _, data in log.messages(_SCHEMAS):
            (spaces if topic == _SPACE else estimates).append(decode(_SCHEMAS[topic], data))
        if len(spaces) != 1:
            raise Fault(f"names {len(spaces)} state spaces, one is needed; write it again")
        return estimates, spaces[0], dict(json.loads(log.attachment(_META)))


def estimates_sha(estimates: Iterable[Estimate], space: Space) -> str:
    """SHA-256 of estimates and their space; `info`, which is for logs only, does not count."""
    return combined(digests(_messages((dataclasses.replace(e, info={}) for e in estimates), space)))


def _messages(estimates: Iterable[Estimate], space: Space) -> Iterator[Message]:
    yield _SPACE, 0, encode("Space", space)
    for estimate in estimates:
        yield _TRACKS, nanoseconds(estimate.time_s), encode("EstimateFrame", estimate)
