"""Bound on what a log file may expand to, so that a small hostile file cannot fill memory or disk."""

from __future__ import annotations

from pathlib import Path

from idtool.common.exceptions import LogError

_MAX_EXPANSION = 256  # ratio of the expanded size to the size on disk
_FREE_BYTES = 1 << 28  # that even a small file may expand to


def check_expanded_size(path: Path, expanded: int, on_disk: int) -> None:
    """Raise LogError if a file of ``on_disk`` bytes has expanded, or says that it expands, to too many bytes."""
    if expanded > _MAX_EXPANSION * on_disk + _FREE_BYTES:
        raise LogError(path, f"expands to more than {_MAX_EXPANSION} times its size; it is not a robot log")
