"""Results → report.html and validation.html: one file each that needs nothing else, readable without a network.

A page is a list of sections; a section is a heading and a template under `templates/`, which reads the content of the
JSON file and what `_render` is given besides. All text is escaped by the templates: names and paths are a stranger's.
The browser draws the torques from rounded curves with plotly.js, which is part of the page.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from numpy.typing import NDArray
from plotly.offline import get_plotlyjs

from idtool.fit import Fit
from idtool.validate import Evaluation

Array = NDArray[np.float64]

_MOST_VALUES = 120_000  # that all curves of a page hold together: some 900 kB of text
_MOST_LOGS = 6  # that are drawn
_DIGITS = 5  # of a curve's largest value
_MOST_DECIMALS = 12
_LATE = 1e4  # s: later times are drawn as time since the curve's first whole second

_FIT = (
    ("What was found", "fit_findings.html"),
    ("Torque error", "fit_errors.html"),
    ("Measured and predicted torque", "torques.html"),
    ("Friction", "friction.html"),
    ("Bodies", "bodies.html"),
    ("Solver", "solver.html"),
    ("How this was made", "origin.html"),
)
_VALIDATION = (
    ("What was found", "validation_findings.html"),
    ("Torque error", "validation_errors.html"),
    ("Measured and predicted torque", "torques.html"),
    ("How this was made", "origin.html"),
)


def fit_page(fit: Fit, report: dict[str, Any], command: str) -> str:
    """report.html.

    Parameters
    ----------
    fit
        The result.
    report
        The content of report.json.
    command
        The command line that made it.
    """
    units = report["units"]
    own, prior = report["rms"]["validation"], report["rms"]["prior_validation"]
    held_out = own is not None
    return _render(
        f"{Path(report['urdf']).stem}: identified dynamics",
        _FIT,
        report=report,
        groups=by_unit(units),
        curves=curves(fit.validation if held_out else fit.train, "identified", units),
        data="the held-out data" if held_out else "the data that the model was fitted to",
        worse=[name for name in report["joints"] if held_out and own[name] >= prior[name]],
        determined=fit.uncertainty.identifiable,
        closest=fit.estimate.certificate.where,
        command=command,
        inputs={"URDF": [report["urdf"]], "logs": report["logs"]},
    )


def validation_page(evaluation: Evaluation, report: dict[str, Any], command: str) -> str:
    """validation.html.

    Parameters
    ----------
    evaluation
        Errors and curves of ``model`` and, where one was given, ``prior``.
    report
        The content of validation.json.
    command
        The command line that made it.
    """
    units = report["units"]
    return _render(
        "Validation of a dynamics model",
        _VALIDATION,
        report=report,
        groups=by_unit(units),
        curves=curves(evaluation, "model", units),
        data="the validation logs",
        command=command,
        inputs={"logs": [trace.name for trace in evaluation.traces]},
    )


def by_unit(units: Mapping[str, str]) -> list[tuple[str, list[str]]]:
    """Rows of tables whose figures have one unit each: joints of a kind, and ``overall`` below or by itself."""
    groups: dict[str, list[str]] = {}
    for name, unit in units.items():
        groups.setdefault(unit, []).append(name)
    if len(groups) == 1:
        return [(unit, [*names, "overall"]) for unit, names in groups.items()]
    return [*groups.items(), (f"{' and '.join(groups)} together", ["overall"])]


def curves(evaluation: Evaluation, model: str, units: Mapping[str, str]) -> dict[str, Any]:
    """What the plots are drawn from, of bounded size.

    Parameters
    ----------
    evaluation
        Its traces are drawn, the first few.
    model
        Whose torque is the ``predicted`` one.
    units
        Unit of the torque by joint, in the order of the curves.

    Returns
    -------
    ``logs``, each with its name, times ``t`` [s] after ``start`` and ``joints``, each of these with its name, unit and
    curves; ``omitted``, the number of logs that are not drawn.
    """
    logs = []
    traces = evaluation.traces[:_MOST_LOGS]
    values = sum(x.size for trace in traces for x in trace.curves.values())
    stretches = max(math.ceil(values / _MOST_VALUES), 1)
    for trace in traces:
        start = math.floor(trace.t[0]) if abs(trace.t[0]) > _LATE else 0
        names = {"measured": "measured", "predicted": model, "residual": "residual", "prior": "prior"}
        drawn = {name: merged(trace.curves[k], stretches) for name, k in names.items() if k in trace.curves}
        joints = [
            {"name": joint, "unit": unit, **{name: rounded(x[j]) for name, x in drawn.items()}}
            for j, (joint, unit) in enumerate(units.items())
        ]
        t = merged(trace.t[None] - start, stretches)[0]
        logs.append({"name": trace.name, "start": start, "t": t.round(5).tolist(), "joints": joints})
    return {"logs": logs, "omitted": len(evaluation.traces) - len(logs)}


def merged(x: Array, count: int) -> Array:
    """The least and greatest value of ``count`` stretches at a time; NaN only where all are.

    Parameters
    ----------
    x
        Pairs of values, shape (rows, 2 stretches).
    count
        How many to take together.

    Returns
    -------
    Shape (rows, 2 ceil(stretches / count)).
    """
    short = -x.shape[1] % (2 * count)
    blocks = np.pad(x, [(0, 0), (0, short)], constant_values=np.nan).reshape(len(x), -1, 2 * count)
    pairs = np.stack([np.fmin.reduce(blocks, axis=-1), np.fmax.reduce(blocks, axis=-1)], axis=-1)
    return np.asarray(pairs.reshape(len(x), -1))


def rounded(x: Array) -> list[float | None]:
    """A curve to five digits of its largest value; None breaks the line."""
    largest = float(np.fmax.reduce(np.abs(x), initial=0.0))
    decimals = _DIGITS - 1 - math.floor(math.log10(largest)) if largest else 0
    return [None if math.isnan(value) else value for value in x.round(min(decimals, _MOST_DECIMALS)).tolist()]


def number(x: float | None, digits: int = 3) -> str:
    """A figure to so many digits; a dash for none."""
    if x is None or not math.isfinite(x):
        return "–"
    size = math.floor(math.log10(abs(x))) if x else 0
    return f"{x:.{max(digits - 1 - size, 0)}f}" if -5 < size < 6 else f"{x:.{digits - 1}e}"


def with_error(x: float | None, error: float | None) -> tuple[str, str]:
    """A figure and its standard error, to two digits of the error."""
    if x is None:
        return "–", ""
    if error is None:
        return number(x, 4), "not determined"
    size = math.floor(math.log10(error)) if error else -9
    if not -9 < size < 6:
        return number(x, 4), number(error, 2)
    decimals = max(1 - size, 0)
    return f"{x:.{decimals}f}", f"{error:.{decimals}f}"


def metres(x: float) -> str:
    """A length to a tenth of a millimetre."""
    return f"{round(x, 4) + 0:.4f}" if abs(x) < 1000 else number(x)


def percent(x: float | None) -> str:
    """A share in percent."""
    return "–" if x is None else f"{number(100 * x, 2)} %"


def _render(title: str, sections: Sequence[tuple[str, str]], **context: object) -> str:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("idtool"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(number=number, with_error=with_error, metres=metres, percent=percent)
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    page = environment.get_template("page.html")
    html = page.render(title=title, sections=sections, plotly=get_plotlyjs(), **context)
    return html.encode(errors="replace").decode()  # a path need not be text
