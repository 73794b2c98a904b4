"""Provenance of a result: the input files with their hashes, and the versions of idtool's libraries."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from idtool.common.dataclass import dataclass

_NUMERICAL = ("numpy", "scipy", "clarabel", "pin")  # libraries that figures may depend on
_BLOCK_BYTES = 1 << 20


@dataclass(frozen=True)
class InputFile:
    """A file that was read.

    Attributes
    ----------
    kind
        ``URDF``, ``configuration``, ``mesh``, ``log`` or ``bag metadata``.
    path
        The path as given.
    sha256
        Hash of its bytes in hexadecimal; None where there is no file.
    """

    kind: str
    path: str
    sha256: str | None


def source_from_bytes(kind: str, path: Path, data: bytes) -> InputFile:
    """A file whose bytes were read at once."""
    return InputFile(kind, str(path), hashlib.sha256(data).hexdigest())


def source_from_file(kind: str, path: Path, must_end: Callable[[], bool] = lambda: False) -> InputFile:
    """A file that is read in blocks.

    Parameters
    ----------
    kind, path
        As in `InputFile`.
    must_end
        Function that tells from block to block if its hash is no longer needed; it is then of a part of the file.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    digest = hashlib.sha256()
    with path.open("rb", buffering=0) as file:
        while (block := file.read(_BLOCK_BYTES)) and not must_end():
            digest.update(block)
    return InputFile(kind, str(path), digest.hexdigest())


def provenance(sources: Sequence[InputFile]) -> dict[str, Any]:
    """Versions and inputs, as under these keys of the JSON files."""
    return {
        "versions": {"python": platform.python_version(), **{name: version(name) for name in _NUMERICAL}},
        "inputs": [asdict(source) for source in sources],
    }
