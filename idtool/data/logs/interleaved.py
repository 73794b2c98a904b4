"""Logs of several sources that take turns, so that no sample has every signal: the largest consistent part.

Examples are an arm and a gripper that publish on one topic, and two topics exported into one table.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.dataclass import dataclass
from idtool.common.names import count_text, join_names
from idtool.common.notice import Notice
from idtool.data.logs.log import JointLog, make_log
from idtool.data.logs.stored_arrays import RowBuffer, blocks_of


@dataclass
class _Kind:
    """Samples with the same combination of values.

    Attributes
    ----------
    filled
        True for the values that they have, shape (ns, nj) for ns signals.
    samples
        Number of samples.
    """

    filled: Mask
    samples: int

    def value_count(self, position: int) -> int:
        """Number of values in all; 0 if signal ``position`` is missing."""
        return self.samples * int(self.filled.sum()) if self.filled[position].any() else 0


def make_log_of_complete_samples(
    path: Path,
    t: Array,
    joints: tuple[str, ...],
    signals: Mapping[str, Array],
    notices: tuple[Notice, ...] = (),
) -> JointLog:
    """`make_log`, but only with samples that fit together.

    If no two samples in a row have every joint and signal, only the samples of one kind are kept: the kind that has
    a position, and most values in all. A notice names the rest.

    Parameters and errors are those of `make_log`.
    """
    if "q" not in signals or _has_complete_samples(signals):
        return make_log(path, t, joints, signals, notices)
    kinds = _kinds_of_samples(signals)
    has_values = np.any([kind.filled for kind in kinds.values()], axis=0)  # (ns, nj)
    position = list(signals).index("q")
    best = max(sorted(kinds), key=lambda key: kinds[key].value_count(position))  # the first of equal ones
    pattern = kinds[best].filled  # (ns, nj), the values that are kept
    rows = np.zeros(len(t), dtype=bool)
    for part in blocks_of(signals.values(), len(t)):
        rows[part] = (_filled(signals, part) | ~pattern).all(axis=(1, 2))
    columns = pattern.any(axis=0)
    kept_joints = tuple(np.array(joints)[columns].tolist())

    column_names = np.array([[f"{name}_{joint}" for joint in joints] for name in signals])
    removed = column_names[has_values & ~pattern].tolist()
    if not rows.all():
        removed.insert(0, count_text(int((~rows).sum()), "sample"))
    message = (
        "no two consecutive samples contain all signals, because several sources seem to write alternately; kept: "
        f"{count_text(int(rows.sum()), 'sample')} of {join_names(kept_joints)}; ignored: {join_names(removed)}"
    )
    advice = "log position and torque in the same message"
    notices += (Notice("interleaved_signals", "warning", None, message, advice),)
    kept_signals = {}
    for (name, array), has in zip(signals.items(), pattern, strict=True):
        kept = RowBuffer(path, len(kept_joints))
        for part in blocks_of([array], len(t)):
            kept.append(np.where(has, array[part][rows[part]], np.nan)[:, columns])
        kept_signals[name] = kept.array()
    return make_log(path, t[rows], kept_joints, kept_signals, notices)


def _filled(signals: Mapping[str, Array], rows: slice) -> Mask:
    """True where there is a value, shape (N, ns, nj) for N samples and ns signals."""
    return np.stack([~np.isnan(array[rows]) for array in signals.values()], axis=1)


def _kinds_of_samples(signals: Mapping[str, Array]) -> dict[bytes, _Kind]:
    """The combinations of values that samples have."""
    kinds: dict[bytes, _Kind] = {}
    count = len(next(iter(signals.values())))
    for rows in blocks_of(signals.values(), count):
        filled = _filled(signals, rows)
        packed = np.packbits(filled.reshape(len(filled), -1), axis=1)
        _, first, counts = np.unique(packed, axis=0, return_index=True, return_counts=True)
        for i, samples in zip(first.tolist(), counts.tolist(), strict=True):
            kind = kinds.setdefault(packed[i].tobytes(), _Kind(filled[i], 0))
            kind.samples += samples
    return kinds


def _has_complete_samples(signals: Mapping[str, Array]) -> bool:
    """True if two samples in a row have every joint and signal that any sample has."""
    filled = [(array, _filled_columns(array)) for array in signals.values()]
    filled = [(array, columns) for array, columns in filled if len(columns)]
    if not filled:
        return True
    count = len(filled[0][0])
    for rows in blocks_of([array for array, _ in filled], count):
        overlapping_rows = slice(rows.start, rows.stop + 1)
        complete = np.ones(min(rows.stop + 1, count) - rows.start, dtype=bool)
        for array, columns in filled:
            complete &= ~np.isnan(array[overlapping_rows][:, columns]).any(axis=1)
        if (complete[1:] & complete[:-1]).any():
            return True
    return False


def _filled_columns(array: Array) -> Indices:
    """Columns of an array, shape (N, nj), that have a value."""
    is_filled = np.zeros(array.shape[1], dtype=bool)
    for rows in blocks_of([array], len(array)):
        is_filled |= ~np.isnan(array[rows]).all(axis=0)
        if is_filled.all():
            break
    return np.flatnonzero(is_filled)
