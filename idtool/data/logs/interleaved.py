"""Logs in which sources take turns, so that no sample holds every signal: the largest part that fits together.

An arm and a gripper that publish on one topic are such a log, and so are two topics exported into one table.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from idtool.common.arrays import Array
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.data.logs.log import Log, make_log

_BLOCK = 1 << 14  # samples looked at together


def log_of(
    path: Path,
    t: Array,
    joints: tuple[str, ...],
    signals: Mapping[str, Array],
    notices: tuple[Notice, ...] = (),
) -> Log:
    """The log that `make_log` makes, without what keeps its samples from being complete.

    Where no two samples in a row hold every joint and signal, those that one kind of sample holds are kept: the kind
    that holds a position, and most values over all. A notice names what is left out.

    Parameters and errors are those of `make_log`.
    """
    if "q" not in signals or _complete(signals):
        return make_log(path, t, joints, signals, notices)
    filled = np.stack([~np.isnan(array) for array in signals.values()], axis=1)  # (N, ns, nj)
    _, kind = np.unique(np.packbits(filled.reshape(len(t), -1), axis=1), axis=0, return_inverse=True)
    values = filled.sum(axis=(1, 2)) * filled[:, list(signals).index("q")].any(axis=1)
    kept = filled[np.argmax(kind.ravel() == np.bincount(kind.ravel(), values).argmax())]  # (ns, nj)
    rows = (filled | ~kept).all(axis=(1, 2))
    held = kept.any(axis=0)
    names = np.array([[f"{name}_{joint}" for joint in joints] for name in signals])
    lost = [f"{(~rows).sum()} samples"] * (not rows.all()) + names[filled.any(axis=0) & ~kept].tolist()
    few = tuple(np.array(joints)[held].tolist())
    message = (
        "no two samples in a row hold every signal, as where several sources take turns; "
        f"kept the {rows.sum()} samples of {join_names(few)}, left out {join_names(lost)}"
    )
    notices += (Notice("interleaved_signals", "warning", None, message, "log position and torque in the same message"),)
    fitting = {
        name: np.where(has, array[rows], np.nan)[:, held]
        for (name, array), has in zip(signals.items(), kept, strict=True)
    }
    return make_log(path, t[rows], few, fitting, notices)


def _complete(signals: Mapping[str, Array]) -> bool:
    """Whether two samples in a row hold every joint and signal that any sample holds."""
    columns = [column for array in signals.values() for column in array.T if not np.isnan(column).all()]
    if not columns:
        return True
    for start in range(0, len(columns[0]), _BLOCK):
        rows = slice(start, start + _BLOCK + 1)
        whole = ~np.any([np.isnan(column[rows]) for column in columns], axis=0)
        if (whole[1:] & whole[:-1]).any():
            return True
    return False
