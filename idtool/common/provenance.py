"""Where a result comes from: the files that were read, by their hashes, and the versions of what computed it."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

_DECISIVE = ("numpy", "scipy", "clarabel", "pin")  # libraries that figures may depend on


@dataclass(frozen=True)
class Source:
    """Something that was read.

    Attributes
    ----------
    kind
        ``URDF``, ``configuration`` or ``log``.
    path
        The file, as it was named.
    sha256
        Of its bytes, in hexadecimal; None where it is no file.
    """

    kind: str
    path: str
    sha256: str | None


def source_of(kind: str, path: Path, data: bytes) -> Source:
    """What was read of a file at once."""
    return Source(kind, str(path), hashlib.sha256(data).hexdigest())


def source_file(kind: str, path: Path) -> Source:
    """A file that was read piece by piece; OSError if it can no longer be read."""
    with path.open("rb") as file:
        return Source(kind, str(path), hashlib.file_digest(file, "sha256").hexdigest())


def provenance(sources: Sequence[Source]) -> dict[str, Any]:
    """``versions`` and ``inputs`` of the JSON files."""
    return {
        "versions": {"python": platform.python_version(), **{name: version(name) for name in _DECISIVE}},
        "inputs": [asdict(source) for source in sources],
    }
