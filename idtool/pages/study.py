"""study.html: every constraint set side by side, after the paper's Table I, Fig. 4, Fig. 5 and Remark 5."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from idtool.pages.base import render
from idtool.pages.charts import Array, chart, line, numbers, over_time, panel, thinned
from idtool.pages.curves import curves
from idtool.pages.figures import by_unit
from idtool.validate import Evaluation

_SECTIONS = (
    ("What was found", "study_findings.html"),
    ("Constraint sets", "study_sets.html"),
    ("Error against the number of samples", "study_learning.html"),
    ("Realizability against the number of samples", "study_violation.html"),
    ("Measured and predicted torque", "torques.html"),
    ("Estimators", "study_estimators.html"),
    ("Online", "study_online.html"),
    ("How this was made", "origin.html"),
)
# A set has one colour in all charts; the rest follow.
_ORDER = ("none", "semi", "known_com", "com_ellipsoid", "points", "full", "ellipsoid", "shape")
_ALIKE = 0.05  # what the sets' errors differ by where the curves have come together
_TIE = 0.01
_SHORT = 30  # samples: what a short log is called in the findings
_MOST_TIMES = 1000
_MANY = 10  # draws whose quartiles say how sure a median is
_MEDIAN = 0.93
_SURE = 3.0  # standard errors: passed by 2 % of four sets alike, where twice would be by 20 %
_TINY = np.finfo(float).tiny


@dataclass(frozen=True)
class Learning:
    """What Fig. 5 says.

    Attributes
    ----------
    order
        The sets by their mean logarithmic median error with few samples, the least first.
    best
        Those of them within a hundredth of the first.
    counts
        The numbers of samples called few; empty where the sets are alike from the first.
    wins
        At how many of these a set of ``best`` has the least error.
    gain
        How much less the first's error is than the worst's, in the mean over these counts, as a share.
    worst
        The last of the sets that have an error at each of these counts.
    clear
        Whether the gain is more than three times the standard error that the random draws leave in it; three, not
        two, for these are the best and the worst of several sets.
    example
        Where it is least in comparison: the number of samples, the first's error and the worst's.
    together
        The number of samples from which on all sets' errors are within a twentieth; None: not even at the last.
    """

    order: tuple[str, ...] = ()
    best: tuple[str, ...] = ()
    counts: tuple[int, ...] = ()
    wins: int = 0
    gain: float = 0.0
    worst: str = ""
    clear: bool = False
    example: tuple[int, float, float] | None = None
    together: int | None = None


def study_page(evaluation: Evaluation, report: dict[str, Any], command: str) -> str:
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
    units = report["units"]
    return render(
        f"{Path(report['urdf']).stem}: what each constraint set is worth",
        _SECTIONS,
        ["torques.js", "lines.js"],
        {**curves(evaluation, "identified", units), "charts": charts(report)},
        report=report,
        groups=by_unit(units),
        learning=learning(report["learning"]),
        **_short(report["learning"]),
        online=_online(report["adaptation"]),
        where="Fig. 4 of the paper: on the held-out data, with the tightest set",
        command=command,
        inputs={"URDF": [report["urdf"]], "logs": report["logs"]},
    )


def learning(found: Mapping[str, Any]) -> Learning:
    """What Fig. 5 says in words.

    Parameters
    ----------
    found
        ``learning`` of study.json.
    """
    counts = list(found["counts"])
    names = list(found["curves"])
    medians, lower, upper = (_table(found, kind) for kind in ("median", "lower", "upper"))
    apart = ~(medians.max(axis=0) <= (1 + _ALIKE) * medians.min(axis=0))  # NaN is apart
    last = int(np.flatnonzero(apart)[-1]) if apart.any() else -1
    together = counts[last + 1] if last + 1 < len(counts) else None
    few = last + 1 if together is not None else (len(counts) + 1) // 2
    score = _mean_log(medians[:, :few]) if few else np.full(len(names), np.inf)
    order = np.argsort(score, kind="stable")
    solved = order[np.isfinite(score[order])]
    if not len(solved):
        return Learning(together=together)
    best = solved[score[solved] <= score[order[0]] + np.log1p(_TIE)]
    first, worst = medians[order[0], :few], medians[solved[-1], :few]
    at = int(np.argmax(worst / np.maximum(first, _TINY)))
    difference = float(score[solved[-1]] - score[order[0]])
    noise = _noise(lower[:, :few], upper[:, :few], found["draws"])
    return Learning(
        order=tuple(names[i] for i in order),
        best=tuple(names[i] for i in best),
        counts=tuple(counts[:few]),
        wins=int(np.count_nonzero((medians[best, :few] <= np.fmin.reduce(medians[:, :few])).any(axis=0))),
        gain=float(-np.expm1(-difference)),
        worst=names[solved[-1]],
        clear=bool(found["draws"] >= _MANY and difference > _SURE * np.hypot(noise[order[0]], noise[solved[-1]])),
        example=(counts[at], float(first[at]), float(worst[at])),
        together=together,
    )


def _table(found: Mapping[str, Any], kind: str) -> Array:
    """Medians or quartiles, shape (sets, counts)."""
    return np.array([numbers(curve[kind]) for curve in found["curves"].values()])


def _noise(lower: Array, upper: Array, draws: int) -> Array:
    """Standard error of the mean over counts of the logarithmic median, from quartiles (sets, counts); shape (sets,).

    Draws that are normal in the logarithm have a median with the standard error 0.93 (upper − lower) / √draws.
    """
    spread = np.log(np.maximum(upper, _TINY) / np.maximum(lower, _TINY))
    return np.asarray(_MEDIAN * np.sqrt(np.square(spread).sum(axis=1) / draws) / spread.shape[1])


def _mean_log(medians: Array) -> Array:
    """The mean logarithm over counts, infinite where a set has no error at one of them; shape (sets,)."""
    logs = np.log(np.maximum(medians, _TINY))
    return np.asarray(np.where(np.isnan(logs), np.inf, logs).mean(axis=1))


def _short(found: Mapping[str, Any]) -> dict[str, Any]:
    """The number of samples nearest to a short log's, and by how much sets violate realizability there."""
    index = int(np.argmin(np.abs(np.log(np.array(found["counts"]) / _SHORT))))
    amounts = {name: numbers(values)[index] for name, values in found["violation"].items()}
    return {"short": found["counts"][index], "breaking": {name: x for name, x in amounts.items() if x > 0}}


def _online(found: Mapping[str, Any] | None) -> tuple[list[tuple[str, float]], list[str]]:
    """The sets whose error fell below 10 % with their times, the first first, and the others."""
    times = found["time_to_10_percent"] if found else {}
    reached: dict[float, list[str]] = {}
    for name, t in times.items():
        if t is not None:
            reached.setdefault(t, []).append(name)
    ordered = [(" and ".join(names), t) for t, names in sorted(reached.items())]
    return ordered, [name for name, t in times.items() if t is None]


def charts(report: Mapping[str, Any]) -> dict[str, Any]:
    """What `lines.js` draws: Fig. 5, the violations and, where it was run, Remark 5."""
    found = report["learning"]
    counts = "samples to fit"
    error = [
        line(name, curve["median"], _color(name, found["curves"]), (curve["lower"], curve["upper"]))
        for name, curve in found["curves"].items()
    ]
    title = f"RMS torque error [{by_unit(report['units'])[-1][0]}]"
    drawn = {
        "learning": chart("Fig. 5: held-out error", found["counts"], counts, [panel(title, error, log=True)], log=True),
        "violation": chart(
            "Worst violation of realizability",
            found["counts"],
            counts,
            [panel("violation, relative", _lines(found["violation"]))],
            log=True,
        ),
    }
    if online := report["adaptation"]:
        kept = thinned(len(online["t"]), _MOST_TIMES)
        lines = _lines({name: numbers(values)[kept] for name, values in online["error"].items()})
        error_over_time = panel("relative error", lines, log=True, level=0.1)
        t = numbers(online["t"])[kept]
        drawn["online"] = over_time("Remark 5: error of the parameters, online", t, [error_over_time])
    return drawn


def _lines(curves: Mapping[str, Sequence[float | None] | Array]) -> list[dict[str, Any]]:
    return [line(name, values, _color(name, curves)) for name, values in curves.items()]


def _color(name: str, names: Mapping[str, Any]) -> int:
    return _ORDER.index(name) if name in _ORDER else len(_ORDER) + list(names).index(name)
