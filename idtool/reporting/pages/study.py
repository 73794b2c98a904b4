"""study.html: every constraint set side by side, after the paper's Table I, Fig. 4, Fig. 5 and Remark 5."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.estimation.evaluation.torque_errors import Evaluation
from idtool.reporting.number_text import rows_by_unit
from idtool.reporting.pages.base import render
from idtool.reporting.plots.comparison import advantage_figure, learning_figure, online_figure, violation_figure
from idtool.reporting.plots.torques import torque_figures
from idtool.reporting.results.study import Advantage, Convergence, LearningCurve, LearningCurves, StudyReport
from idtool.reporting.sections.study import (
    ConstraintSetsSection,
    EstimatorsSection,
    LearningCurvesSection,
    OnlineSection,
)

_ONLINE_SECTION = OnlineSection()
_SECTIONS = (
    ("Findings", "study_findings.html"),
    ConstraintSetsSection(),
    LearningCurvesSection(),
    ("Realizability against the number of samples", "study_violation.html"),
    ("Measured and predicted torque", "torques.html"),
    EstimatorsSection(),
    _ONLINE_SECTION,
    ("Origin of this report", "origin.html"),
)
_MAX_DIFFERENCE = 0.05  # what the sets' errors differ by where the curves have come together
_SHORT_LOG_SAMPLES = 30  # samples: what a short log is called in the findings
_MIN_SIGNIFICANCE = 3.0  # standard errors: several sets are compared, and twice would be passed by chance too often
_SOLVER_ACCURACY = 1e-4  # logarithmic differences below this may be the solver's


@dataclass(frozen=True)
class Comparison:
    """A set's error beside the first set's, from the same draws, in the geometric mean.

    Attributes
    ----------
    name
        The set.
    gain, error
        How much less its error is, as a share, in the mean over the counts called few, and the standard error.
    clear
        Whether that is beyond three standard errors, either way.
    most
        The largest gain: its number of samples, the gain and its standard error.
    """

    name: str
    gain: float
    error: float
    clear: bool
    most: tuple[int, float, float]


@dataclass(frozen=True)
class LearningSummary:
    """Findings of Fig. 5: the order of the sets, and the number of samples at which they meet.

    Attributes
    ----------
    order
        The sets by their mean advantage over the first one with few samples, the best first; without those that have
        none at one of these counts, for want of draws that were solved.
    compared
        All of them but the first one, in this order.
    counts
        The numbers of samples called few; empty where the sets are alike from the first.
    together
        The number of samples from which on all sets' errors are within a twentieth; None: not even at the last.
    """

    order: tuple[str, ...] = ()
    compared: tuple[Comparison, ...] = ()
    counts: tuple[int, ...] = ()
    together: int | None = None


def study_page(evaluation: Evaluation, report: StudyReport, command: str) -> str:
    """study.html.

    Parameters
    ----------
    evaluation
        Of the tightest set's model ``identified`` on the held-out data; its curve ``q``, if it has one, is drawn too.
    report
        The content of study.json.
    command
        The command line that made it.
    """
    units = report.units
    has_online_estimate = bool(report.adaptation.error)
    sections = [section for section in _SECTIONS if section is not _ONLINE_SECTION or has_online_estimate]
    return render(
        f"{Path(report.urdf).stem}: comparison of constraint sets",
        sections,
        [],
        {},
        report=report,
        torques=torque_figures(evaluation, "identified", units, position=True),
        errors=learning_figure(report),
        advantages=advantage_figure(report),
        violations=violation_figure(report),
        online_errors=online_figure(report) if has_online_estimate else None,
        groups=rows_by_unit(units),
        learning=learning(report.learning),
        **_short_log_view(report.learning),
        online=_online_view(report.adaptation),
        where="On the held-out data, with the tightest set (cf. Fig. 4 of Wensing et al. 2018)",
        command=command,
    )


def learning(report: LearningCurves) -> LearningSummary:
    """Findings of Fig. 5.

    Parameters
    ----------
    report
        ``learning`` of study.json.
    """
    counts = report.counts
    names = list(report.curves)
    medians = _values(report.curves, "median")
    advantage = _values(report.advantage, "advantage")
    error = _values(report.advantage, "advantage_error")
    # A single draw, of all the data, has a median only. NaN counts as different.
    is_single = np.isnan(advantage).any(axis=0)
    similar_medians = np.ptp(medians, axis=0) <= _MAX_DIFFERENCE * medians.min(axis=0)
    similar_advantages = np.ptp(advantage, axis=0) <= np.log1p(_MAX_DIFFERENCE)
    different = np.flatnonzero(~np.where(is_single, similar_medians, similar_advantages))
    few = int(different[-1]) + 1 if len(different) else 0
    together = counts[few] if few < len(counts) else None
    if together is None:
        few = (len(counts) + 1) // 2
    if not few:
        return LearningSummary(together=together)
    mean = advantage[:, :few].mean(axis=1)
    order = [i for i in np.argsort(-mean, kind="stable") if np.isfinite(mean[i])]
    return LearningSummary(
        order=tuple(names[i] for i in order),
        compared=tuple(_compare(names[i], counts, advantage[i, :few], error[i, :few]) for i in order if i),
        counts=tuple(counts[:few]),
        together=together,
    )


def _compare(name: str, counts: Sequence[int], advantage: Array, error: Array) -> Comparison:
    """A set beside the first one, by its advantages, shape (few,), and their standard errors."""
    # A draw's samples at one count are among those at the next, so that more counts need not make the mean surer.
    mean = advantage.mean()
    mean_error = error.mean()
    clear = bool(abs(mean) > max(_MIN_SIGNIFICANCE * mean_error, _SOLVER_ACCURACY))
    gain, gain_error = _gain_and_error(mean, mean_error)
    best = int(advantage.argmax())
    return Comparison(name, gain, gain_error, clear, (counts[best], *_gain_and_error(advantage[best], error[best])))


def _values(curves: Mapping[str, LearningCurve | Advantage], field: str) -> Array:
    """A field of the sets' curves, shape (sets, counts)."""
    return np.array([getattr(curve, field) for curve in curves.values()])


def _gain_and_error(advantage: float, error: float) -> tuple[float, float]:
    """An advantage, the logarithm of a ratio, as the share by which the error is less, and its standard error."""
    return float(-np.expm1(-advantage)), float(np.exp(-advantage) * error)


def _short_log_view(report: LearningCurves) -> dict[str, Any]:
    """The number of samples nearest to a short log's, and the violations of realizability there, by set."""
    index = int(np.argmin(np.abs(np.log(np.array(report.counts) / _SHORT_LOG_SAMPLES))))
    violations = {}
    for name, values in report.violation.items():
        if values[index] > 0:
            violations[name] = float(values[index])
    return {"short": report.counts[index], "breaking": violations}


def _online_view(report: Convergence) -> tuple[list[tuple[str, float]], list[str]]:
    """The sets whose error fell below 10 %, with their times, earliest first; and the other sets."""
    times = report.time_to_10_percent
    reached: dict[float, list[str]] = {}
    for name, t in times.items():
        if t is not None:
            reached.setdefault(t, []).append(name)
    ordered = [(" and ".join(names), t) for t, names in sorted(reached.items())]
    return ordered, [name for name, t in times.items() if t is None]
