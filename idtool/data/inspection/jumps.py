"""Jumps of a position: steps from sample to sample that its other steps do not come near.

Letters: q position [rad or m], N samples, nj joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from idtool.data.logs.log import Log

JUMP_PERCENTILE = 99.5  # percentile of the steps, and
JUMP_FACTOR = 10.0  # times that, beyond which a step is a jump
TURN_PERCENTILE = 90.0  # the same of a jump by a full turn, whose size is known: a joint that turns on and on
TURN_FACTOR = 20.0  # makes many of them
TURN_TOLERANCE = 0.5  # rad off a full turn that a jump may be

_BLOCK = 1 << 16  # samples looked at together


class Jumps(NamedTuple):
    """Number of jumps, and whether they are about a full turn."""

    number: int
    wraps: bool


def position_jumps(log: Log, stretches: Sequence[slice]) -> list[Jumps]:
    """Jumps of q, by joint; of every sample of the log.

    Parameters
    ----------
    log
        The log.
    stretches
        Stretches without a gap, from which the length of ordinary steps is taken.
    """
    q = log.signals["q"]
    usual = np.concatenate([np.abs(np.diff(q[stretch], axis=0)) for stretch in stretches])  # (samples, nj)
    longest_turn = TURN_FACTOR * np.percentile(usual, TURN_PERCENTILE, axis=0)
    longest = JUMP_FACTOR * np.percentile(usual, JUMP_PERCENTILE, axis=0)
    sizes: list[list[float]] = [[] for _ in log.joints]
    for segment in log.segments:
        for start in range(segment.start, segment.stop - 1, _BLOCK):
            step = np.abs(np.diff(q[start : min(start + _BLOCK + 1, segment.stop)], axis=0))
            turns = (np.abs(step - 2 * np.pi) < TURN_TOLERANCE) & (step > longest_turn)
            rows, columns = np.nonzero(turns | (step > longest))
            for i, size in zip(columns.tolist(), step[rows, columns].tolist(), strict=True):
                sizes[i].append(size)
    return [Jumps(len(own), bool(own) and bool(abs(np.median(own) - 2 * np.pi) < TURN_TOLERANCE)) for own in sizes]
