"""What a cluster's connection makes of outcomes and addresses; those of tests/api are real ones."""

from __future__ import annotations

from concurrent.futures import CancelledError
from dataclasses import dataclass
from typing import Any

import dask.config
import pytest
from distributed import KilledWorker

from idtool.common import cluster
from idtool.common.exceptions import ConfigError
from idtool.common.names import without_secrets
from idtool.common.version import VERSION


@dataclass
class Future:
    """An evaluation that has ended."""

    value: Any = None
    error: Exception | None = None
    is_cancelled: bool = False

    def exception(self) -> Exception | None:
        if self.is_cancelled:
            raise CancelledError
        return self.error

    def result(self) -> Any:
        return self.value


def test_results_and_errors_of_items_are_returned() -> None:
    error = ValueError("wrong")
    assert cluster._outcome(Future((VERSION, 3))) == 3
    assert cluster._outcome(Future(error=error)) is error
    killed = cluster._outcome(Future(error=KilledWorker("key", None, 3)))
    assert "perhaps it had too little memory" in str(killed)


@pytest.mark.parametrize(
    ("future", "message"),
    [
        (Future(is_cancelled=True), "the connection to the scheduler was lost; run the command again"),
        (Future(error=ModuleNotFoundError("No module named 'idtool'")), f"a worker cannot use idtool .*{VERSION}"),
        (Future(("0.0.1", 3)), f"a worker has idtool 0.0.1, this is {VERSION}; install the same version"),
    ],
)
def test_clusters_that_are_lost_or_have_another_version_are_refused(future: Future, message: str) -> None:
    with pytest.raises(ConfigError, match=f"--cluster: {message}"):
        cluster._outcome(future)


class WithoutWorkers:
    """Client of a scheduler that has no workers."""

    def wait_for_workers(self, count: int, timeout: float) -> None:
        raise TimeoutError


def test_a_cluster_without_workers_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"--cluster: the cluster at tcp://host:1 has no workers; start some"):
        cluster._check_workers(WithoutWorkers(), "tcp://host:1")


@pytest.mark.parametrize("address", ["tcp://10.0.0.5:8786", "host:8786", "tls://[::1]:8786", "[fe80::1]:80"])
def test_addresses_of_schedulers(address: str) -> None:
    assert cluster._checked_address(address) == address


@pytest.mark.parametrize("address", ["host", "tcp://host", "http://host:80", "host:port", "::1:80", "tcp://host:80/a"])
def test_addresses_of_none(address: str) -> None:
    with pytest.raises(ConfigError, match="is not the address of a scheduler"):
        cluster._checked_address(address)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("https://user:word@host/a/run.mcap?X-Sig=abc", "https://host/a/run.mcap"),
        ("s3://bucket/run.mcap", "s3://bucket/run.mcap"),
        ("runs/what?.mcap", "runs/what?.mcap"),
    ],
)
def test_secrets_of_urls_are_not_shown(text: str, shown: str) -> None:
    assert without_secrets(text) == shown


@pytest.mark.parametrize("name", cluster._LOCAL_SETTINGS)
def test_settings_of_a_local_cluster_are_those_of_dask(name: str) -> None:
    assert dask.config.get(name) is not None  # another name would be ignored
