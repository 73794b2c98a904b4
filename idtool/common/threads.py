"""Evaluations in threads, for linear algebra on large matrices: numpy lets other threads run meanwhile.

Threads share their memory, unlike the copies of a process in `processes`. They are of no use for what Python itself
evaluates.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from idtool.common.memory import share_freed_memory
from idtool.common.processes import process_count

Item = TypeVar("Item")
Result = TypeVar("Result")

_LEAST_WORK = 1 << 20  # entries of all items together, for which threads are worth their start


def in_threads(evaluate: Callable[[Item], Result], items: Sequence[Item], work: float = _LEAST_WORK) -> list[Result]:
    """Result of each item, in their order, evaluated in as many threads as processes may work at once.

    Parameters
    ----------
    evaluate
        Function of an item, most of whose time is spent in numpy on large arrays.
    items
        The items.
    work
        Number of entries of all matrices together; if they are few, there is one thread.
    """
    count = min(process_count(), len(items))
    if count < 2 or work < _LEAST_WORK:
        return [evaluate(item) for item in items]
    share_freed_memory()
    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(evaluate, items))
