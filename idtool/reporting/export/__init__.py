"""The identified model for simulators. What a simulator has no place for is listed, with its size."""

from idtool.reporting.export.base import Export, Part
from idtool.reporting.export.drake import to_drake
from idtool.reporting.export.identified import Identified, identified, read_identified
from idtool.reporting.export.mujoco import to_mujoco

__all__ = ["Export", "Identified", "Part", "identified", "read_identified", "to_drake", "to_mujoco"]
