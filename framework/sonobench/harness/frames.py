"""Length-prefixed pickled messages over pipes between our own processes, and nothing else: never over a network."""

from __future__ import annotations

import os
import pickle
import struct
from typing import Any

_LENGTH = struct.Struct("<Q")


class Frames:
    """Collects bytes from a pipe and gives back the whole messages among them."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """The messages that `data` completes, still pickled."""
        self._bytes += data
        done = []
        while len(self._bytes) >= _LENGTH.size:
            (size,) = _LENGTH.unpack_from(self._bytes)
            if len(self._bytes) < _LENGTH.size + size:
                break
            done.append(bytes(self._bytes[_LENGTH.size : _LENGTH.size + size]))
            del self._bytes[: _LENGTH.size + size]
        return done


def send(pipe: int, message: Any) -> None:
    """Write one message; blocks while the pipe is full."""
    send_bytes(pipe, pickle.dumps(message, pickle.HIGHEST_PROTOCOL))


def send_bytes(pipe: int, content: bytes) -> None:
    """Write one message that is pickled already."""
    rest = memoryview(_LENGTH.pack(len(content)) + content)
    while rest:
        rest = rest[os.write(pipe, rest) :]


def receive_bytes(pipe: int) -> bytes | None:
    """Read one message, still pickled; None at the end of the pipe."""
    head = _exactly(pipe, _LENGTH.size)
    return None if head is None else _exactly(pipe, _LENGTH.unpack(head)[0])


def receive(pipe: int) -> Any:
    """Read one message.

    Raises:
        EOFError: the other side is gone.
    """
    content = receive_bytes(pipe)
    if content is None:
        raise EOFError("the other side closed the pipe")
    return pickle.loads(content)


def _exactly(pipe: int, size: int) -> bytes | None:
    content = bytearray()
    while len(content) < size:
        part = os.read(pipe, min(size - len(content), 1 << 20))
        if not part:
            return None
        content += part
    return bytes(content)
