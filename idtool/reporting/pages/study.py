"""study.html: every constraint set side by side, after the paper's Table I, Fig. 4, Fig. 5 and Remark 5."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from idtool.common.arrays import Array
from idtool.estimation.evaluation.validation import Evaluation
from idtool.reporting.figures import by_unit
from idtool.reporting.pages.base import render
from idtool.reporting.pages.charts import chart, line, over_time, panel, thinned
from idtool.reporting.pages.curves import curves
from idtool.reporting.results.study import Advantage, Convergence, LearningCurve, StudyReport
from idtool.reporting.results.study import Learning as LearningReport
from idtool.reporting.sections.study import (
    ConstraintSetsSection,
    EstimatorsSection,
    LearningCurvesSection,
    OnlineSection,
)

_SECTIONS = (
    ("What was found", "study_findings.html"),
    ConstraintSetsSection(),
    LearningCurvesSection(),
    ("Realizability against the number of samples", "study_violation.html"),
    ("Measured and predicted torque", "torques.html"),
    EstimatorsSection(),
    OnlineSection(),
    ("How this was made", "origin.html"),
)
# A set has one colour in all charts; the rest follow.
_ORDER = ("none", "semi", "known_com", "com_ellipsoid", "points", "full", "ellipsoid", "shape")
_ALIKE = 0.05  # what the sets' errors differ by where the curves have come together
_SHORT = 30  # samples: what a short log is called in the findings
_MOST_TIMES = 1000
_SURE = 3.0  # standard errors: several sets are compared, and twice would be passed by chance too often
_SOLVED = 1e-4  # logarithmic differences below this may be the solver's
_BAND = 2.0  # standard errors


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
        Where it is largest: the number of samples, the gain there and its standard error.
    """

    name: str
    gain: float
    error: float
    clear: bool
    most: tuple[int, float, float]


@dataclass(frozen=True)
class Learning:
    """What Fig. 5 says.

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
    return render(
        f"{Path(report.urdf).stem}: what each constraint set is worth",
        _SECTIONS,
        ["torques.js", "lines.js"],
        {**curves(evaluation, "identified", units), "charts": charts(report)},
        report=report,
        groups=by_unit(units),
        learning=learning(report.learning),
        **_short(report.learning),
        online=_online(report.adaptation),
        where="Fig. 4 of the paper: on the held-out data, with the tightest set",
        command=command,
    )


def learning(found: LearningReport) -> Learning:
    """What Fig. 5 says in words.

    Parameters
    ----------
    found
        ``learning`` of study.json.
    """
    counts, names = found.counts, list(found.curves)
    medians = _table(found.curves, "median")
    advantage, error = (_table(found.advantage, kind) for kind in ("advantage", "advantage_error"))
    # A single draw, of all the data, has a median only. NaN is apart.
    single, near = np.isnan(advantage).any(axis=0), np.ptp(medians, axis=0) <= _ALIKE * medians.min(axis=0)
    apart = np.flatnonzero(~np.where(single, near, np.ptp(advantage, axis=0) <= np.log1p(_ALIKE)))
    few = int(apart[-1]) + 1 if len(apart) else 0
    together = counts[few] if few < len(counts) else None
    few = few if together is not None else (len(counts) + 1) // 2
    if not few:
        return Learning(together=together)
    mean = advantage[:, :few].mean(axis=1)
    order = [i for i in np.argsort(-mean, kind="stable") if np.isfinite(mean[i])]
    return Learning(
        order=tuple(names[i] for i in order),
        compared=tuple(_compared(names[i], counts, advantage[i, :few], error[i, :few]) for i in order if i),
        counts=tuple(counts[:few]),
        together=together,
    )


def _compared(name: str, counts: Sequence[int], advantage: Array, error: Array) -> Comparison:
    """A set beside the first one, by its advantages, shape (few,), and their standard errors."""
    # A draw's samples at one count are among those at the next, so that more counts need not make the mean surer.
    mean, sure, at = advantage.mean(), error.mean(), int(advantage.argmax())
    clear = bool(abs(mean) > max(_SURE * sure, _SOLVED))
    return Comparison(name, *_share(mean, sure), clear, (counts[at], *_share(advantage[at], error[at])))


def _table(found: Mapping[str, LearningCurve | Advantage], kind: str) -> Array:
    """The values of a kind, shape (sets, counts)."""
    return np.array([getattr(values, kind) for values in found.values()])


def _share(advantage: float, error: float) -> tuple[float, float]:
    """An advantage, the logarithm of a ratio, as the share by which the error is less, and its standard error."""
    return float(-np.expm1(-advantage)), float(np.exp(-advantage) * error)


def _short(found: LearningReport) -> dict[str, Any]:
    """The number of samples nearest to a short log's, and by how much sets violate realizability there."""
    index = int(np.argmin(np.abs(np.log(np.array(found.counts) / _SHORT))))
    amounts = {name: float(values[index]) for name, values in found.violation.items()}
    return {"short": found.counts[index], "breaking": {name: x for name, x in amounts.items() if x > 0}}


def _online(found: Convergence) -> tuple[list[tuple[str, float]], list[str]]:
    """The sets whose error fell below 10 % with their times, the first first, and the others."""
    times = found.time_to_10_percent
    reached: dict[float, list[str]] = {}
    for name, t in times.items():
        if t is not None:
            reached.setdefault(t, []).append(name)
    ordered = [(" and ".join(names), t) for t, names in sorted(reached.items())]
    return ordered, [name for name, t in times.items() if t is None]


def charts(report: StudyReport) -> dict[str, Any]:
    """What `lines.js` draws: Fig. 5, the advantages, the violations and, where it was run, Remark 5."""
    found = report.learning
    first, *others = found.curves
    error = [
        line(name, curve.median, _color(name, found.curves), (curve.lower, curve.upper))
        for name, curve in found.curves.items()
    ]
    gains = []
    for name in others:
        advantage, wide = found.advantage[name].advantage, found.advantage[name].advantage_error
        y, lower, upper = (-100 * np.expm1(-advantage - k * wide) for k in (0, -_BAND, _BAND))
        gains.append(line(name, y, _color(name, found.curves), (lower, upper)))
    title = f"RMS torque error [{by_unit(report.units)[-1][0]}]"
    panels = {
        "learning": ("Fig. 5: held-out error", panel(title, error, log=True)),
        "advantage": (f"Held-out error below that with {first}", panel("error less by [%]", gains, level=0)),
        "violation": ("Worst violation of realizability", panel("violation, relative", _lines(found.violation))),
    }
    drawn = {
        name: chart(caption, found.counts, "samples to fit", [one], log=True) for name, (caption, one) in panels.items()
    }
    online = report.adaptation
    kept = thinned(len(online.t), _MOST_TIMES)
    lines = _lines({name: values[kept] for name, values in online.error.items()})
    error_over_time = panel("relative error", lines, log=True, level=0.1)
    drawn["online"] = over_time("Remark 5: error of the parameters, online", online.t[kept], [error_over_time])
    return drawn


def _lines(curves: Mapping[str, Sequence[float | None] | Array]) -> list[dict[str, Any]]:
    return [line(name, values, _color(name, curves)) for name, values in curves.items()]


def _color(name: str, names: Mapping[str, Any]) -> int:
    return _ORDER.index(name) if name in _ORDER else len(_ORDER) + list(names).index(name)
