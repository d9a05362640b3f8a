"""Scans in a cache file: an .npz of byte strings and their ends, no pickle. Such a file may be deleted at any time."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from google.protobuf.message import DecodeError

from sonobench.errors import LogError
from sonobench.files import replacing
from sonobench.log.codec import decode, encode
from sonobench.types import Scan, Setup

_FORMAT = 1


def write_scans(path: Path | str, setup: Setup, scans: Iterable[Scan]) -> None:
    """Write a setup and its scans.

    Raises:
        ValueError: a scan holds a field other than a DelayTable or a DirectionSpectrum; nothing is written.
        InputError: the folder cannot be written.
    """
    frames = [encode("MeasurementFrame", scan) for scan in scans]
    with replacing(Path(path)) as temporary, open(temporary, "wb") as stream:
        np.savez(
            stream,
            format=np.array(_FORMAT),
            setup=np.frombuffer(encode("Setup", setup), np.uint8),
            ends=np.cumsum([len(f) for f in frames], dtype=np.int64),
            frames=np.frombuffer(b"".join(frames), np.uint8),
        )


def read_scans(path: Path | str) -> tuple[Setup, list[Scan]]:
    """What `write_scans` was given, bit for bit.

    Raises:
        LogError: the file is missing, of another format or damaged; delete it and compute the scans again.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            if stored["format"] != _FORMAT:
                raise LogError(f"{path}: scans of format {stored['format']}; this version reads {_FORMAT}; delete it")
            setup, frames, ends = stored["setup"].tobytes(), stored["frames"].tobytes(), stored["ends"].tolist()
        starts = [0, *ends[:-1]] if ends else []
        return decode("Setup", setup), [decode("MeasurementFrame", frames[a:b]) for a, b in zip(starts, ends, strict=True)]
    except FileNotFoundError:
        raise LogError(f"{path}: there is no such file") from None
    except (OSError, EOFError, ValueError, TypeError, KeyError, AttributeError, zipfile.BadZipFile, zlib.error, DecodeError) as error:
        raise LogError(f"{path}: not a file of scans, or damaged ({error}); delete it") from error
