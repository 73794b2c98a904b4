"""`Fault`: something that is wrong with the data."""

from __future__ import annotations

from dataclasses import dataclass

from idtool.data.inspection import FaultKind


@dataclass(frozen=True)
class Fault:
    """Something that is wrong with the data.

    Attributes
    ----------
    fault
        Its kind; see `idtool.diagnosis.data_faults`.
    joint
        The joint it concerns; None: the log, or all joints.
    detail
        The evidence and what to do, a plain sentence.
    undone
        Whether it is undone, so that nothing is to be done.
    """

    fault: FaultKind
    joint: str | None
    detail: str
    undone: bool = False
