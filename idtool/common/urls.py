"""Logs behind URLs: https, s3, gs and whatever else fsspec opens. Readers get a temporary copy."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import cast

from idtool.common.exceptions import LogError, TransferError
from idtool.common.names import is_url

_BLOCK = 8 << 20  # bytes that are copied at once
_VERSION_KEYS = ("ETag", "etag", "md5Hash", "LastModified", "last_modified", "mtime", "updated", "size")  # of fsspec


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


@contextmanager
def local_copy(path: Path) -> Iterator[Path]:
    """A temporary copy of a file behind a URL; a local file is given as it is.

    Raises
    ------
    TransferError
        If it cannot be read.
    """
    if not is_url(path):
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="idtool-") as folder:
        copy = Path(folder, path.name or "log")
        reason = ""
        try:
            with path.open("rb") as source, copy.open("wb") as target:
                shutil.copyfileobj(source, target, _BLOCK)
        except Exception as error:  # each kind of storage has errors of its own, of which some cannot be pickled
            reason = _reason(error)
        if reason:
            raise TransferError(path, f"cannot be read: {reason}")
        yield copy


def _reason(error: Exception) -> str:
    """Reason why a URL cannot be read."""
    if isinstance(error, FileNotFoundError):
        return "there is no such file; check the URL"
    if isinstance(error, PermissionError):
        return "access is denied; check the credentials"
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def version_of(path: Path) -> str | None:
    """Text that changes when a file or a folder's file does, by size and time; None if that cannot be told."""
    try:
        if is_url(path):
            information = path.fs.info(path.path)  # type: ignore[attr-defined]  # of a URL
            found = [f"{key} {information[key]}" for key in _VERSION_KEYS if information.get(key) is not None]
            return "; ".join(found) or None
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        statuses = [file.stat() for file in files]
    except Exception:  # each kind of storage has errors of its own
        return None
    return "; ".join(f"{status.st_size} {status.st_mtime_ns}" for status in statuses)
