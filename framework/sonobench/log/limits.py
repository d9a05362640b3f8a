"""How much of a file the reader takes, whatever the file says of itself; the writer keeps to the same."""

from __future__ import annotations

from dataclasses import dataclass

_MIB = 2**20


@dataclass(frozen=True, slots=True)
class Limits:
    """Caps; each is far above what a recording of hours needs and far below what hurts."""

    chunk_bytes: int = 64 * _MIB  #: stored size of a chunk
    inflated_bytes: int = 64 * _MIB  #: size of a chunk after decompression
    message_bytes: int = 48 * _MIB  #: size of a message; with a chunk's other content it fits into a chunk
    summary_bytes: int = 16 * _MIB  #: size of the index
    attachment_bytes: int = 16 * _MIB  #: size of an attachment
    messages: int = 1_000_000  #: messages of a file (seven hours of four arrays are so many blocks)


LIMITS = Limits()
