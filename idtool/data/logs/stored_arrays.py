"""Samples that are too many for memory: rows in a temporary file, and arrays that are mapped from it.

The file has no name, so that it vanishes with the last array of it. Pages of it that were touched count as memory of
this process until `release_pages` gives them back; the system then keeps or writes them as it sees fit.
"""

from __future__ import annotations

import mmap
import shutil
import tempfile
import weakref
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import LogError
from idtool.common.processes import process_count
from idtool.common.threads import in_threads

Result = TypeVar("Result")

MAX_BYTES = 64 << 20  # of the samples of all logs in memory; further ones are in temporary files
BLOCK_ROWS = 1 << 14  # rows that are worked on together
_MIB = 1 << 20

_counted: dict[int, weakref.ref[Array]] = {}  # arrays of logs that are in memory, by their ids


class StoredRows:
    """Rows of numbers in a temporary file that grows by appending.

    Parameters
    ----------
    path
        The log that the rows come from; errors name it.
    width
        Numbers in a row.

    Raises
    ------
    LogError
        If the temporary folder cannot be used.
    """

    def __init__(self, path: Path, width: int) -> None:
        self._path = path
        self._width = width
        self._count = 0
        try:
            self._file = tempfile.TemporaryFile(prefix="idtool_", buffering=0)  # noqa: SIM115  # closed below
        except OSError as error:
            raise self._storage_error(error, 0) from None
        weakref.finalize(self, self._file.close)

    def __len__(self) -> int:
        return self._count

    @property
    def width(self) -> int:
        """Numbers in a row."""
        return self._width

    def append(self, rows: Array) -> None:
        """Add rows, shape (k, width).

        Raises
        ------
        LogError
            If there is no room for them in the temporary folder.
        """
        if not len(rows):
            return
        data = np.ascontiguousarray(rows, dtype=np.float64).data.cast("B")
        written = 0
        try:
            while written < len(data):
                written += self._file.write(data[written:])
        except OSError as error:
            raise self._storage_error(error, len(data)) from None
        self._count += len(rows)

    def array(self) -> Array:
        """The rows, shape (N, width), N > 0, mapped from the file: changes of the array change the file."""
        size = 8 * self._width * self._count
        mapping = mmap.mmap(self._file.fileno(), size, access=mmap.ACCESS_WRITE)
        return np.ndarray((self._count, self._width), np.float64, mapping)

    def columns(self) -> Array:
        """The rows turned into contiguous columns of another file, shape (width, N), N > 0.

        Raises
        ------
        LogError
            If there is no room for it in the temporary folder.
        """
        rows = self.array()
        turned = StoredRows(self._path, 1)
        for column in rows.T:
            for part in blocks_of([rows], len(rows)):
                turned.append(column[part, None])
        return turned.array().reshape(self._width, self._count)

    def _storage_error(self, error: OSError, size: int) -> LogError:
        needed = (8 * self._width * self._count + size) / _MIB
        try:
            folder = tempfile.gettempdir()
            free = shutil.disk_usage(folder).free / _MIB
            place = f"the temporary folder {folder}, where {free:.0f} MiB are free"
        except OSError:
            place = "a temporary folder"
        reason = error.strerror or error
        what = f"needs more than {needed:.0f} MiB in {place} ({reason}); set TMPDIR to a folder with more space"
        return LogError(self._path, what)


class RowBuffer:
    """Rows of numbers that grow by appending: in memory or, if they are too many, in a temporary file.

    Parameters
    ----------
    path
        The log that the rows come from; errors name it.
    width
        Numbers in a row.
    """

    def __init__(self, path: Path, width: int) -> None:
        self._path = path
        self._width = width
        self._count = 0
        self._parts: list[Array] = []
        self._stored: StoredRows | None = None

    def __len__(self) -> int:
        return self._count

    def append(self, rows: Array) -> None:
        """Add rows, shape (k, width), which must not be changed afterwards.

        Raises
        ------
        LogError
            If there is no room for them in the temporary folder.
        """
        self._count += len(rows)
        if self._stored is not None:
            self._stored.append(rows)
            return
        self._parts.append(rows)
        if is_memory_full(8 * self._width * self._count):
            self._stored = StoredRows(self._path, self._width)
            for part in self._parts:
                self._stored.append(part)
            self._parts = []

    def array(self) -> Array:
        """The rows, shape (N, width)."""
        if self._stored is not None:
            return self._stored.array()
        return np.concatenate([np.empty((0, self._width)), *self._parts])

    def columns(self) -> Array:
        """The rows turned into contiguous columns, shape (width, N).

        Raises
        ------
        LogError
            If there is no room for them in the temporary folder.
        """
        return np.ascontiguousarray(self.array().T) if self._stored is None else self._stored.columns()


def copy_array(path: Path, array: Array) -> Array:
    """A copy of an array, shape (N, k): in a file if the array is in one.

    Parameters
    ----------
    path
        The log that the array is of; errors name it.
    array
        The array.

    Raises
    ------
    LogError
        If there is no room for it in the temporary folder.
    """
    if not is_in_file(array):
        return array.copy()
    rows = StoredRows(path, array.shape[1])
    for part in blocks_of([array], len(array)):
        rows.append(array[part])
    return rows.array()


def set_columns(array: Array, columns: Sequence[int], value: float) -> None:
    """Set some columns of an array, shape (N, k), to a value."""
    for part in blocks_of([array], len(array)):
        array[part, columns] = value


def column_ranges(array: Array) -> tuple[Array, Array]:
    """Least and greatest value of the columns of an array, shape (N, k), without NaN; shape (k,) each."""
    least = np.full(array.shape[1], np.nan)
    greatest = np.full(array.shape[1], np.nan)
    for columns in column_blocks(array):
        least = np.fmin(least, np.fmin.reduce(columns, axis=1))
        greatest = np.fmax(greatest, np.fmax.reduce(columns, axis=1))
    return least, greatest


def column_blocks(array: Array) -> Iterator[Array]:
    """Blocks of an array's rows, shape (N, k), copied to contiguous columns, shape (k, n).

    Along these, figures of columns are evaluated several times as fast, the copy included.
    """
    for rows in blocks_of([array], len(array)):
        yield array[rows].T.copy(order="C")


def blocks(count: int, most: int = BLOCK_ROWS) -> Iterator[slice]:
    """Slices of at most so many rows that are worked on together, of ``count`` rows in all."""
    for start in range(0, count, most):
        yield slice(start, min(start + most, count))


def blocks_of(arrays: Iterable[Array], count: int) -> Iterator[slice]:
    """`blocks` of the rows of arrays, after each of which their pages are released."""
    released = list(arrays)
    for rows in blocks(count):
        yield rows
        release_pages(released)


def evaluate_blocks(evaluate: Callable[[slice], Result], arrays: Iterable[Array], count: int) -> list[Result]:
    """Results of a function for blocks of the rows of arrays, evaluated in threads.

    The blocks of all threads together have `BLOCK_ROWS` rows, so that more threads do not take more memory.

    Parameters
    ----------
    evaluate
        Function of a slice of rows, most of whose time is spent in numpy.
    arrays
        What it reads; the pages are released after each block.
    count
        Number of rows.
    """
    released = list(arrays)

    def evaluate_one(rows: slice) -> Result:
        result = evaluate(rows)
        release_pages(released)
        return result

    work = sum(array.size for array in released)
    return in_threads(evaluate_one, list(blocks(count, max(BLOCK_ROWS // process_count(), 1))), work)


def release_pages(arrays: Iterable[Array]) -> None:
    """Give the memory back that was taken by reading or changing arrays in a file; their values stay.

    Arrays in memory are left alone, and so are all where the system has no such call.
    """
    if not hasattr(mmap, "MADV_DONTNEED"):
        return
    mappings = {id(mapping): mapping for array in arrays if (mapping := _mapping_of(array)) is not None}
    for mapping in mappings.values():
        mapping.madvise(mmap.MADV_DONTNEED)


def is_in_file(array: Array) -> bool:
    """True if an array, or the one that it is a part of, is mapped from a file."""
    return _mapping_of(array) is not None


def _mapping_of(array: Array) -> mmap.mmap | None:
    owner: object = array
    while isinstance(owner, np.ndarray):
        owner = owner.base
    return owner if isinstance(owner, mmap.mmap) else None


def count_arrays(arrays: Iterable[Array]) -> None:
    """Count arrays among those of logs in memory, as long as they are there; they can't be resized any more."""
    for array in arrays:
        if not is_in_file(array):
            _counted[id(array)] = weakref.ref(array)


def is_memory_full(size: int) -> bool:
    """True if further arrays of so many bytes, if any, make the logs in memory larger than `MAX_BYTES`."""
    total = size
    for key, reference in list(_counted.items()):
        array = reference()
        if array is None:
            del _counted[key]
        else:
            total += array.nbytes
    return size > 0 and total > MAX_BYTES
