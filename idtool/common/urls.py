"""Logs behind URLs: https, s3, gs and whatever else fsspec opens. Readers get a temporary copy."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import cast

from idtool.common.exceptions import LogError

_BLOCK = 8 << 20  # bytes that are copied at once


def log_path(path: str | os.PathLike[str]) -> Path:
    """Path of a log; for a URL, an object with a path's methods.

    Raises
    ------
    LogError
        If it is a URL, and the packages that open URLs are not installed.
    """
    if not is_url(path):
        return Path(path)
    try:
        from upath import UPath
    except ImportError:
        what = "is a URL, which needs packages that are not installed; run pip install 'idtool[cluster]'"
        raise LogError(path, what) from None
    try:
        return cast("Path", UPath(path))
    except (ValueError, ImportError, OSError) as error:
        raise LogError(path, f"cannot be opened: {error}") from None


def is_url(path: str | os.PathLike[str]) -> bool:
    """True for a URL."""
    return "://" in str(path)


@contextmanager
def local_copy(path: Path) -> Iterator[Path]:
    """A temporary copy of a file behind a URL; a local file is given as it is.

    Raises
    ------
    LogError
        If it cannot be read.
    """
    if not is_url(path):
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="idtool-") as folder:
        copy = Path(folder, path.name or "log")
        try:
            with path.open("rb") as source, copy.open("wb") as target:
                shutil.copyfileobj(source, target, _BLOCK)
        except Exception as error:  # each kind of storage has errors of its own
            reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
            raise LogError(path, f"cannot be read: {reason}") from None
        yield copy


def version_of(path: Path) -> str:
    """Text that changes when a file does, by its size and time; empty if that cannot be told."""
    try:
        if is_url(path):
            return str(path.fs.ukey(path.path))  # type: ignore[attr-defined]  # of a URL
        status = path.stat()
    except Exception:  # each kind of storage has errors of its own
        return ""
    return f"{status.st_size} {status.st_mtime_ns}"
