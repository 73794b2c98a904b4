"""Names in messages and of files. They are untrusted: in messages they are cut to fit a line of a terminal."""

from __future__ import annotations

import difflib
import os
from collections.abc import Collection
from pathlib import Path

_MAX_LENGTH = 60
_MAX_LISTED = 6


def printable(name: str) -> str:
    """The name, cut to a length that can be read, and without characters that cannot be printed."""
    short = name if len(name) <= _MAX_LENGTH else f"{name[:_MAX_LENGTH]}…"
    return short if short.isprintable() else ascii(short)[1:-1]


def join_names(names: Collection[str]) -> str:
    """The first few of ``names``, and how many more there are."""
    few = ", ".join(map(printable, list(names)[:_MAX_LISTED])) or "none"
    more = len(names) - _MAX_LISTED
    return f"{few} and {more} more" if more > 0 else few


def suggestion(name: str, known: Collection[str]) -> str:
    """What to write in place of ``name``: the name most like it, or those that there are."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"did you mean {printable(close[0])}?" if close else f"available: {join_names(known)}"


def stem(path: Path) -> str:
    """A file's name without its ending, or a folder's name, in which a dot begins no ending."""
    return path.name if os.path.isdir(path) else path.stem  # of any name, however long
