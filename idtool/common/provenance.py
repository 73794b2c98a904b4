"""Provenance of a result: the input files with their hashes, and the versions of idtool's libraries."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

_NUMERICAL = ("numpy", "scipy", "clarabel", "pin")  # libraries that figures may depend on


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


def source_from_file(kind: str, path: Path) -> InputFile:
    """A file that was read in blocks; OSError if it can no longer be read."""
    with path.open("rb") as file:
        return InputFile(kind, str(path), hashlib.file_digest(file, "sha256").hexdigest())


def provenance(sources: Sequence[InputFile]) -> dict[str, Any]:
    """Versions and inputs, as under these keys of the JSON files."""
    return {
        "versions": {"python": platform.python_version(), **{name: version(name) for name in _NUMERICAL}},
        "inputs": [asdict(source) for source in sources],
    }
