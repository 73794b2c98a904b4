"""How firmly the prior holds the bodies, of report.html: the error against the weight, and what other weights give."""

from __future__ import annotations

from typing import Any

from idtool.reporting.pages.charts import chart, line, panel
from idtool.reporting.results.fit import FitReport, PathPointReport
from idtool.reporting.sections.fit import PriorWeightsSection

PRIOR = PriorWeightsSection()


def prior_view(report: FitReport) -> dict[str, Any]:
    """What the template and `lines.js` read of it.

    Parameters
    ----------
    report
        The content of report.json.
    """
    automatic = report.regularization.automatic
    if automatic is None:
        return {}
    of = {name: [getattr(point, name) for point in automatic.path] for name in PathPointReport.model_fields}
    errors = [line("data that were fitted", of["train_error"], 0)]
    if automatic.standard_error is not None:
        errors.append(line("blocks of time left out", of["validation_error"], 1))
    panels = [
        panel("error / noise", errors, log=True),
        panel("total mass [kg]", [line("total mass", of["total_mass"], 2)], log=True),
        panel("distance", [line("distance", of["distance"], 3)], log=True),
    ]
    return {
        "charts": {"prior": chart("Fits with other weights", of["weight"], "weight of the prior", panels, log=True)}
    }
