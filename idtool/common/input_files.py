"""Messages about input files that cannot be read: what is wrong, and what to do."""

from __future__ import annotations

import os
from contextlib import suppress
from itertools import islice
from pathlib import Path

from idtool.common.names import closest_name, printable

_MAX_FILES = 10_000  # of a folder, among which a similar name is looked for

REDUCTION_SUFFIX = ".idr"  # of files of `idtool reduce`


def read_error_text(path: Path, error: OSError) -> str:
    """Reason why a file cannot be read, and advice."""
    what = f"cannot be read ({error.strerror})"
    if isinstance(error, IsADirectoryError):
        return f"{what}; give a file"
    if isinstance(error, PermissionError):
        return f"{what}; change its permissions"
    return f"{what}; {missing_file_advice(path)}"


def missing_file_advice(path: Path) -> str:
    """Advice about a file that does not exist: a file in the folder with a similar name, or to check the path."""
    names: dict[str, str] = {}
    with suppress(OSError, ValueError), os.scandir(path.parent) as entries:  # a path that no folder can have
        for entry in islice(entries, _MAX_FILES):
            other = Path(entry.name)
            if other.suffix.lower() == path.suffix.lower():
                names[other.stem] = entry.name
    closest = closest_name(path.stem, names)
    return f"did you mean {printable(names[closest])}?" if closest else "check the path"
