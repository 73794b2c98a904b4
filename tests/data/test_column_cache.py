"""`ColumnCache`: what was used least recently goes first, and the memory that is left is counted."""

from __future__ import annotations

import numpy as np

from idtool.data.column_cache import ColumnCache, IdentityKey, KeptColumns

SIZE = 8 * 100  # bytes of one array


def arrays(value: float, count: int = 1) -> tuple[np.ndarray, ...]:
    return tuple(np.full(100, value) for _ in range(count))


def kept(cache: ColumnCache, keys: str) -> str:
    """Those of the keys that are there, without a use of them."""
    return "".join(key for key in keys if key in cache._columns)


def test_what_was_used_least_recently_is_forgotten() -> None:
    cache = ColumnCache(3 * SIZE)
    for key in "abc":
        cache.keep(key, arrays(ord(key)))
    assert kept(cache, "abc") == "abc"
    found = cache.find("a")
    assert found is not None
    assert found[0][0] == ord("a")
    cache.keep("d", arrays(1.0))
    assert kept(cache, "abcd") == "acd"
    cache.keep("e", arrays(2.0, count=2))
    assert kept(cache, "abcde") == "de"
    assert cache.find("a") is None


def test_memory_that_was_freed_can_be_used_again() -> None:
    cache = ColumnCache(2 * SIZE)
    for k in range(50):
        cache.keep(k, arrays(k))
    assert list(cache._columns) == [48, 49]
    assert cache._bytes == 2 * SIZE


def test_what_is_larger_than_the_memory_is_evaluated_every_time() -> None:
    q, v, a = np.zeros((3, 1, 100))
    columns = KeptColumns(ColumnCache(SIZE), 0, q, v, a)
    calls = []

    def evaluate() -> tuple[np.ndarray, ...]:
        calls.append(len(calls))
        return arrays(len(calls), count=2)

    assert columns.get("large", evaluate)[0][0] == 1
    assert columns.get("large", evaluate)[0][0] == 2
    assert columns.get("small", lambda: arrays(7.0))[0][0] == 7
    assert columns.get("small", lambda: arrays(8.0))[0][0] == 7


def test_batches_and_owners_do_not_share_columns() -> None:
    cache = ColumnCache(10 * SIZE)
    q, v, a = np.zeros((3, 1, 100))
    first, second = KeptColumns(cache, 0, q, v, a), KeptColumns(cache, 1, q, v, a)
    owner, twin = [0], [0]
    for columns, key, value in ((first, owner, 1.0), (first, twin, 2.0), (second, owner, 3.0)):
        assert columns.get(IdentityKey(key), lambda value=value: arrays(value))[0][0] == value
    assert first.get(IdentityKey(owner), lambda: arrays(9.0))[0][0] == 1
    assert not first.are_along(q.copy(), v, a)
    assert first.are_along(q, v, a)


def test_columns_along_the_same_corrected_motion_are_shared() -> None:
    """It is the same if its numbers are, however it came about, and of the same batch."""
    cache = ColumnCache(10 * SIZE)
    q, v, a = np.zeros((3, 1, 100))
    deflection = np.ones((3, 100))
    first, second = KeptColumns(cache, 0, q, v, a), KeptColumns(cache, 1, q, v, a)
    along = first.along(q + 0.1, v, a, [deflection])
    assert not along.are_along(q, v, a)
    assert along.get("x", lambda: arrays(1.0))[0][0] == 1
    assert first.along(q + 0.1, v.copy(), a, [deflection]).find("x") is not None
    for other in (
        first,
        first.along(q + 0.2, v, a, [deflection]),
        first.along(q + 0.1, v, a, [2 * deflection]),
        first.along(q + 0.1, v, a),
        second.along(q + 0.1, v, a, [deflection]),
    ):
        assert other.find("x") is None
