"""Jumps of a position: steps from sample to sample that its other steps do not come near.

Letters: q position [rad or m], N samples, nj joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from idtool.data.logs.log import JointLog

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


def position_jumps(log: JointLog, stretches: Sequence[slice]) -> list[Jumps]:
    """Jumps of q, by joint; of every sample of the log.

    Parameters
    ----------
    log
        The log.
    stretches
        Stretches without a gap, from which the length of ordinary steps is taken.
    """
    q = log.signals["q"]
    usual_steps = np.concatenate([np.abs(np.diff(q[stretch], axis=0)) for stretch in stretches])  # (samples, nj)
    longest_turning_step = TURN_FACTOR * np.percentile(usual_steps, TURN_PERCENTILE, axis=0)
    longest_step = JUMP_FACTOR * np.percentile(usual_steps, JUMP_PERCENTILE, axis=0)
    sizes: list[list[float]] = [[] for _ in log.joints]
    for segment in log.segments:
        for start in range(segment.start, segment.stop - 1, _BLOCK):
            stop = min(start + _BLOCK + 1, segment.stop)
            step = np.abs(np.diff(q[start:stop], axis=0))
            is_turn = (np.abs(step - 2 * np.pi) < TURN_TOLERANCE) & (step > longest_turning_step)
            rows, columns = np.nonzero(is_turn | (step > longest_step))
            for i, size in zip(columns.tolist(), step[rows, columns].tolist(), strict=True):
                sizes[i].append(size)
            log.release_memory()
    jumps = []
    for joint_sizes in sizes:
        wraps = bool(joint_sizes) and bool(abs(np.median(joint_sizes) - 2 * np.pi) < TURN_TOLERANCE)
        jumps.append(Jumps(len(joint_sizes), wraps))
    return jumps
