"""Logs that hold the same recording, whatever their names and formats."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.data.logs.log import SIGNALS, JointLog
from idtool.data.logs.stored_arrays import blocks_of, column_ranges, release_pages

_TOLERANCE = 1e-4  # of a signal's range: rounding in another format is smaller, the noise of another run is larger
_FIRST_ROWS = 8  # compared before all others
_MIN_TOLERANCE = 1e-6  # SI units, of a signal that hardly changes


def is_same_recording(first: JointLog, second: JointLog) -> bool:
    """True if two logs hold the same recording.

    These are files of the same content, or logs of the same length that agree in the joints' positions and in every
    other signal that both have.
    """
    return _Recording(first).is_same(_Recording(second))


def same_recordings(logs: Iterable[JointLog]) -> list[list[JointLog]]:
    """Groups of logs that hold the same recording; those that no other log is equal to are left out."""
    groups: list[list[_Recording]] = []
    for recording in map(_Recording, logs):
        group = next((group for group in groups if group[0].is_same(recording)), None)
        if group is None:
            groups.append([recording])
        else:
            group.append(recording)
    return [[recording.log for recording in group] for group in groups if len(group) > 1]


def distinct_names(logs: Sequence[JointLog]) -> list[str]:
    """Names of the logs' files, each once; with their folders if different files have the same name."""
    paths = dict.fromkeys(log.path for log in logs)
    names = [path.name for path in paths]
    if len(set(names)) == len(names):
        return names
    return [f"{path.absolute().parent.name}/{path.name}" for path in paths]


class _Recording:
    """A log, compared with others.

    Parameters
    ----------
    log
        The log.
    """

    def __init__(self, log: JointLog) -> None:
        self.log = log
        # Hashes of its files; the metadata of a bag have no samples.
        self._hashes = [source.sha256 for source in log.sources if source.kind == "log"]
        self._spans: dict[str, Array] = {}

    def is_same(self, other: _Recording) -> bool:
        """True if another log holds the same recording; see `is_same_recording`."""
        log, other_log = self.log, other.log
        if self._hashes and self._hashes == other._hashes:
            return True
        if len(log) != len(other_log):
            return False
        joints = [name for name in log.joints if log.has("q", name) and other_log.has("q", name)]
        if not joints:
            return False
        return all(self._is_same_signal(other_log, signal, joints) for signal in SIGNALS)

    def _is_same_signal(self, other: JointLog, signal: str, joints: Sequence[str]) -> bool:
        """True if a signal of joints is the same in another log of the same length, or missing in one of them."""
        common = [name for name in joints if self.log.has(signal, name) and other.has(signal, name)]
        if not common:
            return True
        x, y = self.log.signals[signal], other.signals[signal]
        x_columns = [self.log.joints.index(name) for name in common]
        y_columns = [other.joints.index(name) for name in common]
        tolerance = np.maximum(_TOLERANCE * self._span(signal)[x_columns], _MIN_TOLERANCE)

        def is_same(rows: slice | Indices) -> bool:
            own, others = x[rows][:, x_columns], y[rows][:, y_columns]
            return bool(np.isclose(own, others, rtol=0.0, atol=tolerance, equal_nan=True).all())

        some_rows = np.linspace(0, len(x) - 1, _FIRST_ROWS).astype(int)  # at which most logs differ
        may_be_same = is_same(some_rows)
        release_pages([x, y])
        return may_be_same and all(map(is_same, blocks_of([x, y], len(x))))

    def _span(self, signal: str) -> Array:
        """Range of a signal of each joint, shape (nj,)."""
        if signal not in self._spans:
            least, greatest = column_ranges(self.log.signals[signal])
            self._spans[signal] = greatest - least
        return self._spans[signal]
