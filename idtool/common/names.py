"""Names in messages and of files. They are untrusted: in messages they are cut to fit a line of a terminal."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Collection
from pathlib import Path

_MAX_LENGTH = 60
_MAX_LISTED = 6
_MIN_SIMILARITY = 0.5  # of names, by difflib, from 0 to 1
_SECRETS = re.compile(r"(?<=://)[^/@]*@|\?.*")  # of a URL


def printable(name: str) -> str:
    """The name, shortened to fit a line and with unprintable characters escaped."""
    short = name if len(name) <= _MAX_LENGTH else f"{name[:_MAX_LENGTH]}…"
    return short if short.isprintable() else ascii(short)[1:-1]


def join_names(names: Collection[str], most: int = _MAX_LISTED) -> str:
    """The first ``most`` names, separated by commas, and the number of those left out."""
    few = ", ".join(map(printable, list(names)[:most])) or "none"
    more = len(names) - most
    return f"{few} and {more} more" if more > 0 else few


def capitalized(sentence: str) -> str:
    """A sentence with a capital letter; `str.capitalize` would take them from units."""
    return sentence[:1].upper() + sentence[1:]


def count_text(number: int, noun: str) -> str:
    """A number with its noun, in the plural but for one."""
    return f"{number} {noun}" + ("" if number == 1 else "s")


def is_or_are(number: int) -> str:
    """Verb after a number of things."""
    return "is" if number == 1 else "are"


def suggestion(name: str, known: Collection[str]) -> str:
    """Hint for an unknown name: the most similar known one, or a list of the known ones."""
    closest = closest_name(name, known)
    return f"did you mean {printable(closest)}?" if closest else f"available: {join_names(known)}"


def closest_name(name: str, known: Collection[str]) -> str | None:
    """The most similar known name; None if none is similar."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=_MIN_SIMILARITY)
    return close[0] if close else None


def stem(path: Path) -> str:
    """Name of a file without its suffix, or of a folder, whose name has no suffix."""
    return path.name if os.path.isdir(path) else path.stem  # of any name, however long


def is_url(path: str | os.PathLike[str]) -> bool:
    """True for a URL."""
    return "://" in str(path)


def without_secrets(text: str) -> str:
    """A URL without user, password and query, which may hold a signature; any other text as it is."""
    return _SECRETS.sub("", text) if is_url(text) else text
