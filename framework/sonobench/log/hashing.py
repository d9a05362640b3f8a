"""Content hashes: over topic, log time and bytes of every message, so that neither chunks, compression nor how topics interleave matter."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable, Mapping
from typing import Any

from sonobench.log.reader import Message

_HEAD = struct.Struct("<qQ")


def digests(messages: Iterable[Message]) -> dict[str, str]:
    """SHA-256 of each topic's messages in their order: log time, length and bytes."""
    hashers: dict[str, Any] = {}
    for topic, time_ns, data in messages:
        if topic not in hashers:
            hashers[topic] = hashlib.sha256()
        hashers[topic].update(_HEAD.pack(time_ns, len(data)))
        hashers[topic].update(data)
    return {topic: hasher.hexdigest() for topic, hasher in hashers.items()}


def combined(topics: Mapping[str, str]) -> str:
    """One SHA-256 of several topics' digests."""
    hasher = hashlib.sha256()
    for topic in sorted(topics):
        name = topic.encode()
        hasher.update(_HEAD.pack(0, len(name)) + name + bytes.fromhex(topics[topic]))
    return hasher.hexdigest()
