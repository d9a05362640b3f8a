"""Files that are there whole or not at all."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sonobench.errors import InputError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` that takes its place when the block ends well, and is removed when it does not.

    Raises:
        InputError: the folder is missing or cannot be written.
    """
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def no_room(error: BaseException | None) -> bool:
    """Whether an error, or what it comes from, is a disk that is full or cannot be written: nobody's code is at fault."""
    if error is None:
        return False
    return (isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EROFS)) or no_room(error.__cause__)


def is_temporary(path: Path) -> bool:
    """Whether a killed process left this behind within `replacing`."""
    return path.name.startswith(".") and path.name.endswith(".tmp")


def temporaries(folder: Path) -> list[Path]:
    """What killed processes left behind in a folder, and what others are writing there at this moment."""
    return list(folder.glob(".*.tmp"))


def replace_file(path: Path, content: bytes) -> None:
    """Write `content` to `path` atomically."""
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
