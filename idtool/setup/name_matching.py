"""Matches names of sensors to names of links and joints: left_front or FL to FL_foot."""

from __future__ import annotations

import re
from collections.abc import Sequence

_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_SAME_WORDS = {
    "l": "left",
    "r": "right",
    "f": "front",
    "fore": "front",
    "h": "rear",
    "hind": "rear",
    "back": "rear",
    "fl": "front left",
    "fr": "front right",
    "lf": "front left",
    "rf": "front right",
    "rl": "rear left",
    "rr": "rear right",
    "hl": "rear left",
    "hr": "rear right",
    "lh": "rear left",
    "rh": "rear right",
    "bl": "rear left",
    "br": "rear right",
}
FOOT_WORDS = ("foot", "feet", "sole", "toe", "ankle", "paw", "hoof")
SENSOR_WORDS = ("ft", "force", "torque", "wrench", "sensor", "loadcell", "fts")
_WITHOUT_MEANING = {*FOOT_WORDS, *SENSOR_WORDS, "contact", "link", "joint", "frame", "fixed"}


def words(name: str) -> set[str]:
    """The words of a name in lower case, abbreviations of sides in full."""
    found = (word.lower() for word in _WORD.findall(name))
    return {full for word in found for full in _SAME_WORDS.get(word, word).split()}


def match(name: str, candidates: Sequence[str]) -> str | None:
    """The candidate that a name means; None if none or several may be meant.

    That is, first, the candidate with the same name; with the same letters; with the same words that tell a place, the
    first one of several; or the only one that has all these words, and more.
    """
    if name in candidates:
        return name
    letters = _letters(name)
    for candidate in candidates:
        if _letters(candidate) == letters:
            return candidate
    place = words(name) - _WITHOUT_MEANING
    if not place:
        return None
    for candidate in candidates:
        if words(candidate) - _WITHOUT_MEANING == place:
            return candidate
    containing = [candidate for candidate in candidates if words(candidate) > place]
    return containing[0] if len(containing) == 1 else None


def _letters(name: str) -> str:
    return re.sub(r"[\W_]", "", name.lower())
