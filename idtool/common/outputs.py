"""Atomic file output: all of a command's files are written, or none."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml

from idtool.common.exceptions import IdtoolError
from idtool.common.interrupt import delay_interrupt


class OutputError(IdtoolError):
    """A file or folder that cannot be written to."""


def as_json(data: Mapping[str, Any]) -> str:
    """Plain data as JSON; numbers are not rounded, and NaN or infinity is an error."""
    return json.dumps(data, indent=2, allow_nan=False) + "\n"


def as_yaml(data: Mapping[str, Any], header: str) -> str:
    """Plain data as YAML below a comment."""
    lines = "".join(f"# {line}\n" for line in header.splitlines())
    return lines + yaml.safe_dump(dict(data), sort_keys=False, default_flow_style=None, width=120)


def write_all(folder: Path, files: Mapping[str, str | bytes]) -> None:
    """Write files into a folder: all into a temporary folder first, then each moved into place.

    A name may be a path within the folder.

    Raises
    ------
    OutputError
        If the folder cannot be made or written to; existing files are unchanged.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in files:
            if (folder / name).is_dir():  # before any file is moved
                raise OutputError(folder / name, "is a folder; remove it, or give another --out")
        with tempfile.TemporaryDirectory(dir=folder, prefix=".idtool-") as scratch:
            for name, content in files.items():
                data = content.encode() if isinstance(content, str) else content
                Path(scratch, name).parent.mkdir(parents=True, exist_ok=True)
                Path(scratch, name).write_bytes(data)
                Path(folder, name).parent.mkdir(parents=True, exist_ok=True)
            with delay_interrupt():
                for name in files:
                    os.replace(Path(scratch, name), folder / name)
    except OSError as error:
        raise OutputError(folder, f"cannot be written to ({error.strerror}); give another --out") from None


def check_folder(folder: Path, option: str = "--out") -> None:
    """Check, before the work is done, that files can be written into a folder.

    Parameters
    ----------
    folder
        The folder, which need not exist.
    option
        Option that it is given with, for messages.

    Raises
    ------
    OutputError
        If they can't.
    """
    paths = (folder, *folder.absolute().parents)
    existing = next((path for path in paths if os.path.lexists(path)), Path("/"))
    if not existing.is_dir():
        kind = "a file" if os.path.exists(existing) else "a link to nothing"
        raise OutputError(existing, f"is {kind}, but a folder is needed; give another {option}")
    try:
        with tempfile.TemporaryDirectory(dir=existing, prefix=".idtool-"):
            pass  # permissions alone do not tell: some file systems take no files from anyone
    except OSError as error:
        raise OutputError(folder, f"cannot be written to ({error.strerror}); give another {option}") from None


def check_file(file: Path, inputs: Iterable[Path], option: str = "--out") -> None:
    """Check, before the work is done, that a file can be written and is not one of the inputs.

    Parameters
    ----------
    file
        The file, which need not exist.
    inputs
        Files that are read.
    option
        Option that it is given with, for messages.

    Raises
    ------
    OutputError
        If it can't, or is.
    """
    if any(file.resolve() == path.resolve() for path in inputs):
        raise OutputError(file, f"is an input file; give another {option}")
    if os.path.isdir(file):
        raise OutputError(file, f"is a folder; give a file as {option}")
    check_folder(file.parent, option)
