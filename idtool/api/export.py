"""`export`: the identified model for a simulator."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from idtool.api.notebook import Displayable
from idtool.api.results import notice_lines
from idtool.common.exceptions import ConfigError, ModelError
from idtool.common.notice import Notice
from idtool.common.outputs import check_file, write_all
from idtool.reporting.export import patch_file, read_identified, to_drake, to_mujoco
from idtool.reporting.export.identified import CONFIG, URDF
from idtool.reporting.results.base import notice_fields
from idtool.reporting.results.diagnosis import AgainstReport, ChangeReport
from idtool.reporting.results.export import ExportedPart, ExportReport

if TYPE_CHECKING:
    from idtool.reporting.terminal.output import Output

Simulator = Literal["mujoco", "drake"]
DIAGNOSIS = "diagnosis.json"


class ExportResult(ExportReport, Displayable):
    """The identified model as a simulator file, and the parts of the model that the file cannot represent."""

    _text: bytes
    _folder: Path
    _name: str
    _inputs: tuple[Path, ...]

    @property
    def text(self) -> str:
        """The file's content."""
        return self._text.decode()

    @property
    def default_file(self) -> Path:
        """Default path of the file: beside the identified model, or beside the file that was patched."""
        return self._folder / self._name

    def save(self, file: str | os.PathLike[str] | None = None) -> Path:
        """Write the file; a patched file in which nothing is to be changed replaces none that is there.

        Parameters
        ----------
        file
            Where to; None: the default path.

        Returns
        -------
        The file.

        Raises
        ------
        OutputError
            If the file cannot be written, or would overwrite an input.
        """
        path = self.default_file if file is None else Path(file)
        check_file(path, self._inputs)
        if not self.leaves(path):
            write_all(path.parent, {path.name: self._text})
        return path

    def leaves(self, file: Path) -> bool:
        """True if `save` leaves a file as it is: a copy without a change would replace what was written earlier."""
        return self.patched is not None and not self.carried and file.exists()

    def _show(self, output: Output) -> None:
        from idtool.reporting.terminal.export import show_export

        show_export(output, self)

    def __repr__(self) -> str:
        kinds = dict.fromkeys(part.what for part in self.carried)
        missing = dict.fromkeys(f"{part.what} of {part.of}" for part in self.not_carried)
        lines = [f"ExportResult {self._name}: contains {', '.join(kinds)}"]
        lines += [f"  not exported: {name}" for name in missing]
        return "\n".join([*lines, *notice_lines(self.notices)])


def export(
    folder: str | os.PathLike[str],
    to: Simulator | None = None,
    *,
    rotor_bodies: bool = False,
    patch: str | os.PathLike[str] | None = None,
) -> ExportResult:
    """Write the identified model as a file for a simulator, like `idtool export`.

    Parameters
    ----------
    folder
        The folder that a fit or a diagnosis was saved to.
    to
        The simulator; None with ``patch``.
    rotor_bodies
        For MuJoCo: represent rotors that armature cannot fully represent as bodies that are held by constraints.
    patch
        A simulator's own MJCF or URDF. The result is a copy of it with the changes that a diagnosis with ``against``
        found, or else with all values of the model.

    Raises
    ------
    IdtoolError
        If the folder contains no identified model, or the simulator would reject the model.
    """
    if rotor_bodies and to != "mujoco":
        raise ConfigError("--rotor-bodies", "is only for --to mujoco; omit it")
    if (to is None) == (patch is None):
        what = "is missing; give mujoco or drake, or a file with --patch" if patch is None else "is not for --patch"
        raise ConfigError("--to", what)
    source = Path(folder)
    if source.is_file():
        source = source.parent
    identified = read_identified(source)
    inputs = [source / URDF, source / CONFIG]
    target = source
    if patch is not None:
        target = Path(patch).parent
        inputs.append(Path(patch))
        exported = patch_file(identified, Path(patch), _changes(source))
    else:
        exported = to_mujoco(identified, rotor_bodies) if to == "mujoco" else to_drake(identified)
    notices = list(identified.model.notices)
    if to == "mujoco" and any(part.what == "rotor" for part in exported.not_carried):
        message = "use --rotor-bodies to represent the rotors completely, each as a body with its own coordinate"
        notices.append(Notice("rotors_simplified", "note", None, message))
    result = ExportResult(
        file=None,
        patched=None if patch is None else str(patch),
        carried=[ExportedPart(**vars(part)) for part in exported.carried],
        not_carried=[ExportedPart(**vars(part)) for part in exported.not_carried],
        **notice_fields(notices),
    )
    result._text = exported.text
    result._folder = target
    result._name = exported.name
    result._inputs = tuple(inputs)
    return result


def _changes(folder: Path) -> tuple[ChangeReport, ...] | None:
    """The changes that the diagnosis in a folder asks for; None if its model is not from one with ``--against``.

    Raises
    ------
    ModelError
        If diagnosis.json cannot be read.
    """
    file = folder / DIAGNOSIS
    if not file.is_file() or b"idtool diagnose" not in (folder / CONFIG).read_bytes().partition(b"\n")[0]:
        return None
    try:
        against = json.loads(file.read_bytes())["against"]
        return None if against is None else AgainstReport.model_validate(against).changes
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ModelError(file, f"is not the result of idtool diagnose ({type(error).__name__})") from None
