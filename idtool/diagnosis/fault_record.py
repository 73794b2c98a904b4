"""`Fault`: something that is wrong with the data."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Fault:
    """Something that is wrong with the data.

    Attributes
    ----------
    fault
        Which; see `idtool.diagnosis.faults`.
    joint
        The joint it concerns; None: the log, or all joints.
    detail
        What was seen and what to do, a plain sentence.
    undone
        Whether it is undone, so that nothing is to be done.
    """

    fault: str
    joint: str | None
    detail: str
    undone: bool = False
