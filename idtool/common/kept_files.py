"""Files made from those of installed packages, kept beside a module as Python keeps its compiled form.

They save work of the next process. Where Python may not write, or is told not to, nothing is kept.
"""

from __future__ import annotations

import importlib.util
import os
import sys
import tempfile
from contextlib import suppress
from pathlib import Path


def read_kept(module_file: str, name: str) -> bytes | None:
    """Content of a kept file; None if there is none.

    Parameters
    ----------
    module_file
        ``__file__`` of the module that it belongs to.
    name
        Name of the file. It, or the content, tells what that depends on, such as versions.
    """
    try:
        return _path(module_file, name).read_bytes()
    except (OSError, NotImplementedError):
        return None


def keep(module_file: str, name: str, content: bytes) -> None:
    """Keep a file for `read_kept`, if that is possible."""
    if sys.dont_write_bytecode:
        return
    with suppress(OSError, NotImplementedError):
        path = _path(module_file, name)
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:  # others may read it meanwhile
            try:
                file.write(content)
                file.close()
                os.chmod(file.name, 0o644)
                os.replace(file.name, path)
            except OSError:
                os.unlink(file.name)


def _path(module_file: str, name: str) -> Path:
    """File in which it is kept; NotImplementedError where Python keeps no compiled modules."""
    return Path(importlib.util.cache_from_source(module_file)).with_name(name)
