"""The topics of a log that carry joint states."""

from __future__ import annotations

from pathlib import Path

from idtool.common.exceptions import LogError
from idtool.data.logs.bag import log_files
from idtool.data.logs.mcap import matches
from idtool.data.logs.mcap_file import open_mcap
from idtool.data.logs.message_options import DEFAULT_MESSAGES, MessageOptions
from idtool.data.logs.topics import TopicReader

_HEAD_BYTES = 8


def state_topics(path: Path, options: MessageOptions = DEFAULT_MESSAGES) -> tuple[str, ...]:
    """The topics of an MCAP file or rosbag2 folder that carry joint states, in order; empty for other formats.

    ``options`` tell which messages other than joint states are read.

    Raises
    ------
    LogError
        If the log cannot be read.
    """
    try:
        if not path.is_dir():
            with path.open("rb") as file:
                if not matches(file.read(_HEAD_BYTES)):
                    return ()
        topics = TopicReader(path, None, options, keep_samples=False)
        for part in log_files(path):
            topics.begin_file(part)
            with open_mcap(part) as records:
                for batch in records:
                    topics.read(batch)
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror or error}") from None
    return topics.names
