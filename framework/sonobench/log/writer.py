"""Writing an MCAP file that is there whole or not at all, with the same bytes for the same content."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from mcap.writer import CompressionType, Writer

from sonobench.errors import LogError
from sonobench.files import replacing
from sonobench.log.limits import LIMITS
from sonobench.log.schemas import PACKAGE, descriptor_set

LIBRARY = "sonobench"  # fixed, so that equal content is equal bytes
_LAST_NS = 2**63 - 1


@contextmanager
def log_writer(path: Path, profile: str) -> Iterator[LogWriter]:
    """A writer whose file takes `path`'s place when the block ends well; after an exception nothing is left behind.

    Raises:
        LogError: the disk is full, or a message is too large for the reader.
        InputError: the folder is missing or cannot be written.
    """
    with replacing(path) as temporary, open(temporary, "wb") as stream:
        log = LogWriter(path, stream, profile)
        yield log
        log.finish()


class LogWriter:
    """Messages by topic into one MCAP stream; channels and schemas are registered as topics appear."""

    def __init__(self, path: Path, stream: IO[bytes], profile: str) -> None:
        self._path = path
        self._stream = stream
        self._writer = Writer(stream, compression=CompressionType.ZSTD)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._count = 0
        self._writer.start(profile=profile, library=LIBRARY)

    def add(self, topic: str, schema: str, time_ns: int, data: bytes) -> None:
        """Append a message; `schema` counts when the topic is new."""
        self._count += 1
        if len(data) > LIMITS.message_bytes or self._count > LIMITS.messages:
            raise LogError(
                f"{self._path}: a message of {len(data)} bytes on {topic} as number {self._count}; the reader takes "
                f"{LIMITS.message_bytes} bytes and {LIMITS.messages} messages; write shorter recordings"
            )
        with self._saying_path():
            self._writer.add_message(self._channel(topic, schema), time_ns, data, publish_time=time_ns)

    def attach(self, name: str, data: bytes) -> None:
        """Attach JSON."""
        if len(data) > LIMITS.attachment_bytes:
            raise LogError(f"{self._path}: {name} has {len(data)} bytes; the reader takes {LIMITS.attachment_bytes}")
        with self._saying_path():
            self._writer.add_attachment(create_time=0, log_time=0, name=name, media_type="application/json", data=data)

    def flush(self) -> None:
        """End the chunk, so that what follows can be skipped by whoever reads only what came before."""
        with self._saying_path():
            self._writer.flush()

    def finish(self) -> None:
        """Write index and footer."""
        with self._saying_path():
            self._writer.finish()
            self._stream.flush()

    def _channel(self, topic: str, schema: str) -> int:
        if topic not in self._channels:
            if schema not in self._schemas:
                self._schemas[schema] = self._writer.register_schema(f"{PACKAGE}.{schema}", "protobuf", descriptor_set(schema))
            self._channels[topic] = self._writer.register_channel(topic, "protobuf", self._schemas[schema])
        return self._channels[topic]

    @contextmanager
    def _saying_path(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise LogError(f"{self._path}: cannot be written: {error.strerror or error}") from error


def nanoseconds(time_s: float) -> int:
    """A log time.

    Raises:
        ValueError: the time is before 0, not finite, or past int64.
    """
    if not (math.isfinite(time_s) and 0 <= time_s * 1e9 <= _LAST_NS):
        raise ValueError(f"time {time_s} s cannot be logged; log times start at 0 s and end at {_LAST_NS * 1e-9:.3g} s")
    return round(time_s * 1e9)


def canonical_json(content: Mapping[str, Any]) -> bytes:
    """JSON with sorted keys and no spaces; arrays as lists, mappings of any kind as objects.

    Raises:
        ValueError: a value that JSON does not have, NaN and infinity included.
    """
    try:
        text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False, default=_plain)
    except TypeError as error:
        raise ValueError(str(error)) from None
    return text.encode()


def _plain(value: Any) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"a {type(value).__name__} has no JSON form")
