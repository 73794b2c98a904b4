"""`Distribution`: a cluster that reduces logs, and the folder of the reductions."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from idtool.common.cluster import Cluster, open_cluster
from idtool.common.dataclass import dataclass
from idtool.common.processes import Progress, no_progress


@dataclass(frozen=True)
class Distribution:
    """A cluster that reduces logs.

    Attributes
    ----------
    cluster
        The cluster.
    folder
        Where the reductions of the logs are written. Those that are there, made from the same files with the same
        settings, are not made again.
    """

    cluster: Cluster
    folder: Path


@contextmanager
def open_distribution(
    address: str | None, folder: Path | None, progress: Progress = no_progress
) -> Iterator[Distribution | None]:
    """Connect to a cluster, which is needed no longer than logs are read.

    Parameters
    ----------
    address
        See `open_cluster`; None: logs are read in this process.
    folder
        Where reductions of logs are kept; None: nowhere.
    progress
        Called with the name of a stage and the share of it that is done.

    Raises
    ------
    ConfigError
        If there is no such cluster.
    """
    if address is None:
        yield None
        return
    with tempfile.TemporaryDirectory(prefix="idtool-") as temporary, open_cluster(address, progress) as cluster:
        yield Distribution(cluster, folder or Path(temporary))
