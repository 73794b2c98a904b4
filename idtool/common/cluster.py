"""`Cluster`: processes of a Dask cluster, on this machine or on many, that evaluate a function of many items."""

from __future__ import annotations

import importlib.util
import logging
import re
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, TypeVar

from idtool.common.exceptions import ConfigError
from idtool.common.version import VERSION

Item = TypeVar("Item")
Result = TypeVar("Result")

_OPTION = "--cluster"
_LOCAL = re.compile(r"local:(\d{1,4})")
_SECONDS_TO_CONNECT = 10
_SECONDS_TO_FIRST_WORKER = 120
_RETRIES = 2  # of an evaluation that raises an error
_TASKS_PER_THREAD = 3  # that are given out at once: each holds its item in memory


class Cluster:
    """A cluster.

    Parameters
    ----------
    client
        Connection to its scheduler.
    """

    def __init__(self, client: Any) -> None:
        self._client = client

    @property
    def threads(self) -> int:
        """Number of evaluations at once, of all workers."""
        return sum(self._client.nthreads().values())

    @property
    def dashboard(self) -> str | None:
        """Address of the page that shows its work; None without the package that makes it."""
        has_pages = importlib.util.find_spec("bokeh") is not None
        return str(self._client.dashboard_link) if has_pages else None

    def evaluate(
        self, function: Callable[[Item], Result], items: Sequence[Item]
    ) -> Iterator[tuple[int, Result | Exception]]:
        """Evaluate a function of each item, again if it fails; also if its worker ends.

        Parameters
        ----------
        function
            A function of a module, that workers can import.
        items
            The items.

        Yields
        ------
        Index of an item, and its result, or the error of the last try; in the order in which they are finished.
        """
        from distributed import as_completed

        remaining = iter(enumerate(items))
        numbers: dict[str, int] = {}

        def submit(count: int) -> list[Any]:
            futures = []
            for _, (number, item) in zip(range(count), remaining, strict=False):
                future = self._client.submit(function, item, retries=_RETRIES, pure=False)
                numbers[future.key] = number
                futures.append(future)
            return futures

        pending = as_completed(submit(_TASKS_PER_THREAD * max(self.threads, 1)), loop=self._client.loop)
        for future in pending:
            number = numbers.pop(future.key)
            yield number, _outcome(future)
            del future  # so that the cluster forgets the result
            pending.update(submit(1))


@contextmanager
def open_cluster(address: str) -> Iterator[Cluster]:
    """Connect to a cluster, or start one on this machine, which ends with the context.

    Parameters
    ----------
    address
        ``local:N`` for N processes on this machine; or a scheduler's address, as ``tcp://host:8786``, or the JSON file
        that it wrote (``--scheduler-file``).

    Raises
    ------
    ConfigError
        If the packages are not installed, there is no such cluster, or its workers cannot be used.
    """
    try:
        from distributed import Client
    except ImportError:
        what = "needs Dask, which is not installed; run pip install 'idtool[cluster]'"
        raise ConfigError(_OPTION, what) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what users must know is in results
    with ExitStack() as stack:
        local = _LOCAL.fullmatch(address)
        try:
            if local:
                client = stack.enter_context(_local_client(int(local[1])))
            else:
                where = {"address": address}
                if address.endswith(".json"):
                    Path(address).read_bytes()  # Dask would wait for a file that is not there
                    where = {"scheduler_file": address}
                client = stack.enter_context(Client(timeout=_SECONDS_TO_CONNECT, set_as_default=False, **where))
        except (OSError, ValueError, TypeError) as error:
            reason = str(error) or type(error).__name__
            advice = "start dask scheduler and dask worker, or give local:N for N processes on this machine"
            raise ConfigError(_OPTION, f"no cluster at {address} ({reason}); {advice}") from None
        _check_workers(client, address)
        yield Cluster(client)


@contextmanager
def _local_client(count: int) -> Iterator[Any]:
    """Client of a cluster of some processes on this machine."""
    from distributed import Client, LocalCluster

    if not count:
        raise ConfigError(_OPTION, "local:0 has no process; give local:N with N of at least 1")
    options = {"n_workers": count, "threads_per_worker": 1, "dashboard_address": ":0", "silence_logs": logging.CRITICAL}
    with LocalCluster(**options) as cluster, Client(cluster, set_as_default=False) as client:
        client.register_plugin(_without_interrupt())
        yield client


def _without_interrupt() -> Any:
    """Plugin by which workers ignore Ctrl-C, which goes to all processes of a terminal: the first one ends them."""
    from distributed import WorkerPlugin

    class WithoutInterrupt(WorkerPlugin):  # type: ignore[misc]  # its type is not known
        def setup(self, worker: Any) -> None:
            signal.signal(signal.SIGINT, signal.SIG_IGN)

    return WithoutInterrupt()


def _check_workers(client: Any, address: str) -> None:
    """Refuse a cluster without workers, or whose workers have another version of this package."""
    try:
        client.wait_for_workers(1, timeout=_SECONDS_TO_FIRST_WORKER)
    except (OSError, TimeoutError):
        advice = f"start some with dask worker {address}"
        raise ConfigError(_OPTION, f"the cluster at {address} has no workers; {advice}") from None
    try:
        versions = client.run(_version)
    except Exception as error:  # whatever a worker's Python says
        what = f"a worker cannot use idtool ({type(error).__name__}: {error})"
        raise ConfigError(_OPTION, f"{what}; install idtool {VERSION} where the workers run") from None
    for worker, version in versions.items():
        if version != VERSION:
            what = f"the worker {worker} has idtool {version}, this is {VERSION}"
            raise ConfigError(_OPTION, f"{what}; install the same version")


def _version() -> str:
    """Version of this package on a worker."""
    return VERSION


def _outcome(future: Any) -> Any:
    """Result of an evaluation that has ended, or its error."""
    from distributed import KilledWorker

    error = future.exception()
    if isinstance(error, KilledWorker):
        return RuntimeError("its worker ended several times; perhaps it had too little memory")
    return future.result() if error is None else error
