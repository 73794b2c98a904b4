"""MCAP records: from a file to buffers of whole records, and from a buffer to the records that matter.

A record is an opcode (1 byte), its content's length (8 bytes) and its content, all little-endian. Messages stand in
the file one by one, or in chunks, which may be compressed. Everything else is passed over; indexes and statistics are
not trusted, so it does not matter whether they are there.
Source: mcap.dev/spec
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from idtool.common.arrays import Indices
from idtool.common.exceptions import LogError

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK = map(int, (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK))

_MOST_BYTES = 1 << 28  # of a chunk or a message
_MOST_EXPANSION = 256  # of a file, by its chunks' compression
_BATCH = 4096  # messages decoded together
_PAGE = 1 << 16  # bytes looked at together, from the end
_FEWEST_ZEROS = 1024  # that are not the end of a message
_LOOSE_BYTES = 1 << 20  # of records outside chunks, taken together

RECORD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")  # start and end time, uncompressed size, CRC, length of the compression's name
_LONGEST_NAME = 16  # of a compression
HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
MESSAGE_FIELDS = HEAD.itemsize - RECORD.size


@dataclass(frozen=True)
class Batch:
    """Records of one buffer.

    Attributes
    ----------
    buffer
        The bytes that they stand in.
    definitions
        Where the schemas and channels begin.
    messages
        Where the messages begin, shape (k,).
    """

    buffer: bytes
    definitions: list[int]
    messages: Indices

    @property
    def heads(self) -> NDArray[np.void]:
        """What stands before the contents of the messages, shape (k,), k > 0, of type `HEAD`."""
        places = np.ndarray(len(self.buffer) - HEAD.itemsize + 1, HEAD, self.buffer, strides=(1,))
        return places[self.messages]


class Records:
    """The data section of an MCAP file.

    Iterating raises LogError where the file is damaged elsewhere than at its cut-off end.

    Parameters
    ----------
    path
        The file; errors name it.
    file
        The same, open.
    stored
        Size of what it takes on the disk [bytes], by which what its chunks expand to is bounded.

    Attributes
    ----------
    cut
        Whether the file was cut off in mid-write.
    """

    def __init__(self, path: Path, file: BinaryIO, stored: int) -> None:
        self._path = path
        self._file = file
        self._stored = stored
        self._size = _written(file)
        self._expanded = 0
        file.seek(max(0, self._size - len(MAGIC)))
        self.cut = file.read(len(MAGIC)) != MAGIC or self._size < 2 * len(MAGIC)

    def __iter__(self) -> Iterator[Batch]:
        for start, buffer, whole in self._buffers():
            definitions: list[int] = []
            messages: list[int] = []
            at, end = 0, len(buffer)
            while end - at >= RECORD.size:
                opcode, length = RECORD.unpack_from(buffer, at)
                following = at + RECORD.size + length
                if following > end:
                    break
                if opcode == MESSAGE:
                    if length < MESSAGE_FIELDS:
                        raise self._damaged(start)
                    messages.append(at)
                    if len(messages) == _BATCH:
                        yield Batch(buffer, definitions, np.array(messages))
                        definitions, messages = [], []
                elif opcode in (SCHEMA, CHANNEL):
                    definitions.append(at)
                at = following
            if whole and at != end:
                raise self._damaged(start)
            if definitions or messages:
                yield Batch(buffer, definitions, np.array(messages, dtype=np.intp))

    def _buffers(self) -> Iterator[tuple[int, bytes, bool]]:
        """Where they stand in the file, runs of records, and whether the last record is whole."""
        loose, start = bytearray(), 0
        at = self._file.seek(len(MAGIC))
        while at + RECORD.size <= self._size:  # what follows is what a file system leaves
            opcode, length = RECORD.unpack(head := self._file.read(RECORD.size))
            at += RECORD.size
            there = min(length, self._size - at)
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                break
            if opcode == 0 or (there < length and not self.cut):
                raise self._damaged(at)
            if opcode == CHUNK:
                if loose:
                    yield start, bytes(loose), True
                    loose.clear()
                yield at, self._chunk(at, there, there == length), there == length
            elif opcode in (SCHEMA, CHANNEL, MESSAGE) and there == length:
                self._bound(at, length)
                start = start if loose else at
                loose += head + self._file.read(length)
            if there < length:
                break
            at = self._file.seek(at + length)
            if len(loose) >= _LOOSE_BYTES:
                yield start, bytes(loose), True
                loose.clear()
        if loose:
            yield start, bytes(loose), True

    def _chunk(self, at: int, there: int, whole: bool) -> bytes:
        """The records in a chunk of which ``there`` bytes are there; of a cut one, those that can be had."""
        head = self._file.read(min(there, _CHUNK.size + _LONGEST_NAME + 8))
        named = _CHUNK.unpack_from(head)[-1] if len(head) >= _CHUNK.size else 0
        begin = _CHUNK.size + named + 8
        if len(head) < begin:
            if whole:
                raise self._damaged(at)
            return b""
        size = _CHUNK.unpack_from(head)[2]
        stored = int.from_bytes(head[begin - 8 : begin], "little")
        if whole and begin + stored > there:
            raise self._damaged(at)
        self._bound(at, max(size, stored))
        self._expanded += size
        if self._expanded > _MOST_EXPANSION * self._stored + _MOST_BYTES:
            raise LogError(
                self._path, f"expands to more than {_MOST_EXPANSION} times its size; it is no log of a robot"
            )
        self._file.seek(at + begin)
        data = self._file.read(min(stored, there - begin))
        try:
            records = expand(head[_CHUNK.size : begin - 8], data, size)
        except ValueError as error:
            if not whole:
                return b""
            raise LogError(self._path, f"has a chunk at byte {at} that {error}") from None
        crc = _CHUNK.unpack_from(head)[3]  # 0: none
        if whole and (len(records) != size or crc not in (0, zlib.crc32(records))):
            raise self._damaged(at)
        return records

    def _bound(self, at: int, size: int) -> None:
        if size > _MOST_BYTES:
            raise LogError(
                self._path,
                f"holds {size / 2**20:.0f} MiB in one piece at byte {at}; at most {_MOST_BYTES >> 20} MiB are read, "
                "so write it with smaller chunks",
            )

    def _damaged(self, at: int) -> LogError:
        return LogError(self._path, f"is damaged near byte {at}; try 'mcap recover' on it")


def _written(file: BinaryIO) -> int:
    """The file's size without the zeros at its end, which are what a file system leaves of what was not written."""
    size = file.seek(0, 2)
    start, held = size, 0
    while start and not held:
        stop, start = start, max(0, start - _PAGE)
        file.seek(start)
        held = len(file.read(stop - start).rstrip(b"\0"))
    return start + held if size - start - held >= _FEWEST_ZEROS else size  # a last value may be zero, too


def expand(compression: bytes, data: bytes, size: int) -> bytes:
    """Up to ``size`` bytes of what was compressed; fewer where ``data`` is not all of it.

    Raises
    ------
    ValueError
        If the data are damaged, or the compression is not known.
    """
    if compression == b"":
        return data[:size]
    if compression == b"zstd":
        import zstandard

        try:
            return zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True).read(size)
        except zstandard.ZstdError:
            raise ValueError("is damaged (zstd)") from None
    if compression == b"lz4":
        import lz4.frame

        try:
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size))
        except RuntimeError:
            raise ValueError("is damaged (lz4)") from None
    raise ValueError(f"is compressed with {compression.decode(errors='replace')!r}; lz4, zstd and none are read")
