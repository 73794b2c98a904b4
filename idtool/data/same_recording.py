"""Logs that hold the same recording, whatever their names and formats."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from idtool.data.logs.log import SIGNALS, JointLog
from idtool.data.logs.stored_arrays import blocks_of, column_ranges

_TOLERANCE = 1e-4  # of a signal's range: rounding in another format is smaller, the noise of another run is larger
_MIN_TOLERANCE = 1e-6  # SI units, of a signal that hardly changes


def is_same_recording(first: JointLog, second: JointLog) -> bool:
    """True if two logs hold the same recording.

    These are files of the same content, or logs of the same length that agree in the joints' positions and in every
    other signal that both have.
    """
    hashes = _content_hashes(first)
    if hashes and hashes == _content_hashes(second):
        return True
    if len(first) != len(second):
        return False
    joints = [name for name in first.joints if first.has("q", name) and second.has("q", name)]
    if not joints:
        return False
    return all(_is_same_signal(first, second, signal, joints) for signal in SIGNALS)


def same_recordings(logs: Iterable[JointLog]) -> list[list[JointLog]]:
    """Groups of logs that hold the same recording; those that no other log is equal to are left out."""
    groups: list[list[JointLog]] = []
    for log in logs:
        group = next((group for group in groups if is_same_recording(group[0], log)), None)
        if group is None:
            groups.append([log])
        else:
            group.append(log)
    return [group for group in groups if len(group) > 1]


def distinct_names(logs: Sequence[JointLog]) -> list[str]:
    """Names of the logs' files, each once; with their folders if different files have the same name."""
    paths = dict.fromkeys(log.path for log in logs)
    names = [path.name for path in paths]
    if len(set(names)) == len(names):
        return names
    return [f"{path.absolute().parent.name}/{path.name}" for path in paths]


def _content_hashes(log: JointLog) -> list[str | None]:
    """Hashes of a log's files; the metadata of a bag have no samples."""
    return [source.sha256 for source in log.sources if source.kind == "log"]


def _is_same_signal(first: JointLog, second: JointLog, signal: str, joints: Sequence[str]) -> bool:
    """True if a signal of joints is the same in two logs of the same length, or missing in one of them."""
    common = [name for name in joints if first.has(signal, name) and second.has(signal, name)]
    if not common:
        return True
    x, y = first.signals[signal], second.signals[signal]
    x_columns = [first.joints.index(name) for name in common]
    y_columns = [second.joints.index(name) for name in common]
    least, greatest = column_ranges(x)
    tolerance = np.maximum(_TOLERANCE * (greatest - least)[x_columns], _MIN_TOLERANCE)
    for rows in blocks_of([x, y], len(x)):
        is_same = np.isclose(x[rows][:, x_columns], y[rows][:, y_columns], rtol=0.0, atol=tolerance, equal_nan=True)
        if not is_same.all():
            return False
    return True
