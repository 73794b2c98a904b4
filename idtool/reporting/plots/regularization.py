"""Fits with other weights of the prior."""

from __future__ import annotations

from idtool.reporting.plots.figure import Figure, Panel, figure, styled_curve
from idtool.reporting.results.fit import AutomaticWeight


def regularization_figure(automatic: AutomaticWeight) -> Figure:
    """Error, total mass and distance from the prior against its weight.

    Parameters
    ----------
    automatic
        How the weight was chosen: ``regularization.automatic`` of report.json.
    """
    path = automatic.path
    weight = [point.weight for point in path]
    errors = [styled_curve("fitted data", weight, [point.train_error for point in path], 0)]
    if automatic.standard_error is not None:
        left_out = [point.validation_error for point in path]
        errors.append(styled_curve("held-out blocks", weight, left_out, 1))
    mass = styled_curve("total mass", weight, [point.total_mass for point in path], 2)
    distance = styled_curve("distance", weight, [point.distance for point in path], 3)
    panels = [
        Panel("error / noise", errors, log=True),
        Panel("total mass [kg]", [mass], log=True),
        Panel("distance", [distance], log=True),
    ]
    return figure("Fits with other weights of the prior", "weight of the prior", panels, x_log=True)
