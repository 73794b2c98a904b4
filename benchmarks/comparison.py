"""Times of idtool and of another program for the same task, measured by turns in one run."""

from __future__ import annotations

import importlib
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import metadata


@dataclass(frozen=True)
class Comparison:
    """Times for one task.

    Attributes
    ----------
    task
        The result that both compute.
    peer
        The other program with its version.
    ours, theirs
        Medians of the wall times [s].
    ratio
        Median of theirs / ours over the repetitions, each of two runs that follow one another; above 1, idtool is
        faster.
    least_ratio, greatest_ratio
        Range of that quotient over the repetitions.
    agreement
        How far the two results agree: a number for each measure, which names its unit.
    remark
        Differences between the tasks: what only one of the two does.
    """

    task: str
    peer: str
    ours: float
    theirs: float
    ratio: float
    least_ratio: float
    greatest_ratio: float
    agreement: Mapping[str, float] = field(default_factory=dict)
    remark: str = ""

    def __str__(self) -> str:
        ours, theirs = duration_text(self.ours), duration_text(self.theirs)
        agreement = f"; {self.agreement_text}" if self.agreement else ""
        return f"{self.task}: idtool {ours}, {self.peer} {theirs}: ratio {self.ratio_text}{agreement}"

    @property
    def agreement_text(self) -> str:
        """Names and values of the differences."""
        return "; ".join(f"{name} {value:.3g}" for name, value in self.agreement.items())

    @property
    def ratio_text(self) -> str:
        """The ratio with its range."""
        return f"{number_text(self.ratio)} ({number_text(self.least_ratio)} to {number_text(self.greatest_ratio)})"


def compare(
    task: str,
    peer: str,
    ours: Callable[[], object],
    theirs: Callable[[], object],
    repetitions: int,
    agreement: Mapping[str, float] | None = None,
    remark: str = "",
) -> Comparison:
    """Time two functions by turns.

    Parameters
    ----------
    task, peer, agreement, remark
        See `Comparison`.
    ours, theirs
        The functions. Both should have been called before, so that neither pays for imports.
    repetitions
        Number of calls of each.
    """
    pairs = []
    for _ in range(repetitions):
        pairs.append((_seconds(ours), _seconds(theirs)))
    return from_times(task, peer, pairs, agreement, remark)


def from_times(
    task: str,
    peer: str,
    pairs: list[tuple[float, float]],
    agreement: Mapping[str, float] | None = None,
    remark: str = "",
) -> Comparison:
    """The comparison of times of idtool and of the peer, one pair for each repetition [s]."""
    ratios = [theirs / ours for ours, theirs in pairs]
    return Comparison(
        task=task,
        peer=peer,
        ours=statistics.median(ours for ours, _ in pairs),
        theirs=statistics.median(theirs for _, theirs in pairs),
        ratio=statistics.median(ratios),
        least_ratio=min(ratios),
        greatest_ratio=max(ratios),
        agreement=dict(agreement or {}),
        remark=remark,
    )


def _seconds(action: Callable[[], object]) -> float:
    started = time.perf_counter()
    action()
    return time.perf_counter() - started


def duration_text(seconds: float) -> str:
    """A time with three significant digits, in a unit of its size."""
    if seconds >= 1:
        return f"{seconds:.3g} s"
    if seconds >= 1e-3:
        return f"{seconds * 1e3:.3g} ms"
    return f"{seconds * 1e6:.3g} µs"


def number_text(number: float) -> str:
    """A positive number with two significant digits, without an exponent."""
    return f"{number:.2g}" if number < 99.5 else f"{float(f'{number:.2g}'):.0f}"


def can_import(module: str, attribute: str) -> bool:
    """True if a module is installed with one of its names; some import in part without their optional packages."""
    try:
        return hasattr(importlib.import_module(module), attribute)
    except ImportError:
        return False


def version_text(*packages: str) -> str:
    """Names and versions of installed packages."""
    return " with ".join(f"{package} {metadata.version(package)}" for package in packages)
