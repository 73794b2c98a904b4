"""MCAP files as they lie on the disk: plain, or compressed as a whole with zstd, as rosbag2 does at its user's wish."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from idtool.common.exceptions import LogError
from idtool.data.logs.bag import MCAP, SQLITE, ZSTD, not_mcap
from idtool.data.logs.records import MAGIC, Records

_PIECE_BYTES = 1 << 20
_MOST_EXPANSION = 256  # of a file by its compression
_LEAST_BYTES = 1 << 28  # that a file may expand to, however small it is


@contextmanager
def records(path: Path) -> Iterator[Records]:
    """The records of an MCAP file. What is compressed is expanded into a temporary file.

    A file of which nothing was written counts as one that was cut off.

    Raises
    ------
    LogError
        If it is no MCAP file, or expands without end.
    """
    with path.open("rb") as file:
        if file.read(len(ZSTD)) != ZSTD:
            yield _checked(path, file)
            return
        file.seek(0)
        with tempfile.TemporaryFile() as whole:
            _expand(path, file, whole)
            yield _checked(path, whole)


def _checked(path: Path, file: BinaryIO) -> Records:
    file.seek(0)
    head = file.read(len(SQLITE))
    if head.startswith(SQLITE):
        raise LogError(path, not_mcap(path, "sqlite3"))
    if head.strip(b"\0") and not head.startswith(MAGIC):
        what = "is MCAP of an unknown version; convert it with the mcap command line tool"
        raise LogError(path, what if head.startswith(MCAP) else "holds no MCAP; bags of other storage are not read")
    return Records(path, file, path.stat().st_size)


def _expand(path: Path, file: BinaryIO, whole: BinaryIO) -> None:
    """Write what a file holds, or the beginning that there is of a file that was cut off."""
    import zstandard

    most = _MOST_EXPANSION * path.stat().st_size + _LEAST_BYTES
    try:
        reader = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
        while piece := reader.read(_PIECE_BYTES):
            most -= whole.write(piece)
            if most < 0:
                raise LogError(path, f"expands to more than {_MOST_EXPANSION} times its size; it is no log of a robot")
    except zstandard.ZstdError:
        raise LogError(path, "is damaged (zstd); try 'zstd -d' on it") from None
