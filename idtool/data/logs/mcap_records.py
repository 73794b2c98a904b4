"""MCAP records: from a file to buffers of complete records, and the messages and definitions in each buffer.

A record is an opcode (1 byte), its content's length (8 bytes) and its content, all little-endian. Messages are
in the file one by one, or in chunks, which may be compressed. All other records are skipped; indexes and statistics are
not used, so they may be missing.
Source: mcap.dev/spec
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from idtool.common.arrays import Indices, indices_by_value, items_at
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import LogError
from idtool.common.threads import Job, evaluated_ahead
from idtool.data.logs.sample_buffer import Samples
from idtool.data.logs.size_limits import check_expanded_size

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK = map(int, (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK))

_MAX_BYTES = 1 << 28  # of a chunk or a message
_BATCH = 4096  # messages decoded together
_PAGE = 1 << 16  # bytes read at a time, from the end
_MIN_ZEROS = 1024  # at the end of a file that count as padding
_LOOSE_BYTES = 1 << 20  # of records outside chunks in one buffer
_LOOK_AHEAD_BYTES = 8 << 20  # of chunks that are decompressed while the ones before are decoded
_BYTES_PER_OFFSET = 3  # of records for each byte that the offsets of the shortest messages take
_FIRST_RUN = 16  # messages that are first looked at for one length

RECORD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")  # start and end time, uncompressed size, CRC, length of the compression's name
_MAX_COMPRESSION_NAME = 16  # bytes
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
_RECORD_HEAD = np.dtype([("opcode", "u1"), ("length", "<u8")])


@dataclass(frozen=True)
class ChannelMessages:
    """Messages of one channel in a buffer.

    Attributes
    ----------
    index
        Their positions among the messages of the batch, ascending, shape (k,).
    starts, lengths
        Offsets of their payloads in the buffer, and their lengths, shape (k,) [bytes].
    log_time
        When they were logged, shape (k,) [ns].
    """

    index: Indices
    starts: Indices
    lengths: Indices
    log_time: NDArray[np.uint64]

    def stamp(self, samples: Samples) -> Samples:
        """Samples decoded from these messages; those without a stamp, whose time is 0, get their log time."""
        has_no_stamp = samples.t == 0
        if not has_no_stamp.any():
            return samples
        seconds, nanoseconds = np.divmod(self.log_time[samples.index], np.uint64(10**9))
        return replace(samples, t=np.where(has_no_stamp, seconds + nanoseconds / 1e9, samples.t))


@dataclass(frozen=True)
class RecordBatch:
    """Records of one buffer.

    Attributes
    ----------
    buffer
        The bytes of the records.
    definitions
        Offsets of the schemas and channels.
    messages
        Offsets of the messages, ascending, shape (k,).
    """

    buffer: bytes
    definitions: list[int]
    messages: Indices

    @cached_property
    def channels(self) -> Mapping[int, ChannelMessages]:
        """The messages of each channel, by its id, ascending."""
        heads = items_at(self.buffer, self.messages, HEAD)
        channels = {}
        for channel, index in indices_by_value(heads["channel"]):
            starts = self.messages[index] + HEAD.itemsize
            lengths = heads["length"][index].astype(np.intp) - MESSAGE_FIELDS
            channels[channel] = ChannelMessages(index, starts, lengths, heads["log_time"][index])
        return channels


@dataclass(frozen=True)
class _Buffer:
    """A run of records.

    Attributes
    ----------
    start
        Offset in the file.
    data
        Bytes of the records.
    is_complete
        False if the last record is cut off.
    """

    start: int
    data: bytes
    is_complete: bool = True


class McapRecords:
    """The data section of an MCAP file.

    Iterating raises LogError where the file is damaged anywhere but at its truncated end. A thread decompresses chunks
    and finds their messages, a few chunks ahead of the records that are asked for.

    Parameters
    ----------
    path
        The file; errors name it.
    file
        The same file, open.
    size_on_disk
        Size of the file [bytes], which bounds the size that its chunks may expand to.

    Attributes
    ----------
    truncated
        True if the file was cut off in mid-write.
    """

    def __init__(self, path: Path, file: BinaryIO, size_on_disk: int) -> None:
        self._path = path
        self._file = file
        self._size_on_disk = size_on_disk
        self._end = _end_of_data(file)
        self._expanded = 0
        file.seek(max(0, self._end - len(MAGIC)))
        self.truncated = file.read(len(MAGIC)) != MAGIC or self._end < 2 * len(MAGIC)

    def __iter__(self) -> Iterator[RecordBatch]:
        for batches in evaluated_ahead(self._batches_of_buffers(), _LOOK_AHEAD_BYTES):
            yield from batches

    def _batches_of_buffers(self) -> Iterator[Job[list[RecordBatch]]]:
        """The batches of one buffer after the other, still to be made."""
        for job in self._buffers():
            offset_bytes = job.size // _BYTES_PER_OFFSET
            yield Job(job.size + offset_bytes, partial(self._batches, job.evaluate))

    def _batches(self, read_buffer: Callable[[], _Buffer]) -> list[RecordBatch]:
        """The records of a buffer."""
        records = read_buffer()
        buffer = records.data
        batches: list[RecordBatch] = []
        definitions: list[int] = []
        messages: list[int] = []
        last_length = -1
        offset = 0
        while len(buffer) - offset >= RECORD.size:
            opcode, length = RECORD.unpack_from(buffer, offset)
            stride = RECORD.size + length
            next_offset = offset + stride
            if next_offset > len(buffer):
                break
            if opcode == MESSAGE:
                if length < MESSAGE_FIELDS:
                    raise self._damage_error(records.start)
                if length == last_length:
                    count = _messages_of_length(buffer, offset, length, _BATCH - len(messages))
                    next_offset = offset + count * stride
                messages.extend(range(offset, next_offset, stride))
                last_length = length
                if len(messages) == _BATCH:
                    batches.append(RecordBatch(buffer, definitions, np.array(messages)))
                    definitions, messages = [], []
            elif opcode in (SCHEMA, CHANNEL):
                definitions.append(offset)
            offset = next_offset
        if records.is_complete and offset != len(buffer):
            raise self._damage_error(records.start)
        if definitions or messages:
            batches.append(RecordBatch(buffer, definitions, np.array(messages, dtype=np.intp)))
        return batches

    def _buffers(self) -> Iterator[Job[_Buffer]]:
        """Runs of records, chunks still to be decompressed."""
        loose = bytearray()  # records outside chunks
        loose_start = 0
        offset = self._file.seek(len(MAGIC))
        while offset + RECORD.size <= self._end:  # beyond it there may be padding of the file system
            head = self._file.read(RECORD.size)
            opcode, length = RECORD.unpack(head)
            offset += RECORD.size
            available = min(length, self._end - offset)
            is_complete = available == length
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                break
            if opcode == 0 or not (is_complete or self.truncated):
                raise self._damage_error(offset)
            if opcode == CHUNK:
                if loose:
                    yield _loose_records(loose_start, loose)
                    loose.clear()
                yield self._chunk(offset, available, is_complete)
            elif opcode in (SCHEMA, CHANNEL, MESSAGE) and is_complete:
                self._check_size(offset, length)
                if not loose:
                    loose_start = offset
                loose += head + self._file.read(length)
            if not is_complete:
                break
            offset = self._file.seek(offset + length)
            if len(loose) >= _LOOSE_BYTES:
                yield _loose_records(loose_start, loose)
                loose.clear()
        if loose:
            yield _loose_records(loose_start, loose)

    def _chunk(self, offset: int, available: int, is_complete: bool) -> Job[_Buffer]:
        """The records of a chunk with ``available`` bytes; of a truncated one, as many as possible."""
        nothing = Job(0, partial(_Buffer, offset, b"", is_complete))
        head = self._file.read(min(available, _CHUNK.size + _MAX_COMPRESSION_NAME + 8))
        if len(head) < _CHUNK.size:
            if is_complete:
                raise self._damage_error(offset)
            return nothing
        _, _, size, crc, name_length = _CHUNK.unpack_from(head)
        data_start = _CHUNK.size + name_length + 8
        if len(head) < data_start:
            if is_complete:
                raise self._damage_error(offset)
            return nothing
        compression = head[_CHUNK.size : data_start - 8]
        compressed_size = int.from_bytes(head[data_start - 8 : data_start], "little")
        if is_complete and data_start + compressed_size > available:
            raise self._damage_error(offset)
        self._check_size(offset, max(size, compressed_size))
        self._expanded += size
        check_expanded_size(self._path, self._expanded, self._size_on_disk)
        self._file.seek(offset + data_start)
        data = self._file.read(min(compressed_size, available - data_start))

        def expand_records() -> _Buffer:
            try:
                records = expand(compression, data, size)
            except ValueError as error:
                if not is_complete:
                    return _Buffer(offset, b"", is_complete)
                raise LogError(self._path, f"has a chunk at byte {offset} that {error}") from None
            # a CRC of 0 means that there is none
            if is_complete and (len(records) != size or crc not in (0, zlib.crc32(records))):
                raise self._damage_error(offset)
            return _Buffer(offset, records, is_complete)

        return Job(size + len(data), expand_records)

    def _check_size(self, offset: int, size: int) -> None:
        if size > _MAX_BYTES:
            raise LogError(
                self._path,
                f"has a record of {size / 2**20:.0f} MiB at byte {offset}; the limit is {_MAX_BYTES >> 20} MiB. "
                "Write it with smaller chunks",
            )

    def _damage_error(self, offset: int) -> LogError:
        return LogError(self._path, f"is damaged near byte {offset}; try 'mcap recover' on it")


def _loose_records(start: int, records: bytearray) -> Job[_Buffer]:
    """Records outside chunks."""
    data = bytes(records)
    return Job(len(data), partial(_Buffer, start, data))


def _messages_of_length(buffer: bytes, offset: int, length: int, most: int) -> int:
    """Length of the run of messages of one ``length`` that begins at ``offset``, up to ``most``."""
    stride = RECORD.size + length
    most = min(most, (len(buffer) - offset) // stride)
    heads = np.ndarray(most, _RECORD_HEAD, buffer, offset, strides=(stride,))
    count = 1
    looked_at = _FIRST_RUN
    while count < most:
        following = heads[count : count + looked_at]
        is_same = (following["opcode"] == MESSAGE) & (following["length"] == length)
        if not is_same.all():
            return count + int(np.argmin(is_same))
        count += len(following)
        looked_at *= 4  # so that the work is in proportion to the messages found
    return most


def _end_of_data(file: BinaryIO) -> int:
    """The file's size without zeros at its end, which a file system leaves in place of data that were not written."""
    size = file.seek(0, 2)
    start = size
    used = 0
    while start and not used:
        stop = start
        start = max(0, start - _PAGE)
        file.seek(start)
        used = len(file.read(stop - start).rstrip(b"\0"))
    end = start + used
    return end if size - end >= _MIN_ZEROS else size  # the last message may end in a few zeros, too


def expand(compression: bytes, data: bytes, size: int) -> bytes:
    """Decompressed data, at most ``size`` bytes; fewer if ``data`` is truncated.

    Raises
    ------
    ValueError
        If the data are damaged, or the compression is not supported.
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
    raise ValueError(f"has the unsupported compression {compression.decode(errors='replace')!r}; use lz4, zstd or none")
