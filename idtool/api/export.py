"""`export`: the identified model for a simulator."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal

from idtool.api.results import notice_lines
from idtool.common.exceptions import ConfigError
from idtool.common.notice import Notice
from idtool.common.outputs import check_file, write_all
from idtool.reporting.export import read_identified, to_drake, to_mujoco
from idtool.reporting.export.identified import CONFIG, URDF
from idtool.reporting.results.base import notice_fields
from idtool.reporting.results.export import ExportedPart, ExportReport

Simulator = Literal["mujoco", "drake"]


class ExportResult(ExportReport):
    """The identified model as a simulator file, and the parts of the model that the file cannot represent."""

    _text: bytes
    _folder: Path
    _name: str

    @property
    def text(self) -> str:
        """The file's content."""
        return self._text.decode()

    @property
    def default_file(self) -> Path:
        """Default path of the file, beside the identified model."""
        return self._folder / self._name

    def save(self, file: str | os.PathLike[str] | None = None) -> Path:
        """Write the file.

        Parameters
        ----------
        file
            Where to; None: beside the identified model.

        Returns
        -------
        The file.

        Raises
        ------
        OutputError
            If the file cannot be written, or would overwrite the identified model.
        """
        path = self.default_file if file is None else Path(file)
        check_file(path, [self._folder / URDF, self._folder / CONFIG])
        write_all(path.parent, {path.name: self._text})
        return path

    def __repr__(self) -> str:
        kinds = dict.fromkeys(part.what for part in self.carried)
        missing = dict.fromkeys(f"{part.what} of {part.of}" for part in self.not_carried)
        lines = [f"ExportResult {self._name}: contains {', '.join(kinds)}"]
        lines += [f"  not exported: {name}" for name in missing]
        return "\n".join([*lines, *notice_lines(self.notices)])


def export(folder: str | os.PathLike[str], to: Simulator, *, rotor_bodies: bool = False) -> ExportResult:
    """Write the identified model as a file for a simulator, like `idtool export`.

    Parameters
    ----------
    folder
        The folder that a fit was saved to.
    to
        The simulator.
    rotor_bodies
        For MuJoCo: represent rotors that armature cannot fully represent as bodies that are held by constraints.

    Raises
    ------
    IdtoolError
        If the folder contains no identified model, or the simulator would reject the model.
    """
    if rotor_bodies and to != "mujoco":
        raise ConfigError("--rotor-bodies", f"is only for mujoco; omit it for {to}")
    source = Path(folder)
    if source.is_file():
        source = source.parent
    identified = read_identified(source)
    exported = to_mujoco(identified, rotor_bodies) if to == "mujoco" else to_drake(identified)
    notices = list(identified.model.notices)
    if to == "mujoco" and any(part.what == "rotor" for part in exported.not_carried):
        message = "use --rotor-bodies to represent the rotors completely, each as a body with its own coordinate"
        notices.append(Notice("rotors_simplified", "note", None, message))
    result = ExportResult(
        file=None,
        carried=[ExportedPart(**vars(part)) for part in exported.carried],
        not_carried=[ExportedPart(**vars(part)) for part in exported.not_carried],
        **notice_fields(notices),
    )
    result._text = exported.text
    result._folder = source
    result._name = exported.name
    return result
