"""Whatever a file holds, reading it ends in its content or in one LogError that begins with its path."""

from __future__ import annotations

import os
import subprocess
import sys
import time
import zlib

import log_samples
import lz4.frame
import numpy as np
import pytest
import zstandard
from log_forge import GIB, PROFILE, chunk, forge, lz4_bomb, messages, zstd_bomb
from mcap.writer import Writer

from sonobench.errors import LogError
from sonobench.log import open_recording, read_estimates, write_estimates, write_recording
from sonobench.log.codec import Samples, encode_samples
from sonobench.log.limits import Limits
from sonobench.log.reader import Log
from sonobench.log.writer import log_writer
from sonobench.types import Space


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "small.mcap"
    write_recording(path, log_samples.rendering(duration_s=0.2))
    return path.read_bytes()


def _everything(path):
    recording = open_recording(path)
    for part in (recording.header, recording.truth, *recording.blocks(), *recording.scans()):
        assert part is not None
    return recording.content_sha, recording.input_sha, recording.provenance, {k: v[1].tobytes() for k, v in recording.sources().items()}


def _outcome(path, content):
    """The content, or the message of a LogError, which is one line that begins with the path."""
    path.write_bytes(content)
    try:
        return _everything(path)
    except LogError as error:
        said = str(error)
    assert said.startswith(f"{path}: ")
    assert "\n" not in said
    return said


def test_every_truncation_is_reported_as_unfinished(small, tmp_path):
    path = tmp_path / "cut.mcap"
    for cut in np.unique(np.linspace(1, len(small) - 1, 150).astype(int)):
        said = _outcome(path, small[:cut])
        assert isinstance(said, str)
        assert "unfinished" in said, (cut, said)


def test_a_flipped_bit_never_changes_content_in_silence(small, tmp_path):
    path = tmp_path / "flip.mcap"
    whole = _outcome(path, small)
    rng = np.random.default_rng(7)
    ends = [*range(60), *range(len(small) - 120, len(small))]  # file header and footer: structure, every byte of it
    attached = small.index(b'"name":"small"')
    inside = [*rng.integers(60, len(small), 200), *range(attached, attached + 20)]
    places = [(int(byte), int(rng.integers(8))) for byte in [*ends, *inside]]
    outcomes = []
    for byte, bit in places:
        flipped = bytearray(small)
        flipped[byte] ^= 1 << bit
        outcomes.append(_outcome(path, flipped))
    changed = [(place, o) for place, o in zip(places, outcomes, strict=True) if not isinstance(o, str) and o != whole]
    assert changed == []
    assert sum(isinstance(o, str) for o in outcomes) > 200


def _bombs():
    bomb = zstd_bomb()
    honest = (GIB).to_bytes(4, "little")
    assert honest in bomb[:18]
    lying = bomb.replace(honest, (2**20).to_bytes(4, "little"), 1)
    yield "zstd-declared", chunk(bomb, "zstd", declared=GIB)
    yield "zstd-declared-small", chunk(bomb, "zstd", declared=10)
    yield "zstd-frame-lies", chunk(lying, "zstd", declared=2**20)
    yield "zstd-no-size", chunk(zstd_bomb(with_size=False), "zstd", declared=2**20)
    yield "zstd-huge-claim", chunk(zstd_bomb(2**20, with_size=False), "zstd", declared=2**40)
    squeezed = lz4_bomb()
    yield "lz4-declared", chunk(squeezed, "lz4", declared=GIB)
    yield "lz4-declared-small", chunk(squeezed, "lz4", declared=2**20)


_OPEN = """
import sys, time
from pathlib import Path
from sonobench.errors import LogError
from sonobench.log import open_recording

def peak_kib():
    return int(next(l for l in open("/proc/self/status") if l.startswith("VmHWM")).split()[1])

try: open_recording("none.mcap")
except LogError: pass
before = peak_kib()
for path in sorted(Path(sys.argv[1]).iterdir()):
    begin = time.perf_counter()
    try:
        open_recording(path)
        print(path.name, "opened")
    except LogError as error:
        print(path.name, "refused" if str(error).startswith(str(path)) else error, time.perf_counter() - begin)
print(peak_kib() - before)
"""


def test_decompression_bombs_are_refused_quickly_and_without_memory(tmp_path):
    for name, bomb in _bombs():
        forge(tmp_path / f"{name}.mcap", [bomb])
    assert (tmp_path / "zstd-declared.mcap").stat().st_size < 40_000
    done = subprocess.run([sys.executable, "-c", _OPEN, str(tmp_path)], capture_output=True, text=True, check=True)
    *rows, grown_kib = done.stdout.splitlines()
    assert [row.split()[1] for row in rows] == ["refused"] * 7, done.stdout
    assert max(float(row.split()[2]) for row in rows) < 0.5, done.stdout
    assert int(grown_kib) < 100_000, done.stdout


@pytest.mark.parametrize("compression", ["zstd", "lz4", ""])
def test_an_honest_chunk_of_any_known_compression_is_read(tmp_path, compression):
    data = messages(3, size=100)
    squeezed = {"zstd": zstandard.compress, "lz4": lz4.frame.compress, "": bytes}[compression](data)
    path = forge(tmp_path / "a.mcap", [chunk(squeezed, compression, declared=len(data), crc=zlib.crc32(data))])
    assert list(Log(path, PROFILE).messages()) == [("/header", 0, bytes(100))] * 3


def test_more_messages_than_the_cap_are_refused_declared_or_not(tmp_path):
    many = zstandard.compress(messages(1_200_000))
    assert len(many) < 10_000
    whole = chunk(many, "zstd", declared=31 * 1_200_000, crc=zlib.crc32(messages(1_200_000)))
    with pytest.raises(LogError, match="has 1200000 messages"):
        Log(forge(tmp_path / "declared.mcap", [whole], message_count=1_200_000), PROFILE)
    lying = Log(forge(tmp_path / "lying.mcap", [whole]), PROFILE)
    with pytest.raises(LogError, match="more than 1000000 messages"):
        sum(1 for _ in lying.messages())
    few = Log(forge(tmp_path / "few.mcap", [chunk(messages(4))]), PROFILE, Limits(messages=3))
    with pytest.raises(LogError, match="more than 3 messages"):
        list(few.messages())


def _hostile():
    plain = chunk(messages(2))
    short = messages(2, size=4)[:-1]
    return {
        "outside": ([plain], {"chunk_start_offset": 10**6}, "points outside"),
        "negative length": ([plain], {"chunk_length": 2**63}, "points outside"),
        "into the header": ([plain], {"chunk_start_offset": 9}, "points outside"),
        "overflow": ([plain], {"chunk_start_offset": 2**64 - 8, "chunk_length": 16}, "points outside"),
        "length zero": ([plain], {"chunk_length": 0}, "points outside"),
        "twice the same": ([plain, plain], {"chunk_start_offset": 40}, "twice to the same"),
        "not a chunk": ([plain], {"chunk_start_offset": 38}, "points outside|points to something else"),
        "sizes disagree": ([plain], {"uncompressed_size": 63}, "disagree about sizes"),
        "compressed size": ([plain], {"compressed_size": 5}, "disagree about sizes"),
        "huge": ([plain], {"uncompressed_size": 2**40}, "says to inflate to"),
        "unknown topic": ([plain], {"message_index_offsets": {7: 0}}, "does not say which topics"),
        "no topic": ([plain], {"message_index_offsets": {}}, "does not say which topics"),
        "chunks missing": ([plain], {"chunk_count": 5}, "lists 1 of 5 chunks"),
        "too many messages": ([plain], {"message_count": 2**60}, "messages; Sonobench reads up to"),
        "summary outside": ([plain], {"summary_start": 2**40}, "footer points nowhere"),
        "attachment outside": ([plain], {"attachment_offset": 2**50}, "points outside"),
        "message beyond its chunk": ([chunk(short)], {}, "message reaches past"),
        "record beyond its chunk": ([chunk(b"\x63" + (2**40).to_bytes(8, "little"))], {}, "record reaches past"),
        "stray bytes": ([chunk(messages(1) + b"\x05\x01")], {}, "damaged"),
        "message too short": ([chunk(b"\x05" + bytes(8) + bytes(40))], {}, "message reaches past"),
        "channel not in the index": ([chunk(messages(1, channel=2))], {}, "leaves out a topic"),
        "no checksum": ([chunk(messages(1), crc=0)], {}, "fails its checksum"),
        "wrong checksum": ([chunk(messages(1), crc=1)], {}, "fails its checksum"),
        "unknown compression": ([chunk(messages(1), "lzma")], {}, "compressed with 'lzma'"),
        "not zstd": ([chunk(messages(1), "zstd")], {}, "damaged"),
        "not lz4": ([chunk(messages(1), "lz4")], {}, "damaged"),
        "lz4 cut": ([chunk(lz4.frame.compress(messages(9))[:-4], "lz4", declared=9 * 31, crc=zlib.crc32(messages(9)))], {}, "damaged"),
        "two zstd frames": ([chunk(zstandard.compress(messages(1)) * 2, "zstd", declared=31, crc=zlib.crc32(messages(1)))], {}, "damaged"),
        "not a protobuf": ([chunk(messages(1, size=5))], {}, "damaged"),
    }


@pytest.mark.parametrize("fault", _hostile())
def test_a_hostile_index_or_chunk_is_refused(tmp_path, fault):
    chunks, index, said = _hostile()[fault]
    path = forge(tmp_path / "hostile.mcap", chunks, **index)
    begin = time.perf_counter()
    with pytest.raises(LogError, match=said) as caught:
        open_recording(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert time.perf_counter() - begin < 1


def test_a_topic_declared_twice_is_refused(tmp_path):
    with pytest.raises(LogError, match="declares a topic twice"):
        Log(forge(tmp_path / "twice.mcap", [chunk(messages(1))], topics=("/header", "/header")), PROFILE)


def test_a_foreign_mcap_is_called_one(tmp_path):
    path = tmp_path / "robot.mcap"
    with open(path, "wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="libmcap")
        writer.finish()
    with pytest.raises(LogError, match=r"robot\.mcap: is an MCAP file \(profile 'ros2'.*not a sonobench\.recording"):
        open_recording(path)


@pytest.mark.parametrize("content", [b"", b"fLaC and so on", b"\x89PNG\r\n\x1a\n" + bytes(100), bytes(1000)])
def test_what_is_no_mcap_is_called_so(tmp_path, content):
    path = tmp_path / "song.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match="is not an MCAP file"):
        open_recording(path)


def test_missing_files_folders_and_pipes_are_named(tmp_path):
    with pytest.raises(LogError, match=r"none\.mcap: there is no such file"):
        open_recording(tmp_path / "none.mcap")
    with pytest.raises(LogError, match="is not a regular file"):
        open_recording(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(LogError, match="is not a regular file"):
        open_recording(tmp_path / "pipe")


def test_an_unfinished_file_is_reported_even_after_a_flush(tmp_path):
    path = tmp_path / "open.mcap"
    with open(path, "wb") as stream:
        writer = Writer(stream)
        writer.start(profile=PROFILE, library="sonobench")
        channel = writer.register_channel("/header", "protobuf", 0)
        writer.add_message(channel, 0, b"x", 0)
        writer.flush()
    with pytest.raises(LogError, match=r"open\.mcap: unfinished"):
        open_recording(path)


def test_estimates_are_no_recording_and_newer_formats_say_upgrade(tmp_path):
    path = tmp_path / "e.mcap"
    write_estimates(path, [], Space.of("x_m"), {})
    with pytest.raises(LogError, match=r"is a sonobench\.estimates; a sonobench\.recording is needed"):
        open_recording(path)
    with pytest.raises(LogError, match=r"sonobench\.recording of format 2.*upgrade"):
        open_recording(forge(tmp_path / "new.mcap", [chunk(messages(1))], profile="sonobench.recording/2"))
    with pytest.raises(LogError, match=r"is a sonobench\.recording; a sonobench\.estimates is needed"):
        read_estimates(forge(tmp_path / "r.mcap", [chunk(messages(1))]))


def test_a_file_replaced_between_reads_is_refused(small, tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(small)
    recording = open_recording(path)
    write_recording(path, log_samples.rendering(seed=3))
    with pytest.raises(LogError, match="has changed since it was opened"):
        list(recording.blocks())


def test_a_read_of_truth_touches_no_sample_chunk(small, tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(small)
    truth_sha = open_recording(path).truth_sha
    index = Log(path, PROFILE)._index
    numbers = {topic: number for number, topic in index.channels.items()}
    (hit,) = [c for c in index.chunks if numbers["/array/vector/samples"] in c.message_index_offsets]
    broken = bytearray(small)
    broken[hit.chunk_start_offset + 60] ^= 1
    path.write_bytes(broken)
    damaged = open_recording(path)
    assert damaged.truth_sha == truth_sha
    assert len(list(damaged.scans())) == 2
    with pytest.raises(LogError, match="damaged"):
        list(damaged.blocks())


def _rewritten(source, path, change):
    """The messages of a recording through `change`, written anew."""
    log = Log(source, PROFILE)
    with log_writer(path, PROFILE) as out:
        out.attach("provenance.json", log.attachment("provenance.json"))
        for message in change(list(log.messages())):
            out.add(message[0], "SampleBlock", *message[1:])
    return path


def test_inconsistent_recordings_are_refused(small, tmp_path):
    source = tmp_path / "a.mcap"
    source.write_bytes(small)
    samples = "/array/vector/samples"
    wrong = {
        rate: encode_samples(Samples("vector", 0, rate, np.zeros((4, channels), np.float32))) for rate, channels in [(8.0, 4), (400.0, 3)]
    }
    stranger = encode_samples(Samples("stranger", 0, 400.0, np.zeros((4, 4), np.float32)))
    cases = {
        "4 channels at 8 Hz, array vector has 4 at 400 Hz": lambda all_: [(t, n, wrong[8.0] if t == samples else d) for t, n, d in all_],
        "3 channels at 400 Hz": lambda all_: [(t, n, wrong[400.0] if t == samples else d) for t, n, d in all_],
        "samples of 'stranger'": lambda all_: [(t, n, stranger if t == samples else d) for t, n, d in all_],
        "out of order": lambda all_: [m for m in all_ if m[0] != samples] + [m for m in all_ if m[0] == samples][::-1],
        "0 messages on /header": lambda all_: [m for m in all_ if m[0] != "/header"],
        "0 messages on /truth/targets": lambda all_: [m for m in all_ if m[0] != "/truth/targets"],
        "truth has 0 of 2 frames": lambda all_: [m for m in all_ if m[0] != "/truth/tracks"],
        "source 'talker' do not fit": lambda all_: [m for m in all_ if not (m[0] == "/source/talker/samples" and m[1] == 0)],
    }
    for said, change in cases.items():
        path = _rewritten(source, tmp_path / "b.mcap", change)
        with pytest.raises(LogError, match=said):
            _everything(path)


def test_equal_content_in_other_chunks_has_equal_hashes(small, tmp_path):
    source = tmp_path / "a.mcap"
    source.write_bytes(small)
    mixed = _rewritten(source, tmp_path / "b.mcap", lambda all_: sorted(all_, key=lambda m: m[1]))
    a, b = open_recording(source), open_recording(mixed)
    assert (a.input_sha, a.truth_sha, a.content_sha) == (b.input_sha, b.truth_sha, b.content_sha)
    assert source.read_bytes() != mixed.read_bytes()
