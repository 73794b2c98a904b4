"""Blocks of output in the documentation against what is printed."""

from __future__ import annotations

import re
from difflib import SequenceMatcher

import numpy as np

LEFT_OUT = "…"  # a line that stands for lines which the page leaves out

_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w])")
_NEAR = 0.1  # of a number; standard errors and errors of rollouts differ from machine to machine
_TIMES = re.compile(r"simulated in .*|duality gap of \S+")


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
            [
                f"{where}: these lines are not printed, or others stand between them:",
                *group,
                "This is printed:",
                *printed[at:],
                "`pytest tests/docs --update-docs` writes what is printed into the page.",
            ]
        )
        at = found[0] + len(group)


def updated_output(shown: str, said: str) -> str:
    """A block with the lines as they are printed now; lines that it leaves out stay left out.

    A run of lines without LEFT_OUT becomes what is printed from the line most like its first to the one most like its
    last.
    """
    printed = said.strip("\n").splitlines()
    runs: list[list[str]] = [[]]
    for line in shown.splitlines():
        if line.strip() == LEFT_OUT:
            runs.append([])
        else:
            runs[-1].append(line)
    updated: list[str] = []
    start = 0
    for i, run in enumerate(runs):
        if i > 0:
            updated.append(LEFT_OUT)
        lines = [line for line in run if line.strip()]
        if not lines:
            continue
        first = 0 if i == 0 else _most_similar(lines[0], printed, start)
        end = len(printed) if i == len(runs) - 1 else _most_similar(lines[-1], printed, first) + 1
        updated += printed[first:end]
        start = end
    return "\n".join(updated)


def _most_similar(line: str, printed: list[str], start: int) -> int:
    """Index of the printed line most like the shown one, from ``start`` on; the first of several."""
    words = _split(line)[0].split()
    similarity = [SequenceMatcher(None, words, _split(other)[0].split()).ratio() for other in printed[start:]]
    return start + similarity.index(max(similarity))


def _alike(shown: str, printed: str) -> bool:
    (words, numbers), (others, values) = _split(shown), _split(printed)
    return words == others and np.allclose(numbers, values, rtol=_NEAR, atol=1e-4)


def _split(line: str) -> tuple[str, list[float]]:
    """A line's words, and its numbers."""
    line = _TIMES.sub("", line)
    return " ".join(_NUMBER.sub("#", line).split()), [float(x) for x in _NUMBER.findall(line)]
