"""What the payload decoders share: their type, their error, and a joint state's fields by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.names import printable
from idtool.data.logs.series import Samples

SIGNALS = {"position": "q", "velocity": "v", "effort": "tau"}
STAMPS = (("header", "stamp"), ("stamp",), ("timestamp",))
SECONDS = ("sec", "secs", "seconds")
NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos", "nanoseconds")

# A buffer, where in it each message starts and how long it is, to their samples; a message without a stamp has t = 0.
Decoder = Callable[[bytes, Indices, Indices], list[Samples]]
# A message to its text in UTF-8; ValueError where it cannot be decoded.
TextDecoder = Callable[[bytes], bytes]


class PayloadError(Exception):
    """A message that cannot be decoded.

    Parameters
    ----------
    index
        Its place among the messages given to the decoder.
    what
        What is wrong with it.
    """

    def __init__(self, index: int, what: object) -> None:
        self.index = index
        super().__init__(str(what))


@dataclass(frozen=True, slots=True)
class State:
    """One message: time [s], joint names, and their values by signal, a signal that is not there empty."""

    t: float
    joints: tuple[str, ...]
    values: tuple[Sequence[float], ...]  # in the order of `SIGNALS`


def check_names(joints: Sequence[str]) -> None:
    """Raise ValueError for names of joints that cannot be told apart or printed."""
    if len(set(joints)) < len(joints):
        raise ValueError(f"names joint {printable(next(name for name in joints if joints.count(name) > 1))} twice")
    if not "".join(joints).isprintable():
        raise ValueError("names a joint in characters that cannot be printed")


def check_counts(joints: int, counts: Sequence[int]) -> None:
    """Raise ValueError where there are values, but not one for each joint."""
    for field, count in zip(SIGNALS, counts, strict=True):
        if count not in (0, joints):
            raise ValueError(f"has {joints} names and {count} values of {field}")


def samples_of(states: Sequence[State]) -> list[Samples]:
    """Samples of messages that were decoded one by one.

    Raises
    ------
    PayloadError
        For the first kind of message whose names or values cannot be used.
    """
    kinds: dict[tuple[tuple[str, ...], tuple[int, ...]], list[int]] = {}
    for i, state in enumerate(states):
        kinds.setdefault((state.joints, tuple(map(len, state.values))), []).append(i)
    samples = []
    for (joints, counts), index in kinds.items():
        try:
            check_names(joints)
            check_counts(len(joints), counts)
        except ValueError as error:
            raise PayloadError(index[0], error) from None
        signals = {
            signal: _array([states[i].values[k] for i in index], index)
            for k, signal in enumerate(SIGNALS.values())
            if counts[k]
        }
        samples.append(Samples(np.array(index), np.array([states[i].t for i in index]), joints, signals))
    return samples


def _array(rows: Sequence[Sequence[float]], index: Sequence[int]) -> Array:
    try:
        array = np.array(rows, dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        array = np.empty(0)
    if array.ndim == 2:
        return array
    if len(rows) == 1:
        raise PayloadError(index[0], "holds values that are no numbers")
    return np.concatenate([_array([row], [i]) for row, i in zip(rows, index, strict=True)])
