"""`SampleBuffer`: samples collected piece by piece, with joints matched by name.

They are in arrays that grow in place or, if they are many, in a temporary file.

Signals as in `idtool.data.logs.log`; N samples and nj joints so far.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import LogError
from idtool.data.logs.stored_arrays import StoredRows, blocks, blocks_of, is_memory_full

MAX_JOINTS = 512  # a joint takes room in every sample, so a file must not name joints without end
_MAX_FILL = 16  # allocated values for each value that a sample has
_FREE_VALUES = 1 << 24  # allocated values that are always allowed
_SPARE_BYTES = 1 << 21  # room to grow for each array of a long log


@dataclass(frozen=True)
class Samples:
    """Samples of the same joints.

    Attributes
    ----------
    index
        Positions among the samples that were read together, ascending, shape (k,).
    t
        Time [s], shape (k,).
    joints
        Joint names.
    signals
        Signal to values in the log's units, each of shape (k, len(joints)).
    """

    index: Indices
    t: Array
    joints: tuple[str, ...]
    signals: Mapping[str, NDArray[np.floating]]


class SampleBuffer:
    """Samples in the order they were read, parts in the order of their times. Missing values are NaN.

    The signals are in memory until they are too many. They then move to a file with a row for each sample, in which
    the signals are one after the other; the times stay in memory.

    Parameters
    ----------
    path
        The log that the samples come from; errors name it.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._size = 0
        self._value_count = 0
        self._part_starts: list[int] = []
        self._t: Array = np.empty(0)
        self._columns: dict[str, int] = {}
        self._signals: dict[str, Array] = {}  # in a file, only their names are of use
        self._rows: StoredRows | None = None

    def __len__(self) -> int:
        return self._size

    def append(self, pieces: Sequence[Samples]) -> None:
        """Add samples that were read together.

        Raises
        ------
        LogError
            If there are too many joints, or each sample has only few of them, or the temporary folder is full.
        """
        pieces = [piece for piece in pieces if piece.joints]
        if not pieces:
            return
        start = self._size
        self._size += sum(len(piece.t) for piece in pieces)
        self._value_count += sum(len(piece.t) * len(piece.joints) * len(piece.signals) for piece in pieces)
        self._add_columns(pieces)
        self._reserve(self._size)
        if self._rows is None:
            self._write(pieces, self._t[start : self._size], _parts(self._signals, slice(start, self._size)))
            if is_memory_full(sum(array.nbytes for array in self._signals.values())):
                self._move_to_file()
        else:
            block = np.empty((self._size - start, self._rows.width))
            self._write(pieces, self._t[start : self._size], self._split(block))
            self._rows.append(block)

    def begin_part(self) -> None:
        """Start a new part, such as the next file of a log in several files."""
        self._part_starts.append(self._size)

    def part_extent(self, part: int) -> tuple[int, float]:
        """Number of samples of a part, and the time of its last one [s], NaN if empty; only before `arrays`."""
        start, stop = [*self._part_starts, self._size][part : part + 2]
        return stop - start, float(self._t[stop - 1]) if stop > start else np.nan

    def arrays(self) -> tuple[Array, tuple[str, ...], dict[str, Array]]:
        """Times (N,), joints, and signals (N, nj), without a copy; nothing may be appended afterwards."""
        self._resize(self._size)
        self._sort_parts()
        return self._t, tuple(self._columns), self._finished_signals()

    def signals_of(self, count: int) -> dict[str, Array]:
        """The signals of the first ``count`` samples, NaN where there are fewer; only after `arrays`.

        The signals that `arrays` returned must not be used any more.
        """
        kept = min(count, self._size)
        if self._rows is None:
            self._size = count
            self._resize(count)
            for array in self._signals.values():
                array[kept:] = np.nan
        elif count != self._size:
            rows = StoredRows(self._path, self._rows.width)
            _copy_rows(self._rows, slice(0, kept), rows)
            for part in blocks(count - kept):
                rows.append(np.full((part.stop - part.start, rows.width), np.nan))
            self._rows = rows
        return self._finished_signals()

    def _finished_signals(self) -> dict[str, Array]:
        return self._signals if self._rows is None else self._split(self._rows.array())

    def _write(self, pieces: Sequence[Samples], t: Array, signals: Mapping[str, Array]) -> None:
        """Write pieces to the times and signals of their samples, shapes (k,) and (k, nj)."""
        if not self._are_complete(pieces):
            for array in signals.values():
                array[:] = np.nan
        for piece, rows in zip(pieces, _target_rows(pieces), strict=True):
            t[rows] = piece.t
            block: Any = rows
            if piece.joints != tuple(self._columns):
                columns = np.array([self._columns[joint] for joint in piece.joints])
                block = (rows, columns) if isinstance(rows, slice) else np.ix_(rows, columns)
            for name, values in piece.signals.items():
                signals[name][block] = values

    def _are_complete(self, pieces: Sequence[Samples]) -> bool:
        """True if pieces have all joints and signals."""
        joints, count = self._columns.keys(), len(self._signals)
        return all(len(piece.signals) == count and set(piece.joints) == joints for piece in pieces)

    def _split(self, rows: Array) -> dict[str, Array]:
        """The signals in rows of the file, shape (k, nj) each."""
        count = len(self._columns)
        return {name: rows[:, i * count : (i + 1) * count] for i, name in enumerate(self._signals)}

    def _move_to_file(self) -> None:
        rows = StoredRows(self._path, len(self._signals) * len(self._columns))
        for part in blocks(self._size):
            rows.append(np.concatenate([array[part] for array in self._signals.values()], axis=1))
        self._rows = rows
        self._forget_arrays()

    def _forget_arrays(self) -> None:
        self._signals = dict.fromkeys(self._signals, np.empty((0, len(self._columns))))

    def _sort_parts(self) -> None:
        """Put the parts in the order of their first times, column by column or in a new file to save memory."""
        bounds = [*sorted({0, *self._part_starts} - {self._size}), self._size]
        order = np.argsort(self._t[bounds[:-1]], kind="stable")
        if (np.diff(order) > 0).all():
            return
        columns = [self._t]
        if self._rows is None:
            for array in self._signals.values():
                columns.extend(array.T)
        else:
            rows = StoredRows(self._path, self._rows.width)
            for i in order:
                _copy_rows(self._rows, slice(bounds[i], bounds[i + 1]), rows)
            self._rows = rows
        for column in columns:
            column[:] = np.concatenate([column[bounds[i] : bounds[i + 1]] for i in order])

    def _add_columns(self, pieces: Sequence[Samples]) -> None:
        """Add the joints and signals that are new in pieces; `_size` and `_value_count` already include them."""
        joints = dict.fromkeys(joint for piece in pieces for joint in piece.joints)
        new_joints = [joint for joint in joints if joint not in self._columns]
        count = len(self._columns) + len(new_joints)
        if count > MAX_JOINTS:
            raise LogError(self._path, f"names more than {MAX_JOINTS} joints; is this a log of one robot?")
        names = dict.fromkeys(name for piece in pieces for name in piece.signals)
        new_names = [name for name in names if name not in self._signals]
        allocated = self._size * count * (len(self._signals) + len(new_names))
        if allocated > _MAX_FILL * self._value_count + _FREE_VALUES:
            message = f"names {count} joints, but each message has only a few; is this a log of one robot?"
            raise LogError(self._path, message)
        if self._rows is not None and (new_joints or new_names):
            self._widen_rows(self._rows, new_joints, new_names)
            return
        if new_joints:
            self._name_joints(new_joints)
            for name, array in self._signals.items():
                self._signals[name] = np.pad(array, ((0, 0), (0, len(new_joints))), constant_values=np.nan)
        for name in new_names:
            self._signals[name] = np.full((len(self._t), count), np.nan)

    def _widen_rows(self, rows: StoredRows, new_joints: Sequence[str], new_names: Sequence[str]) -> None:
        """Move the samples to a file with further joints and signals."""
        array = rows.array()
        old_signals = self._split(array)
        self._name_joints(new_joints)
        self._signals |= dict.fromkeys(new_names, np.empty(0))
        self._forget_arrays()
        self._rows = StoredRows(self._path, len(self._signals) * len(self._columns))
        for part in blocks_of([array], len(array)):
            block = np.full((part.stop - part.start, self._rows.width), np.nan)
            signals = self._split(block)
            for name, old in old_signals.items():
                signals[name][:, : old.shape[1]] = old[part]
            self._rows.append(block)

    def _name_joints(self, new_joints: Sequence[str]) -> None:
        for joint in new_joints:
            self._columns[joint] = len(self._columns)

    def _reserve(self, size: int) -> None:
        if size > len(self._t):
            spare = min(size, _SPARE_BYTES // (8 * len(self._columns)))
            self._resize(size + max(spare, size >> 6))

    def _resize(self, size: int) -> None:
        # in place, so that no array is ever in memory twice; nothing else refers to them
        self._t.resize(size, refcheck=False)
        if self._rows is None:
            for array in self._signals.values():
                array.resize((size, array.shape[1]), refcheck=False)


def _parts(signals: Mapping[str, Array], rows: slice) -> dict[str, Array]:
    return {name: array[rows] for name, array in signals.items()}


def _copy_rows(source: StoredRows, rows: slice, target: StoredRows) -> None:
    """Append rows of a file to another one."""
    array = source.array()[rows]
    for part in blocks_of([array], len(array)):
        target.append(array[part])


def _target_rows(pieces: Sequence[Samples]) -> Sequence[slice | Indices]:
    """Rows of each piece, with the samples of all pieces in the order of their `index`."""
    if len(pieces) == 1:
        return [slice(0, len(pieces[0].t))]
    rank = np.argsort(np.argsort(np.concatenate([piece.index for piece in pieces])))
    return np.split(rank, np.cumsum([len(piece.t) for piece in pieces])[:-1])
