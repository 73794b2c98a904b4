"""Numbers and parameters as text."""

from __future__ import annotations

import math
from typing import Any

_MAX_ROWS = 8  # of a parameter that is a table
_NEGLIGIBLE = 1e-9  # of the largest number of a list: only rounding of the computation


def number(x: float | None, digits: int = 3) -> str:
    """A figure to so many digits; a dash for none."""
    if x is None or not math.isfinite(x):
        return "–"
    size = math.floor(math.log10(abs(x))) if x else 0
    return f"{x:.{max(digits - 1 - size, 0)}f}" if -5 < size < 6 else f"{x:.{digits - 1}e}"


def short_number(x: float | None, digits: int = 3) -> str:
    """A figure to at most so many digits, without zeros at the end of its decimals: of limits, rates and times."""
    text = number(x, digits)
    if "." not in text or "e" in text:
        return text
    return text.rstrip("0").rstrip(".")


def with_error(x: float | None, error: float | None, digits: int = 2) -> tuple[str, str]:
    """A figure and its standard error, to so many digits of the error."""
    if x is None:
        return "–", ""
    if error is None or not math.isfinite(error):
        return number(x), "not determined"
    size = math.floor(math.log10(error)) if error else -9
    if not -9 < size < 6:
        return number(x), number(error, digits)
    decimals = max(digits - 1 - size, 0)
    return f"{x:.{decimals}f}", f"{error:.{decimals}f}"


def range_text(low: float | None, high: float | None) -> str:
    """Two ends to two digits of the distance between them; None: no end."""
    if low is None and high is None:
        return "any"
    if high is None:
        return f"{number(low, 2)} or more"
    if low is None:
        return f"{number(high, 2)} or less"
    width = high - low
    if abs(low + high) < 0.01 * width:
        return f"±{number(width / 2, 2)}"
    size = math.floor(math.log10(width)) if width > 0 else -9
    if not -5 < size < 6:
        return f"{number(low, 2)} to {number(high, 2)}"
    decimals = max(1 - size, 0)
    low_text, high_text = (f"{round(x, decimals) + 0.0:.{decimals}f}" for x in (low, high))
    return f"{low_text} to {high_text}"


def parameter_text(
    name: str, value: Any, error: Any = None, unit: str | None = None, digits: int = 3, error_digits: int = 2
) -> str:
    """A parameter with its standard error and unit.

    Parameters
    ----------
    name
        Its name in a configuration.
    value
        A number, several of them, or the name of something; None: not known.
    error
        Standard error of the number, or of each of several; None: not known.
    unit
        Its unit; None or "1": none.
    digits
        Significant digits of a number without standard error.
    error_digits
        Significant digits of a standard error.
    """
    text = f"{name.replace('_', ' ')} {_value_text(value, error, digits, error_digits)}"
    return text if unit in (None, "1") else f"{text} {unit}"


def _value_text(value: Any, error: Any, digits: int, error_digits: int) -> str:
    """A parameter's value; one of several numbers has them in brackets."""
    if isinstance(value, list | tuple):
        has_errors = isinstance(error, list | tuple) and len(error) == len(value)
        errors = error if has_errors else [None] * len(value)
        negligible = _NEGLIGIBLE * max((abs(x) for x in value if isinstance(x, float)), default=0.0)
        texts = []
        for x, e in zip(value, errors, strict=True):
            is_zero = isinstance(x, float) and e is None and abs(x) <= negligible
            texts.append("0" if is_zero else _value_text(x, e, digits, error_digits))
        if len(texts) > _MAX_ROWS:
            return f"[{texts[0]}, …, {texts[-1]}] ({len(texts)} rows)"
        return f"[{', '.join(texts)}]"
    if isinstance(value, bool | str):
        return str(value)
    if value is None or error is None:
        return "0" if value == 0 else number(value, digits)
    return " ± ".join(with_error(value, error, error_digits))
