"""The topics of a log that it may be read from, where it has several."""

from __future__ import annotations

from pathlib import Path

from idtool.common.exceptions import LogError
from idtool.data.logs.bag import files_of
from idtool.data.logs.files import records
from idtool.data.logs.mcap import matches
from idtool.data.logs.topics import Topics

_HEAD_BYTES = 8


def state_topics(path: Path) -> tuple[str, ...]:
    """The topics of an MCAP file or rosbag2 folder that carry joint states, in their order; none of other formats.

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
        topics = Topics(path, None, keeping=False)
        for part in files_of(path):
            topics.begin(part)
            with records(part) as found:
                for batch in found:
                    topics.take(batch)
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror or error}") from None
    return topics.names
