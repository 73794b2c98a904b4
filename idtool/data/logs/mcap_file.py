"""MCAP files on disk: plain, or compressed as a whole with zstd, as rosbag2 does on request."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from idtool.common.exceptions import LogError
from idtool.data.logs.bag import MCAP, SQLITE, ZSTD, wrong_storage_message
from idtool.data.logs.mcap_records import MAGIC, McapRecords
from idtool.data.logs.size_limits import check_expanded_size

_BLOCK_BYTES = 1 << 20


@contextmanager
def open_mcap(path: Path) -> Iterator[McapRecords]:
    """The records of an MCAP file. A compressed file is first decompressed into a temporary one.

    A file of zeros only counts as truncated.

    Raises
    ------
    LogError
        If the file is not MCAP, or expands too far.
    """
    with path.open("rb") as file:
        if file.read(len(ZSTD)) != ZSTD:
            yield _open_checked(path, file)
            return
        file.seek(0)
        with tempfile.TemporaryFile() as decompressed:
            _decompress(path, file, decompressed)
            yield _open_checked(path, decompressed)


def _open_checked(path: Path, file: BinaryIO) -> McapRecords:
    file.seek(0)
    head = file.read(len(SQLITE))
    if head.startswith(SQLITE):
        raise LogError(path, wrong_storage_message(path, "sqlite3"))
    if head.strip(b"\0") and not head.startswith(MAGIC):
        if head.startswith(MCAP):
            raise LogError(path, "is MCAP of an unknown version; convert it with the mcap command line tool")
        raise LogError(path, "is not an MCAP file")
    return McapRecords(path, file, path.stat().st_size)


def _decompress(path: Path, file: BinaryIO, output: BinaryIO) -> None:
    """Write the decompressed contents of a file; of a truncated one, as much as can be decompressed."""
    import zstandard

    size_on_disk = path.stat().st_size
    size = 0
    try:
        reader = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
        while block := reader.read(_BLOCK_BYTES):
            size += output.write(block)
            check_expanded_size(path, size, size_on_disk)
    except zstandard.ZstdError:
        raise LogError(path, "is damaged (zstd); try 'zstd -d' on it") from None
