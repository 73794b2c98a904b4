"""The identified model for simulators. What a simulator has no place for is listed, with its size."""

from idtool.reporting.export.base import Export, Part
from idtool.reporting.export.drake import to_drake
from idtool.reporting.export.identified import IdentifiedModel, identified_model, read_identified
from idtool.reporting.export.mujoco import to_mujoco
from idtool.reporting.export.patch import patch_file

__all__ = [
    "Export",
    "IdentifiedModel",
    "Part",
    "identified_model",
    "patch_file",
    "read_identified",
    "to_drake",
    "to_mujoco",
]
