"""Text of the findings."""

from __future__ import annotations


def count_text(number: int, noun: str) -> str:
    """A number with its noun, in the plural but for one."""
    return f"{number} {noun}" + ("" if number == 1 else "s")
