"""`Series`: samples gathered piece by piece into arrays that grow in place, the joints matched by name.

Signals as in `idtool.data.logs.log`; N samples, nj joints, each as many as there are so far.
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

_MOST_JOINTS = 512  # a joint takes room in every sample, so a file must not name them without end
_MOST_EMPTY = 16, 1 << 24  # values in the arrays for each that a sample gave, and beside those
_SPARE_BYTES = 1 << 21  # room to grow into, per array, of a long log


@dataclass(frozen=True)
class Samples:
    """Samples of the same joints.

    Attributes
    ----------
    index
        Their places among the samples that were read together, ascending, shape (k,).
    t
        Time [s], shape (k,).
    joints
        Names of the joints.
    signals
        Signal to values in the log's units, each of shape (k, len(joints)).
    """

    index: Indices
    t: Array
    joints: tuple[str, ...]
    signals: Mapping[str, NDArray[np.floating]]


class Series:
    """Samples in the order they came, parts in the order of their times. Values that no sample gave are NaN.

    Parameters
    ----------
    path
        The log they come from; errors name it.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._size = 0
        self._given = 0  # values
        self._parts: list[int] = []
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
            If the names of joints go on without end, or each sample holds but few of them.
        """
        pieces = [piece for piece in pieces if piece.joints]
        if not pieces:
            return
        start, self._size = self._size, self._size + sum(len(piece.t) for piece in pieces)
        self._given += sum(len(piece.t) * len(piece.joints) * len(piece.signals) for piece in pieces)
        self._admit(pieces)
        self._reserve(self._size)
        for array in self._signals.values():
            array[start : self._size] = np.nan
        for piece, rows in zip(pieces, _places(pieces, start), strict=True):
            self._t[rows] = piece.t
            block: Any = rows
            if piece.joints != tuple(self._columns):
                columns = np.array([self._columns[joint] for joint in piece.joints])
                block = (rows, columns) if isinstance(rows, slice) else np.ix_(rows, columns)
            for name, values in piece.signals.items():
                self._signals[name][block] = values

    def part(self) -> None:
        """What is added from now on is a part of its own, as the next file is of a log in several."""
        self._parts.append(self._size)

    def held(self, part: int) -> tuple[int, float]:
        """How many samples a part has, and the time of its last [s], NaN without one; before `arrays` alone."""
        start, stop = [*self._parts, self._size][part : part + 2]
        return stop - start, float(self._t[stop - 1]) if stop > start else np.nan

    def arrays(self) -> tuple[Array, tuple[str, ...], dict[str, Array]]:
        """Times (N,), joints, and signals (N, nj), without a copy; the series must not be added to after."""
        self._resize(self._size)
        self._sort()
        return self._t, tuple(self._columns), self._signals

    def _sort(self) -> None:
        """Put the parts in the order of their first samples, a column at a time, so that none is held twice."""
        bounds = [*sorted({0, *self._parts} - {self._size}), self._size]
        order = np.argsort(self._t[bounds[:-1]], kind="stable")
        if (np.diff(order) > 0).all():
            return
        for column in (self._t, *(column for array in self._signals.values() for column in array.T)):
            column[:] = np.concatenate([column[bounds[i] : bounds[i + 1]] for i in order])

    def _admit(self, pieces: Sequence[Samples]) -> None:
        """Make room for what is new in pieces that `_size` and `_given` count already."""
        joints = dict.fromkeys(joint for piece in pieces for joint in piece.joints)
        new = [joint for joint in joints if joint not in self._columns]
        count = len(self._columns) + len(new)
        if count > _MOST_JOINTS:
            raise LogError(self._path, f"names more than {_MOST_JOINTS} joints; is this a log of one robot?")
        names = self._signals.keys() | {name for piece in pieces for name in piece.signals}
        times, beside = _MOST_EMPTY
        if self._size * count * len(names) > times * self._given + beside:
            what = f"names {count} joints, of which a message holds but few; is this a log of one robot?"
            raise LogError(self._path, what)
        if new:
            self._columns |= {joint: len(self._columns) + i for i, joint in enumerate(new)}
            for name, array in self._signals.items():
                self._signals[name] = np.pad(array, ((0, 0), (0, len(new))), constant_values=np.nan)
        for name in (name for piece in pieces for name in piece.signals):
            if name not in self._signals:
                self._signals[name] = np.full((len(self._t), count), np.nan)

    def _reserve(self, size: int) -> None:
        if size > len(self._t):
            spare = min(size, _SPARE_BYTES // (8 * len(self._columns)))
            self._resize(size + max(spare, size >> 6))

    def _resize(self, size: int) -> None:
        # in place, so that an array is never held twice; nothing else refers to them
        self._t.resize(size, refcheck=False)
        for array in self._signals.values():
            array.resize((size, array.shape[1]), refcheck=False)


def _places(pieces: Sequence[Samples], start: int) -> Sequence[slice | Indices]:
    """Rows of each piece, the samples in the order of their `index`."""
    if len(pieces) == 1:
        return [slice(start, start + len(pieces[0].t))]
    rank = start + np.argsort(np.argsort(np.concatenate([piece.index for piece in pieces])))
    return np.split(rank, np.cumsum([len(piece.t) for piece in pieces])[:-1])
