"""`SampleBuffer`: samples collected piece by piece in arrays that grow in place, with joints matched by name.

Signals as in `idtool.data.logs.log`; N samples and nj joints so far.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idtool.common.arrays import Array, Indices
from idtool.common.exceptions import LogError

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
        self._signals: dict[str, Array] = {}

    def __len__(self) -> int:
        return self._size

    def append(self, pieces: Sequence[Samples]) -> None:
        """Add samples that were read together.

        Raises
        ------
        LogError
            If there are too many joints, or each sample has only few of them.
        """
        pieces = [piece for piece in pieces if piece.joints]
        if not pieces:
            return
        start = self._size
        self._size += sum(len(piece.t) for piece in pieces)
        self._value_count += sum(len(piece.t) * len(piece.joints) * len(piece.signals) for piece in pieces)
        self._add_columns(pieces)
        self._reserve(self._size)
        for array in self._signals.values():
            array[start : self._size] = np.nan
        for piece, rows in zip(pieces, _target_rows(pieces, start), strict=True):
            self._t[rows] = piece.t
            block: Any = rows
            if piece.joints != tuple(self._columns):
                columns = np.array([self._columns[joint] for joint in piece.joints])
                block = (rows, columns) if isinstance(rows, slice) else np.ix_(rows, columns)
            for name, values in piece.signals.items():
                self._signals[name][block] = values

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
        return self._t, tuple(self._columns), self._signals

    def _sort_parts(self) -> None:
        """Put the parts in the order of their first times, column by column to save memory."""
        bounds = [*sorted({0, *self._part_starts} - {self._size}), self._size]
        order = np.argsort(self._t[bounds[:-1]], kind="stable")
        if (np.diff(order) > 0).all():
            return
        columns = [self._t]
        for array in self._signals.values():
            columns.extend(array.T)
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
        allocated = self._size * count * len(self._signals.keys() | names.keys())
        if allocated > _MAX_FILL * self._value_count + _FREE_VALUES:
            message = f"names {count} joints, but each message has only a few; is this a log of one robot?"
            raise LogError(self._path, message)
        if new_joints:
            for joint in new_joints:
                self._columns[joint] = len(self._columns)
            for name, array in self._signals.items():
                self._signals[name] = np.pad(array, ((0, 0), (0, len(new_joints))), constant_values=np.nan)
        for name in names:
            if name not in self._signals:
                self._signals[name] = np.full((len(self._t), count), np.nan)

    def _reserve(self, size: int) -> None:
        if size > len(self._t):
            spare = min(size, _SPARE_BYTES // (8 * len(self._columns)))
            self._resize(size + max(spare, size >> 6))

    def _resize(self, size: int) -> None:
        # in place, so that no array is ever in memory twice; nothing else refers to them
        self._t.resize(size, refcheck=False)
        for array in self._signals.values():
            array.resize((size, array.shape[1]), refcheck=False)


def _target_rows(pieces: Sequence[Samples], start: int) -> Sequence[slice | Indices]:
    """Rows of each piece, with the samples of all pieces in the order of their `index`."""
    if len(pieces) == 1:
        return [slice(start, start + len(pieces[0].t))]
    rank = start + np.argsort(np.argsort(np.concatenate([piece.index for piece in pieces])))
    return np.split(rank, np.cumsum([len(piece.t) for piece in pieces])[:-1])
