"""Evaluations in threads, for work that lets other threads run meanwhile: linear algebra, decompression, hashes.

Threads share their memory, unlike the copies of a process in `processes`. They are of no use for what Python itself
evaluates. The linear algebra libraries have threads of their own, which are of no use for many small matrices.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial, wraps
from threading import Event, local
from types import TracebackType
from typing import Generic, NoReturn, ParamSpec, TypeVar

from idtool.common.dataclass import dataclass
from idtool.common.memory import share_freed_memory
from idtool.common.processes import process_count

Item = TypeVar("Item")
Result = TypeVar("Result")
P = ParamSpec("P")

_LEAST_WORK = 1 << 20  # entries of all items together, for which threads are worth their start
_MAX_WAITING = 64  # jobs evaluated in advance, however small

_this_thread = local()  # is_worker: true in the threads of `in_threads`


def with_single_threaded_blas(function: Callable[P, Result]) -> Callable[P, Result]:
    """Decorator that limits the linear algebra libraries to one thread while a function runs.

    Its matrices are many and small, and it uses the processor cores itself: more threads would wait for each other.
    """

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> Result:
        import scipy.linalg  # noqa: F401  # it has a library of its own, which must be loaded to be limited
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return call


def in_threads(evaluate: Callable[[Item], Result], items: Sequence[Item], work: float = _LEAST_WORK) -> list[Result]:
    """Result of each item, in their order, evaluated in as many threads as processes may work at once.

    If it is called in one of these threads, it starts no others and evaluates all items there. Otherwise the number of
    threads would be the square of the number of cores.

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
    if count < 2 or work < _LEAST_WORK or getattr(_this_thread, "is_worker", False):
        return [evaluate(item) for item in items]
    share_freed_memory()
    with ThreadPoolExecutor(count, initializer=_mark_as_worker) as pool:
        return list(pool.map(evaluate, items))


def _mark_as_worker() -> None:
    _this_thread.is_worker = True


@dataclass(frozen=True)
class Job(Generic[Result]):
    """An evaluation that may take place in another thread.

    Attributes
    ----------
    size
        Memory that it and its result take [bytes].
    evaluate
        Function that gives the result.
    """

    size: int
    evaluate: Callable[[], Result]


def evaluated_ahead(jobs: Iterable[Job[Result]], max_size: int) -> Iterator[Result]:
    """Results of jobs, in their order; those that come next are evaluated in a thread in the meantime.

    Errors of the jobs, and of their iterator, are raised where the result would have been.

    Parameters
    ----------
    jobs
        The jobs.
    max_size
        Jobs are evaluated in advance until they take this much memory [bytes]. The last of them may exceed it, so that
        less than twice as much is taken. A job that takes more by itself is evaluated when its turn comes.
    """
    if process_count() == 1:
        for job in jobs:
            yield job.evaluate()
        return
    pool = ThreadPoolExecutor(1)
    started = _started(jobs, pool, max_size)
    waiting: deque[tuple[int, Callable[[], Result]]] = deque()
    waiting_size = 0
    try:
        while True:
            while len(waiting) < _MAX_WAITING and waiting_size < max_size:
                begun = next(started, None)
                if begun is None:
                    break
                waiting.append(begun)
                waiting_size += begun[0]
            if not waiting:
                return
            size, result = waiting.popleft()
            waiting_size -= size
            yield result()
    finally:
        pool.shutdown(cancel_futures=True)


def _started(
    jobs: Iterable[Job[Result]], pool: ThreadPoolExecutor, max_size: int
) -> Iterator[tuple[int, Callable[[], Result]]]:
    """Size of each job and function that gives its result; an error of the iterator is raised by the last one."""
    try:
        for job in jobs:
            if job.size > max_size:
                yield job.size, job.evaluate
            else:
                yield job.size, pool.submit(job.evaluate).result
    except Exception as error:  # its turn comes after the jobs before it
        yield 0, partial(_raise, error)


def _raise(error: Exception) -> NoReturn:
    raise error


class BackgroundThread(Generic[Result]):
    """An evaluation that begins in a thread at once; with a single process, when its result is asked for.

    Parameters
    ----------
    evaluate
        Called with a function that is true once the result is no longer needed, so that it may end early.
    """

    def __init__(self, evaluate: Callable[[Callable[[], bool]], Result]) -> None:
        self._must_end = Event()
        self._evaluate = partial(evaluate, self._must_end.is_set)
        self._pool = ThreadPoolExecutor(1) if process_count() > 1 else None
        self._future = self._pool.submit(self._evaluate) if self._pool is not None else None

    def result(self) -> Result:
        """Result of the evaluation; raises what it raises."""
        return self._evaluate() if self._future is None else self._future.result()

    def __enter__(self) -> BackgroundThread[Result]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the thread, if it has not ended by itself."""
        self._must_end.set()
        if self._pool is not None:
            self._pool.shutdown()
