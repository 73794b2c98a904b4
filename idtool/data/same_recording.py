"""Logs that hold the same recording, whatever their names and formats."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from idtool.common.arrays import Array
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
        self._columns: dict[str, dict[str, int]] = {}
        self._some_rows: dict[str, Array] = {}
        self._tolerances: dict[str, Array] = {}

    def is_same(self, other: _Recording) -> bool:
        """True if another log holds the same recording; see `is_same_recording`."""
        if self._hashes and self._hashes == other._hashes:
            return True
        if len(self.log) != len(other.log):
            return False
        joints = self._common(other, "q")
        return bool(joints) and all(self._is_same_signal(other, signal, joints) for signal in SIGNALS)

    def _common(self, other: _Recording, signal: str) -> list[str]:
        """Joints that have values of a signal in both logs."""
        others = other._joint_columns(signal)
        return [name for name in self._joint_columns(signal) if name in others]

    def _joint_columns(self, signal: str) -> dict[str, int]:
        """Column of each joint that has values of a signal."""
        if signal not in self._columns:
            names = self.log.joints
            self._columns[signal] = {name: i for i, name in enumerate(names) if self.log.has(signal, name)}
        return self._columns[signal]

    def _is_same_signal(self, other: _Recording, signal: str, joints: Sequence[str]) -> bool:
        """True if a signal of joints is the same in another log of the same length, or missing in one of them."""
        common = [name for name in self._common(other, signal) if name in joints]
        if not common:
            return True
        own_columns = [self._joint_columns(signal)[name] for name in common]
        other_columns = [other._joint_columns(signal)[name] for name in common]
        tolerance = self._tolerance(signal)[own_columns]

        def is_same(own: Array, others: Array) -> bool:
            own, others = own[:, own_columns], others[:, other_columns]
            return bool(np.isclose(own, others, rtol=0.0, atol=tolerance, equal_nan=True).all())

        if not is_same(self._rows_looked_at_first(signal), other._rows_looked_at_first(signal)):
            return False
        x, y = self.log.signals[signal], other.log.signals[signal]
        return all(is_same(x[rows], y[rows]) for rows in blocks_of([x, y], len(x)))

    def _rows_looked_at_first(self, signal: str) -> Array:
        """A few samples of a signal, at which most logs differ, shape (`_FIRST_ROWS`, nj)."""
        if signal not in self._some_rows:
            x = self.log.signals[signal]
            self._some_rows[signal] = x[np.linspace(0, len(x) - 1, _FIRST_ROWS).astype(int)]
            release_pages([x])
        return self._some_rows[signal]

    def _tolerance(self, signal: str) -> Array:
        """Largest difference of a signal from the same one in another log, shape (nj,)."""
        if signal not in self._tolerances:
            least, greatest = column_ranges(self.log.signals[signal])
            self._tolerances[signal] = np.maximum(_TOLERANCE * (greatest - least), _MIN_TOLERANCE)
        return self._tolerances[signal]
