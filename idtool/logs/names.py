"""Names in messages: a few of many, and the one that was probably meant."""

from __future__ import annotations

import difflib
from collections.abc import Collection

_SHOWN = 6


def some(names: Collection[str]) -> str:
    """The first few of ``names``, and how many more there are."""
    shown = ", ".join(list(names)[:_SHOWN])
    more = len(names) - _SHOWN
    return f"{shown} and {more} more" if more > 0 else shown


def nearest(name: str, known: Collection[str]) -> str:
    """What to write in place of ``name``: the name most like it, or those that there are."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"did you mean {close[0]}?" if close else f"there are: {some(known) or 'none'}"
