"""`ColumnCache`: columns along the batches of logs, kept in bounded memory for the next model.

A search fits hundreds of models to the same logs, which differ in a term or two. What they share is evaluated and
filtered once.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable
from hashlib import blake2b
from typing import Generic, TypeVar

from typing_extensions import override

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass

_MAX_BYTES = 1 << 30

Owner = TypeVar("Owner")


class ColumnCache:
    """Arrays by key; where memory is short, those that were used least recently are forgotten.

    Parameters
    ----------
    max_bytes
        Memory that they may take.
    """

    def __init__(self, max_bytes: int = _MAX_BYTES) -> None:
        self._max_bytes = max_bytes
        self._bytes = 0
        self._columns: OrderedDict[Hashable, tuple[Array, ...]] = OrderedDict()

    def find(self, key: Hashable) -> tuple[Array, ...] | None:
        """Arrays of a key, which must not be changed; None if they are not there."""
        arrays = self._columns.get(key)
        if arrays is not None:
            self._columns.move_to_end(key)
        return arrays

    def keep(self, key: Hashable, arrays: tuple[Array, ...]) -> None:
        """Keep arrays under a key, in place of those it may have."""
        self._bytes -= _size(self._columns.pop(key, ()))
        self._columns[key] = arrays
        self._bytes += _size(arrays)
        while self._bytes > self._max_bytes and self._columns:
            _, forgotten = self._columns.popitem(last=False)
            self._bytes -= _size(forgotten)


@dataclass(frozen=True, eq=False)
class KeptColumns:
    """Columns along one motion, by what they are columns of.

    Attributes
    ----------
    cache
        The cache that holds them.
    motion
        Key of the motion.
    q, v, a
        The motion, shape (nv, N).
    """

    cache: ColumnCache
    motion: Hashable
    q: Array
    v: Array
    a: Array

    def are_along(self, q: Array, v: Array, a: Array) -> bool:
        """True if these are the very arrays of the motion."""
        return q is self.q and v is self.v and a is self.a

    def along(self, q: Array, v: Array, a: Array, others: Iterable[Array] = ()) -> KeptColumns:
        """Columns along a corrected motion of the batch, kept for all models whose correction is the same.

        Parameters
        ----------
        q, v, a
            The corrected motion, shape (nv, N).
        others
            What the columns depend on beside it.
        """
        digest = blake2b()
        for array in (q, v, a, *others):
            digest.update(array.tobytes())
        return KeptColumns(self.cache, (self.motion, digest.digest()), q, v, a)

    def find(self, key: Hashable) -> tuple[Array, ...] | None:
        """Arrays of a key, which must not be changed; None if they are not there."""
        return self.cache.find((self.motion, key))

    def keep(self, key: Hashable, arrays: tuple[Array, ...]) -> None:
        """Keep arrays under a key, in place of those it may have."""
        self.cache.keep((self.motion, key), arrays)

    def get(self, key: Hashable, evaluate: Callable[[], Iterable[Array]]) -> tuple[Array, ...]:
        """Arrays of a key, which must not be changed; evaluated if they are not there."""
        arrays = self.find(key)
        if arrays is None:
            arrays = tuple(evaluate())
            self.keep(key, arrays)
        return arrays


class IdentityKey(Generic[Owner]):
    """Key that is equal to another only if both are of the very same object.

    Parameters
    ----------
    owner
        The object; kept alive, so that no other one has the same id.
    """

    def __init__(self, owner: Owner) -> None:
        self.owner = owner

    @override
    def __hash__(self) -> int:
        return id(self.owner)

    @override
    def __eq__(self, other: object) -> bool:
        return isinstance(other, IdentityKey) and self.owner is other.owner


def _size(arrays: tuple[Array, ...]) -> int:
    return sum(array.nbytes for array in arrays)
