"""MCAP files as no honest writer makes them."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, Channel, Chunk, ChunkIndex, DataEnd, Footer, Header, Message, Statistics
from mcap.writer import MCAP0_MAGIC

PROFILE = "sonobench.recording/1"
GIB = 2**30


def messages(count: int, size: int = 0, channel: int = 1) -> bytes:
    """The records of a chunk: `count` messages of `size` zeros."""
    builder = RecordBuilder()
    Message(channel_id=channel, log_time=0, data=bytes(size), publish_time=0, sequence=0).write(builder)
    return builder.end() * count


def chunk(data: bytes, compression: str = "", declared: int | None = None, crc: int | None = None) -> Chunk:
    """A chunk of `data` as they stand, which says that they inflate to `declared` bytes."""
    return Chunk(
        compression=compression,
        data=data,
        message_start_time=0,
        message_end_time=0,
        uncompressed_crc=zlib.crc32(data) if crc is None else crc,
        uncompressed_size=len(data) if declared is None else declared,
    )


def zstd_bomb(size: int = GIB, with_size: bool = True) -> bytes:
    """About 33 KB that inflate to `size` zeros."""
    compressor = zstandard.ZstdCompressor().compressobj(size=size if with_size else -1)
    piece = bytes(2**20)
    return b"".join(compressor.compress(piece) for _ in range(size // len(piece))) + compressor.flush()


def lz4_bomb(size: int = GIB) -> bytes:
    """About 4 MB that inflate to `size` zeros."""
    compressor = lz4.frame.LZ4FrameCompressor()
    piece = bytes(2**22)
    return compressor.begin() + b"".join(compressor.compress(piece) for _ in range(size // len(piece))) + compressor.flush()


def forge(path: Path, chunks: Sequence[Chunk], profile: str = PROFILE, topics: Sequence[str] = ("/header",), **index: Any) -> Path:
    """A finished file of `chunks`, all checksums right; `index` overrides fields of the chunk indexes and of the statistics."""
    builder = RecordBuilder()
    builder.write(MCAP0_MAGIC)
    Header(profile=profile, library="forged").write(builder)
    indexes = [_append(builder, each, len(topics)) for each in chunks]
    attachments = []
    if "attachment_offset" in index:
        start = builder.count
        Attachment(0, 0, "provenance.json", "", b"{}").write(builder)
        attachments = [AttachmentIndex(index.pop("attachment_offset"), builder.count - start, 0, 0, 2, "provenance.json", "")]
    DataEnd(0).write(builder)
    data = builder.end()
    return _finish(path, data, indexes, attachments, topics, index)


def _append(builder: RecordBuilder, each: Chunk, topics: int) -> ChunkIndex:
    start = builder.count
    each.write(builder)
    return ChunkIndex(
        chunk_length=builder.count - start,
        chunk_start_offset=start,
        compression=each.compression,
        compressed_size=len(each.data),
        message_end_time=0,
        message_index_length=0,
        message_index_offsets=dict.fromkeys(range(1, topics + 1), 0),
        message_start_time=0,
        uncompressed_size=each.uncompressed_size,
    )


def _finish(
    path: Path, data: bytes, indexes: list[ChunkIndex], attachments: list[Any], topics: Sequence[str], index: dict[str, Any]
) -> Path:
    summary = RecordBuilder()
    for number, topic in enumerate(topics, start=1):
        Channel(id=number, topic=topic, message_encoding="protobuf", metadata={}, schema_id=0).write(summary)
    counts = {"message_count": index.pop("message_count", 1), "chunk_count": index.pop("chunk_count", len(indexes))}
    Statistics(
        attachment_count=0,
        channel_count=1,
        channel_message_counts={},
        message_end_time=0,
        message_start_time=0,
        metadata_count=0,
        schema_count=0,
        **counts,
    ).write(summary)
    start = index.pop("summary_start", len(data))
    for each in indexes:
        for name, value in index.items():
            setattr(each, name, value)
        each.write(summary)
    for each in attachments:
        each.write(summary)
    body = summary.end()
    footer = RecordBuilder()
    Footer(summary_start=start, summary_offset_start=0, summary_crc=0).write(footer)
    head = footer.end()[:-4]
    crc = zlib.crc32(head, zlib.crc32(body))
    assert head[0] == Opcode.FOOTER
    path.write_bytes(data + body + head + crc.to_bytes(4, "little") + MCAP0_MAGIC)
    return path
