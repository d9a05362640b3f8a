"""A guarded reader: checksums required, sizes and counts capped before anything is allocated, one exception for all faults.

It reads by the file's index, so that topics that nobody asks for are neither read nor inflated. The index is a claim:
its checksum, offsets, order and sizes are checked before they are used.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import lz4.frame
import zstandard
from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, Channel, Chunk, ChunkIndex, Footer, Statistics
from mcap.records import Header as FileHeader
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

from sonobench.errors import LogError
from sonobench.log.limits import LIMITS, Limits

#: topic, log time in ns, bytes
Message = tuple[str, int, bytes]

_PREFIX = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_HEAD = _MESSAGE.size - _PREFIX.size
_FOOTER = struct.Struct("<BQQQI")
_TAIL = _FOOTER.size + len(MCAP0_MAGIC)
_FOREIGN: tuple[type[Exception], ...] = (McapError, DecodeError, struct.error, zstandard.ZstdError, ValueError, TypeError, KeyError)
_FOREIGN += (IndexError, OverflowError, RuntimeError, MemoryError)


class Fault(Exception):
    """What is wrong and what to do; `saying_path` makes it a LogError."""


@contextmanager
def saying_path(where: Path | str) -> Iterator[None]:
    """Every fault of a file, and every exception of a library that parses it, as a LogError that begins with `where`."""
    try:
        yield
    except Fault as fault:
        raise LogError(f"{where}: {fault}") from None
    except FileNotFoundError:
        raise LogError(f"{where}: there is no such file; check the path") from None
    except OSError as error:
        raise LogError(f"{where}: cannot be read: {error.strerror or error}") from error
    except _FOREIGN as error:
        raise LogError(f"{where}: damaged: {error or type(error).__name__}; write or copy it again") from error


@dataclass(frozen=True, slots=True)
class _Index:
    """The checked summary of a file."""

    channels: dict[int, str]
    chunks: tuple[ChunkIndex, ...]
    attachments: tuple[AttachmentIndex, ...]


class Log:
    """One finished MCAP file of a profile such as "sonobench.recording/1".

    No handle stays open between reads; a file that is replaced in the meantime is refused.

    Raises:
        LogError: from the constructor and every method; the message begins with the path.
    """

    def __init__(self, path: Path, profile: str, limits: Limits = LIMITS) -> None:
        self.path = path
        self._limits = limits
        self._stamp: tuple[int, ...] | None = None
        with saying_path(path), self._opened() as stream:
            size = os.fstat(stream.fileno()).st_size
            data_start = _check_kind(stream, size, profile)
            self._index = _read_index(stream, data_start, size, limits)

    @property
    def topics(self) -> tuple[str, ...]:
        """Every topic that the file declares."""
        return tuple(self._index.channels.values())

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """Messages of `topics` (None: all) in the order of the file; chunks without any of them are skipped."""
        wanted = {i: t for i, t in self._index.channels.items() if topics is None or t in topics}
        count = 0
        with saying_path(self.path), self._opened() as stream:
            for index in self._index.chunks:
                listed = index.message_index_offsets
                if listed and wanted.keys().isdisjoint(listed):
                    continue
                for channel, time_ns, data in _scan(_inflate(stream, index, self._limits)):
                    count += 1
                    if count > self._limits.messages:
                        raise Fault(f"has more than {self._limits.messages} messages; Sonobench reads no such file")
                    if channel not in listed:
                        raise Fault("its index leaves out a topic of a chunk; write it again")
                    if channel in wanted:
                        yield wanted[channel], time_ns, data

    def attachment(self, name: str) -> bytes:
        """The attachment of that name."""
        with saying_path(self.path), self._opened() as stream:
            for index in self._index.attachments:
                if index.name == name:
                    return _read_attachment(stream, index)
            raise Fault(f"has no attachment {name}; write it again")

    @contextmanager
    def _opened(self) -> Iterator[IO[bytes]]:
        if self.path.exists() and not self.path.is_file():
            raise Fault("is not a regular file; an MCAP file is needed")
        with open(self.path, "rb") as stream:
            status = os.fstat(stream.fileno())
            stamp = (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns)
            if self._stamp not in (None, stamp):
                raise Fault("has changed since it was opened; open it again")
            self._stamp = stamp
            yield stream


def _check_kind(stream: IO[bytes], size: int, profile: str) -> int:
    """Tell foreign files from unfinished ones; return where the data section begins."""
    start = stream.read(len(MCAP0_MAGIC))
    if not start or not MCAP0_MAGIC.startswith(start):
        raise Fault(
            "is not an MCAP file" + (" (it is empty)" if not start else "") + "; give a recording such as `sonobench data make` writes"
        )
    prefix = stream.read(_PREFIX.size)
    opcode, length = _PREFIX.unpack(prefix) if len(prefix) == _PREFIX.size else (Opcode.HEADER, 0)
    if opcode != Opcode.HEADER or length > 2**16:
        raise Fault("damaged: it does not begin with an MCAP header; write or copy it again")
    body = stream.read(length)
    unfinished = size < stream.tell() + _TAIL or _read(stream, size - len(MCAP0_MAGIC), len(MCAP0_MAGIC)) != MCAP0_MAGIC
    if len(body) == length > 0:
        _check_profile(FileHeader.read(ReadDataStream(BytesIO(body))), profile)
    if unfinished:
        raise Fault("unfinished: it ends without index and footer, its writer was interrupted or the copy was cut; write or copy it again")
    return len(MCAP0_MAGIC) + _PREFIX.size + length


def _check_profile(header: FileHeader, profile: str) -> None:
    if header.profile == profile:
        return
    kind, _, version = profile.partition("/")
    found, _, number = header.profile.partition("/")
    if found == kind and number.isdigit() and int(number) > int(version):
        raise Fault(f"is a {kind} of format {number}; this version reads up to {version}; upgrade sonobench")
    if found.startswith("sonobench."):
        raise Fault(f"is a {found}; a {kind} is needed")
    raise Fault(
        f"is an MCAP file (profile {header.profile!r}, library {header.library!r}) but not a {kind}; `sonobench data make` writes one"
    )


def _read_index(stream: IO[bytes], data_start: int, size: int, limits: Limits) -> _Index:
    tail = _read(stream, size - _TAIL, _TAIL)
    opcode, length, summary_start, _, crc = _FOOTER.unpack_from(tail)
    data_end = size - _TAIL
    if opcode != Opcode.FOOTER or length != _FOOTER.size - _PREFIX.size or not data_start <= summary_start <= data_end:
        raise Fault("damaged: its footer points nowhere; write or copy it again")
    if data_end - summary_start > limits.summary_bytes:
        raise Fault(f"its index has {data_end - summary_start} bytes; Sonobench reads up to {limits.summary_bytes}")
    summary = _read(stream, summary_start, data_end - summary_start)
    if zlib.crc32(tail[: _FOOTER.size - 4], zlib.crc32(summary)) != crc:
        raise Fault("damaged: its index fails its checksum; write or copy it again")
    return _parse_index(summary + tail, data_start, summary_start, limits)


def _parse_index(summary: bytes, data_start: int, data_end: int, limits: Limits) -> _Index:
    records: dict[type, list[Any]] = {Channel: [], ChunkIndex: [], AttachmentIndex: [], Statistics: [], Footer: []}
    for record in StreamReader(BytesIO(summary), skip_magic=True, emit_chunks=True, record_size_limit=len(summary)).records:
        records.setdefault(type(record), []).append(record)
    for statistics in records[Statistics]:
        if statistics.message_count > limits.messages:
            raise Fault(f"has {statistics.message_count} messages; Sonobench reads up to {limits.messages}")
        if statistics.chunk_count != len(records[ChunkIndex]):
            raise Fault(f"its index lists {len(records[ChunkIndex])} of {statistics.chunk_count} chunks; write it again")
    chunks = tuple(sorted(records[ChunkIndex], key=lambda c: c.chunk_start_offset))
    attachments = tuple(records[AttachmentIndex])
    spans = [(c.chunk_start_offset, c.chunk_length) for c in chunks] + [(a.offset, a.length) for a in attachments]
    _check_spans(spans, data_start, data_end)
    channels = {c.id: c.topic for c in records[Channel]}
    if len(set(channels.values())) != len(records[Channel]):
        raise Fault("its index declares a topic twice; write it again")
    for chunk in chunks:
        if not chunk.message_index_offsets or not chunk.message_index_offsets.keys() <= channels.keys():
            raise Fault("its index does not say which topics a chunk holds; write it again")
        if chunk.chunk_length > limits.chunk_bytes or chunk.uncompressed_size > limits.inflated_bytes:
            raise Fault(
                f"a chunk has {chunk.chunk_length} bytes and says to inflate to {chunk.uncompressed_size}; "
                f"Sonobench reads up to {limits.chunk_bytes} and {limits.inflated_bytes}"
            )
    if any(a.length > limits.attachment_bytes + 2**16 for a in attachments):
        raise Fault(f"an attachment has more than {limits.attachment_bytes} bytes; Sonobench reads no such file")
    return _Index(channels, chunks, attachments)


def _check_spans(spans: list[tuple[int, int]], start: int, end: int) -> None:
    for offset, length in sorted(spans):
        if offset < start or length < _PREFIX.size or offset + length > end:
            raise Fault("its index points outside the file's data, or twice to the same; write or copy it again")
        start = offset + length


def _read(stream: IO[bytes], offset: int, length: int) -> bytes:
    stream.seek(offset)
    data = stream.read(length)
    if len(data) != length:
        raise Fault("unfinished: it ends in the middle of a record; write or copy it again")
    return data


def _record(stream: IO[bytes], opcode: Opcode, offset: int, length: int) -> bytes:
    """The body of the record that the index says is there."""
    record = _read(stream, offset, length)
    if _PREFIX.unpack_from(record) != (opcode, length - _PREFIX.size):
        raise Fault("damaged: its index points to something else; write or copy it again")
    return record[_PREFIX.size :]


def _read_attachment(stream: IO[bytes], index: AttachmentIndex) -> bytes:
    body = _record(stream, Opcode.ATTACHMENT, index.offset, index.length)
    if zlib.crc32(body[:-4]) != int.from_bytes(body[-4:], "little"):
        raise Fault(f"damaged: attachment {index.name} fails its checksum; write or copy it again")
    return bytes(Attachment.read(ReadDataStream(BytesIO(body))).data)


def _inflate(stream: IO[bytes], index: ChunkIndex, limits: Limits) -> bytes:
    """A chunk's records, their checksum verified."""
    chunk = Chunk.read(ReadDataStream(BytesIO(_record(stream, Opcode.CHUNK, index.chunk_start_offset, index.chunk_length))))
    size = chunk.uncompressed_size
    if size != index.uncompressed_size or len(chunk.data) != index.compressed_size or size > limits.inflated_bytes:
        raise Fault("damaged: a chunk and its index disagree about sizes; write or copy it again")
    data = _decompress(chunk, size)
    if len(data) != size or zlib.crc32(data) != chunk.uncompressed_crc:
        raise Fault("damaged: a chunk fails its checksum; write or copy it again")
    return data


def _decompress(chunk: Chunk, size: int) -> bytes:
    """Never more than `size` bytes, whatever the compressed data say."""
    if chunk.compression == "":
        return chunk.data
    if chunk.compression == "zstd":
        if zstandard.frame_content_size(chunk.data) != size:
            raise Fault("damaged: a zstd frame does not have the size that its chunk declares; write or copy it again")
        return zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=size, allow_extra_data=False)
    if chunk.compression == "lz4":
        decompressor = lz4.frame.LZ4FrameDecompressor()
        data = bytes(decompressor.decompress(chunk.data, max_length=size))
        if not decompressor.eof or decompressor.unused_data:
            raise Fault("damaged: an lz4 frame does not have the size that its chunk declares; write or copy it again")
        return data
    raise Fault(f"compressed with {chunk.compression!r}; Sonobench reads zstd, lz4 and none")


def _scan(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """(channel, log time, bytes) of each message of a chunk."""
    position, end = 0, len(data)
    unpack_message, message_size, is_message = _MESSAGE.unpack_from, _MESSAGE.size, int(Opcode.MESSAGE)
    while position < end:
        if data[position] != is_message:
            position += _PREFIX.size + _PREFIX.unpack_from(data, position)[1]
            continue
        _, length, channel, _, time_ns, _ = unpack_message(data, position)
        stop = position + _PREFIX.size + length
        if length < _MESSAGE_HEAD or stop > end:
            raise Fault("damaged: a message reaches past its chunk; write or copy it again")
        yield channel, time_ns, data[position + message_size : stop]
        position = stop
    if position != end:
        raise Fault("damaged: a record reaches past its chunk; write or copy it again")
