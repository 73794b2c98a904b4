"""`Cluster`: processes of a Dask cluster, on this machine or on many, that evaluate a function of many items."""

from __future__ import annotations

import importlib.util
import json
import logging
import re
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, TypeVar

from idtool.common.exceptions import ConfigError
from idtool.common.input_files import read_error_text
from idtool.common.names import printable
from idtool.common.processes import Progress, no_progress
from idtool.common.version import VERSION

Item = TypeVar("Item")
Result = TypeVar("Result")

_OPTION = "--cluster"
_LOCAL = re.compile(r"local:(\d{1,4})")
_SCHEME = "(tcp|tls|ws|wss|ucx)://"
_HOST = r"([^:/\[\]]+|\[[0-9a-fA-F:]+\])"  # in brackets, an IPv6 address
_PORT = r"\d{1,5}"
_ADDRESS = re.compile(f"({_SCHEME})?{_HOST}:{_PORT}")
_SECONDS_TO_CONNECT = 10
_SECONDS_TO_FIRST_WORKER = 120
_RETRIES = 2  # of an evaluation that raises an error
_TASKS_PER_THREAD = 3  # that are given out at once: each holds its item in memory
_LOCAL_SETTINGS = {  # how often Dask watches itself; its defaults take a twentieth of the time of two cores
    "distributed.admin.tick.interval": "1s",  # delays of its event loops
    "distributed.admin.system-monitor.interval": "2s",
    "distributed.worker.memory.monitor-interval": "500ms",
    "distributed.worker.profile.interval": "200ms",
}


class Cluster:
    """Connection to a Dask scheduler, whose workers evaluate functions.

    Parameters
    ----------
    client
        Connection to its scheduler.
    is_local
        True if its workers are processes of this machine and user, which see the same files.

    Attributes
    ----------
    threads
        Number of evaluations at once, of all workers, when items were last given out.
    """

    def __init__(self, client: Any, is_local: bool = False) -> None:
        self._client = client
        self.is_local = is_local
        self.threads = self._count_threads()

    def _count_threads(self) -> int:
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

        def submit_more() -> list[Any]:
            """Give out as many items as all workers, also new ones, can soon take."""
            futures: list[Any] = []
            if len(numbers) >= _TASKS_PER_THREAD * self.threads - self.threads:
                return futures
            self.threads = self._count_threads()
            count = max(_TASKS_PER_THREAD * max(self.threads, 1) - len(numbers), 0)
            for _, (number, item) in zip(range(count), remaining, strict=False):
                future = self._client.submit(_evaluate, function, item, retries=_RETRIES, pure=False)
                numbers[future.key] = number
                futures.append(future)
            return futures

        pending = as_completed(submit_more(), loop=self._client.loop)
        for future in pending:
            number = numbers.pop(future.key)
            yield number, _outcome(future)
            del future  # so that the cluster forgets the result
            pending.update(submit_more())


@contextmanager
def open_cluster(address: str, progress: Progress = no_progress) -> Iterator[Cluster]:
    """Connect to a cluster, or start one on this machine, which ends with the context.

    Parameters
    ----------
    address
        ``local:N`` for N processes on this machine; or a scheduler's address, as ``tcp://host:8786``, or the JSON file
        that it wrote (``--scheduler-file``).
    progress
        Callback for the stage and its progress, from 0 to 1.

    Raises
    ------
    ConfigError
        If the packages are not installed, there is no such cluster, or it has no workers.
    """
    try:
        from distributed import Client
    except ImportError:
        what = "needs Dask, which is not installed; run pip install 'idtool[cluster]'"
        raise ConfigError(_OPTION, what) from None
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # what users must know is in results
    with ExitStack() as stack:
        progress("connecting to the cluster", 0.0)
        is_local = address.startswith("local")
        if is_local:
            client = stack.enter_context(_local_client(_local_count(address)))
        else:
            where = _checked_address(address)
            try:
                client = stack.enter_context(Client(where, timeout=_SECONDS_TO_CONNECT, set_as_default=False))
            except (OSError, ValueError) as error:
                reason = str(error) or type(error).__name__
                advice = "start dask scheduler and dask worker, or give local:N for N processes on this machine"
                raise ConfigError(_OPTION, f"no cluster at {where} ({reason}); {advice}") from None
        progress("waiting for workers of the cluster", 0.0)
        _check_workers(client, address)
        yield Cluster(client, is_local)


def _local_count(address: str) -> int:
    """Number of processes of a cluster on this machine."""
    match = _LOCAL.fullmatch(address)
    if match is None or int(match[1]) == 0:
        raise ConfigError(_OPTION, f"{printable(address)} is not local:N, with N processes on this machine")
    return int(match[1])


def _checked_address(address: str) -> str:
    """Address of a scheduler, as given or from its file."""
    if address.endswith(".json"):
        try:
            found = json.loads(Path(address).read_bytes())["address"]
        except OSError as error:
            raise ConfigError(_OPTION, f"{address} {read_error_text(Path(address), error)}") from None
        except (ValueError, KeyError, TypeError):
            raise ConfigError(_OPTION, f"{address} is not the file of a scheduler: it has no address") from None
        address = str(found)
    if not _ADDRESS.fullmatch(address):
        what = f"{printable(address)} is not the address of a scheduler"
        raise ConfigError(_OPTION, f"{what}; give tcp://HOST:PORT, its JSON file, or local:N")
    return address


@contextmanager
def _local_client(count: int) -> Iterator[Any]:
    """Client of a cluster of some processes on this machine."""
    import dask.config
    from distributed import Client, LocalCluster

    options = {"n_workers": count, "threads_per_worker": 1, "dashboard_address": ":0", "silence_logs": logging.CRITICAL}
    settings = dask.config.set(_LOCAL_SETTINGS)
    with settings, LocalCluster(**options) as cluster, Client(cluster, set_as_default=False) as client:
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
    """Refuse a cluster without workers."""
    try:
        client.wait_for_workers(1, timeout=_SECONDS_TO_FIRST_WORKER)
    except (OSError, TimeoutError):
        advice = f"start some with dask worker {address}"
        raise ConfigError(_OPTION, f"the cluster at {address} has no workers; {advice}") from None


def _evaluate(function: Callable[[Item], Result], item: Item) -> tuple[str, Result]:
    """Result of a function on a worker, with the version of this package there."""
    return VERSION, function(item)


def _outcome(future: Any) -> Any:
    """Result of an evaluation that has ended, or its error.

    Raises
    ------
    ConfigError
        If the scheduler is gone, or the worker has no or another version of this package.
    """
    from distributed import KilledWorker

    try:
        error = future.exception()
    except CancelledError:
        what = "the connection to the scheduler was lost"
        raise ConfigError(_OPTION, f"{what}; run the command again, which uses what is written") from None
    if isinstance(error, KilledWorker):
        return RuntimeError("its worker ended several times; perhaps it had too little memory")
    if isinstance(error, ImportError):
        raise ConfigError(_OPTION, f"a worker cannot use idtool ({error}); install idtool {VERSION} there")
    if error is not None:
        return error
    version, result = future.result()
    if version != VERSION:
        raise ConfigError(_OPTION, f"a worker has idtool {version}, this is {VERSION}; install the same version")
    return result
