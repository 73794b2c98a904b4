"""The identified model written into a user's own MJCF or URDF: only what is to be changed, every other byte kept."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from idtool.common.exceptions import ModelError
from idtool.common.input_files import read_error_text
from idtool.reporting.export.base import Export
from idtool.reporting.export.file_patch import FilePatch
from idtool.reporting.export.identified import IdentifiedModel
from idtool.reporting.export.mjcf_patch import MjcfPatch
from idtool.reporting.export.patch_plan import PatchPlan
from idtool.reporting.export.urdf_patch import UrdfPatch
from idtool.reporting.results.diagnosis import ChangeReport
from idtool.robot.urdf.reading import parse_xml

_FORMATS: dict[str, type[FilePatch]] = {"mujoco": MjcfPatch, "robot": UrdfPatch}  # by the tag of the root element


def patch_file(identified: IdentifiedModel, path: Path, changes: Sequence[ChangeReport] | None) -> Export:
    """A copy of a simulator's file with the identified values.

    Parameters
    ----------
    identified
        The model.
    path
        MJCF or URDF.
    changes
        The changes to make; None: all values of the model.

    Raises
    ------
    ModelError
        If the file is neither, lacks a joint, or an inertia is not realizable.
    """
    try:
        text = path.read_bytes()
    except OSError as error:
        raise ModelError(path, read_error_text(path, error)) from None
    tag = parse_xml(path, text).tag
    if tag not in _FORMATS:
        raise ModelError(path, f"is neither MJCF nor URDF: its root element is <{tag}>, not <mujoco> or <robot>")
    plan = PatchPlan(identified)
    if changes is None:
        plan.add_all()
    else:
        plan.add_changes(changes)
    patch = _FORMATS[tag](plan, path, text)
    content = patch.patched()
    name = f"{path.stem}_patched{path.suffix}"
    not_carried = dict.fromkeys([*plan.not_carried, *patch.not_carried])
    return Export(name, content, tuple(patch.carried), tuple(not_carried))
