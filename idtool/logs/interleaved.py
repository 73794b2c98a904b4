"""Logs in which sources take turns, so that no sample holds every joint and signal: the commonest kind of sample.

An arm and a gripper that publish on one topic are such a log, and so are two topics exported into one table.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from idtool.logs.log import Array, Log, make_log
from idtool.logs.names import some

_BLOCK = 1 << 14  # samples looked at together


def log_of(
    path: Path,
    t: Array,
    joints: tuple[str, ...],
    signals: Mapping[str, Array],
    warnings: tuple[str, ...] = (),
) -> Log:
    """The log that `make_log` makes, without what keeps its samples from being complete.

    Where fewer than two samples hold every joint and signal, those of the commonest kind that holds a position
    are kept, and a warning names what they lack.

    Parameters and errors are those of `make_log`.
    """
    if "q" not in signals or _complete(signals):
        return make_log(path, t, joints, signals, warnings)
    filled = np.stack([~np.isnan(array) for array in signals.values()], axis=1)  # (N, ns, nj)
    _, kind = np.unique(np.packbits(filled.reshape(len(t), -1), axis=1), axis=0, return_inverse=True)
    with_position = kind.ravel()[filled[:, list(signals).index("q")].any(axis=1)]
    rows = kind.ravel() == (np.bincount(with_position).argmax() if len(with_position) else -1)
    kept, present = filled[rows].any(axis=0), filled.any(axis=0)
    held = kept.any(axis=0)
    names = np.array([[f"{name}_{joint}" for joint in joints] for name in signals])
    warnings += (
        f"no two samples hold every signal, as where several sources take turns: kept the {rows.sum()} samples of "
        f"{some(list(np.array(joints)[held]))}; left out {some(list(names[present & ~kept]))}",
    )
    signals = {name: array[rows][:, held] for name, array in signals.items()}
    return make_log(path, t[rows], tuple(np.array(joints)[held].tolist()), signals, warnings)


def _complete(signals: Mapping[str, Array]) -> bool:
    """Whether two samples or more hold every joint and signal that any sample holds."""
    columns = [column for array in signals.values() for column in array.T if not np.isnan(column).all()]
    count = 0
    for start in range(0, len(signals["q"]), _BLOCK):
        rows = slice(start, start + _BLOCK)
        count += int(np.logical_and.reduce([~np.isnan(column[rows]) for column in columns]).sum()) if columns else 0
        if count >= 2:
            return True
    return False
