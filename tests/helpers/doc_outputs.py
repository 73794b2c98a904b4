"""Blocks of output in the documentation against what is printed."""

from __future__ import annotations

import re

import numpy as np

LEFT_OUT = "…"  # a line that stands for lines which the page leaves out

_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w])")
_NEAR = 0.1  # of a number; standard errors and errors of rollouts differ from machine to machine
_TIMES = re.compile(r"simulated in .*")


def check_output(shown: str, said: str, where: str) -> None:
    """That what is shown was printed: all of it, word for word, with numbers that are near.

    Lines that a page leaves out, it marks by a line with only LEFT_OUT; blank lines do not count.
    """
    printed = [line for line in said.splitlines() if line.strip()]
    groups: list[list[str]] = [[]]
    for line in filter(None, map(str.strip, shown.splitlines())):
        if line == LEFT_OUT:
            groups.append([])
        else:
            groups[-1].append(line)
    at = 0
    for i, group in enumerate(groups):
        last = len(printed) - len(group)
        starts = range(last if i == len(groups) - 1 else at, (0 if i == 0 else last) + 1)
        found = [k for k in starts if at <= k <= last and all(map(_alike, group, printed[k:]))]
        assert found, "\n".join(
            [f"{where}: it is not printed, or more is:", *group, "what is printed there:", *printed[at:]]
        )
        at = found[0] + len(group)


def _alike(shown: str, printed: str) -> bool:
    (words, numbers), (others, values) = _split(shown), _split(printed)
    return words == others and np.allclose(numbers, values, rtol=_NEAR, atol=1e-4)


def _split(line: str) -> tuple[str, list[float]]:
    """A line's words, and its numbers."""
    line = _TIMES.sub("", line)
    return " ".join(_NUMBER.sub("#", line).split()), [float(x) for x in _NUMBER.findall(line)]
