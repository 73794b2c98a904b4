"""`LoggedData`: data that was logged before a trajectory is designed."""

from __future__ import annotations

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.estimation.dataset.reduction import Reduction


@dataclass(frozen=True)
class LoggedData:
    """Data that was logged before: its R-factors, and the noise of each row in them, shape (nv,)."""

    reduction: Reduction
    noise: Array
