"""Evaluations in copies of this process, so that all processor cores are used."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import pickle
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Generic, TypeVar, cast

Item = TypeVar("Item")
Result = TypeVar("Result")
Progress = Callable[[str, float], None]

_most_processes: int | None = None
_PR_SET_PDEATHSIG = 1  # linux/prctl.h: signal that a process gets when its parent ends


def limit_processes(count: int | None) -> None:
    """Limit the number of processes that work at once; None: as many as there are processor cores."""
    global _most_processes  # it is a setting of the whole process
    _most_processes = count


def process_count() -> int:
    """Number of processes that can work at once.

    It is 1 where a process cannot be copied safely, as on macOS and Windows, and in a process that is a copy itself.
    """
    if not sys.platform.startswith("linux") or multiprocessing.current_process().daemon:
        return 1
    cores = len(os.sched_getaffinity(0))
    return cores if _most_processes is None else min(_most_processes, cores)


def interleaved_shares(count: int) -> list[range]:
    """Indices below a count in shares, one for each process: every n-th, since neighbours take about as long."""
    shares = min(process_count(), count)
    return [range(first, count, shares) for first in range(shares)]


def in_processes(
    evaluate: Callable[[Item, Progress], Result], items: Sequence[Item], progress: Progress
) -> list[Result]:
    """Result of each item, in their order; the first is evaluated in this process, the others in copies of it.

    Parameters
    ----------
    evaluate
        Function of an item and a callback for the progress; see `Background`.
    items
        The items, not many more than `process_count`.
    progress
        Callback for the stage and its progress, from 0 to 1, of the first item.
    """
    if not items:
        return []
    first, *others = items
    with ExitStack() as stack:
        copies = [stack.enter_context(Background(partial(evaluate, item))) for item in others]
        results = [evaluate(first, progress)]
        results += [copy.result(progress) for copy in copies]
    return results


def shared_among_processes(
    evaluate: Callable[[Item, Progress], Result], items: Sequence[Item], progress: Progress
) -> list[Result]:
    """Results of any number of items, in their order; each process evaluates its share, as in `in_processes`."""

    def evaluate_share(share: range, progress: Progress) -> list[Result]:
        return [evaluate(items[i], progress) for i in share]

    shares = interleaved_shares(len(items))
    by_index: dict[int, Result] = {}
    for share, results in zip(shares, in_processes(evaluate_share, shares, progress), strict=True):
        by_index.update(zip(share, results, strict=True))
    return [by_index[i] for i in range(len(items))]


class Background(Generic[Result]):
    """An evaluation in a copy of this process, begun at once; where there is none, when its result is asked for.

    A copy has all that this process has, so that only the result is sent. It must be possible to pickle. What fails in
    a copy is evaluated again here, so that the failure is raised as if there were no copies.

    Parameters
    ----------
    evaluate
        Function of a callback for the progress, which is that of `result`, or does nothing in a copy.
    """

    def __init__(self, evaluate: Callable[[Progress], Result]) -> None:
        self._evaluate = evaluate
        self._process = None
        if process_count() == 1:
            return
        self._receiver, sender = multiprocessing.Pipe(duplex=False)
        context = multiprocessing.get_context("fork")
        process = context.Process(target=_evaluate_and_send, args=(evaluate, sender, os.getpid()), daemon=True)
        with warnings.catch_warnings(), suppress(OSError):  # there is no memory for a copy
            # The other threads are a progress bar's, whose locks a copy does not use; one that compresses plotly.js and
            # holds no lock, and those of a linear algebra library, which prepares itself for the fork.
            warnings.simplefilter("ignore", DeprecationWarning)
            process.start()
            self._process = process
        sender.close()

    def result(self, progress: Progress) -> Result:
        """Result of the evaluation; raises what it raises.

        Parameters
        ----------
        progress
            Callback for the stage and its progress, from 0 to 1, if it is evaluated here.
        """
        if self._process is not None:
            with suppress(Exception):  # it failed, or its result cannot be read
                return cast("Result", _receive(self._receiver))
        return self._evaluate(progress)

    def __enter__(self) -> Background[Result]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the copy, if it has not ended by itself."""
        if self._process is not None:
            self._receiver.close()
            self._process.terminate()
            self._process.join()


def _evaluate_and_send(evaluate: Callable[[Progress], Result], sender: Connection, first_process: int) -> None:
    """Send the result, or nothing if the evaluation fails."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all processes, and the first one ends the others
    _end_with_parent(first_process)
    try:
        _send(sender, evaluate(no_progress))
    except BaseException:  # the first process finds the same
        os._exit(1)


def _send(sender: Connection, result: object) -> None:
    """Send a result, its arrays from where they are: a pickle of them would take their memory once more (PEP 574)."""
    arrays: list[pickle.PickleBuffer] = []
    rest = pickle.dumps(result, protocol=5, buffer_callback=arrays.append)
    contents = [array.raw() for array in arrays]
    sender.send((rest, [content.nbytes for content in contents]))
    for content in contents:
        sender.send_bytes(content)


def _receive(receiver: Connection) -> object:
    """The result that a copy sends."""
    rest, sizes = receiver.recv()
    arrays = [bytearray(size) for size in sizes]
    for array in arrays:
        receiver.recv_bytes_into(array)
    return pickle.loads(rest, buffers=arrays)  # noqa: S301  # a copy of this process has made it


def _end_with_parent(parent: int) -> None:
    """Let the kernel end this process when its parent is gone, even if that was killed."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:  # it was gone before
        os._exit(1)


def no_progress(stage: str, share: float) -> None:
    """Show nothing: the first process shows its own progress."""
