"""Files: written whole or not at all."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from idtool.exceptions import IdtoolError


class OutputError(IdtoolError):
    """A place that cannot be written to."""


def as_json(data: Mapping[str, Any]) -> str:
    """Plain data as JSON; numbers are not rounded, and one that is no number is an error."""
    return json.dumps(data, indent=2, allow_nan=False) + "\n"


def as_yaml(data: Mapping[str, Any], header: str) -> str:
    """Plain data as YAML below a comment."""
    lines = "".join(f"# {line}\n" for line in header.splitlines())
    return lines + yaml.safe_dump(dict(data), sort_keys=False, default_flow_style=None, width=120)


def write_all(folder: Path, files: Mapping[str, str | bytes]) -> None:
    """Write files into a folder: all beside their places first, then each moved into it.

    Raises
    ------
    OutputError
        If the folder cannot be made or written to; what was there is as it was.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in files:
            if (folder / name).is_dir():  # before anything is moved into its place
                raise OutputError(folder / name, "is a folder; move it away, or give another --out")
        with tempfile.TemporaryDirectory(dir=folder, prefix=".idtool-") as scratch:
            for name, content in files.items():
                data = content.encode() if isinstance(content, str) else content
                Path(scratch, name).write_bytes(data)
            for name in files:
                os.replace(Path(scratch, name), folder / name)
    except OSError as error:
        raise OutputError(folder, f"cannot be written to ({error.strerror}); give another --out") from None
