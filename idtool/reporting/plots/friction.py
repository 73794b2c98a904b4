"""Friction of several robots, or of one in several results."""

from __future__ import annotations

from collections.abc import Mapping

from idtool.common.units import friction_units
from idtool.reporting.plots.figure import Figure, Panel, PlotlyTrace, figure, styled_curve
from idtool.reporting.results.fit import FitReport, FrictionErrors, FrictionReport
from idtool.robot.config.pool import FRICTION

_TITLES = {"coulomb": "Coulomb"}
_BAR = 2.0  # standard errors
_MARKER = 8  # px
_SPREAD = 0.6  # of the distance from one joint to the next, over which the robots lie side by side


def fleet_figure(report: FitReport) -> Figure | None:
    """Friction of each robot of a fleet by joint, with bars of two standard errors; None without a fleet.

    Parameters
    ----------
    report
        The content of report.json.
    """
    fleet = report.fleet
    if fleet is None or FRICTION not in fleet.own:
        return None
    by_robot = {name: robot.friction for name, robot in fleet.robots.items()}
    return friction_figure("Friction of each robot, with bars of two standard errors", by_robot, report.units)


def friction_figure(
    caption: str, friction: Mapping[str, Mapping[str, FrictionReport]], units: Mapping[str, str]
) -> Figure | None:
    """Friction by joint, side by side, with bars of two standard errors; None if no model has any.

    Parameters
    ----------
    caption
        Title.
    friction
        Friction of each joint, by robot or result.
    units
        Unit of torque or force of each joint.
    """
    kinds = [friction_units(unit) for unit in dict.fromkeys(units.values())]
    viscous_unit, dry_unit = (" or ".join(by_kind) for by_kind in zip(*kinds, strict=True))
    joints = list(dict.fromkeys(joint for by_joint in friction.values() for joint in by_joint))
    panels = []
    for term in FrictionErrors.model_fields:
        curves = _curves(friction, joints, term)
        if curves:
            unit = viscous_unit if term == "viscous" else dry_unit
            panels.append(Panel(f"{_TITLES.get(term, term)} [{unit}]", curves))
    if not panels:
        return None
    axis = {"tickmode": "array", "tickvals": list(range(len(joints))), "ticktext": joints}
    return figure(caption, "joint", panels, x_axis=axis)


def _curves(friction: Mapping[str, Mapping[str, FrictionReport]], joints: list[str], term: str) -> list[PlotlyTrace]:
    """Points of each robot; none for a term that the model does not have."""
    curves = []
    for r, (name, by_joint) in enumerate(friction.items()):
        values = [_value(by_joint, joint, term) for joint in joints]
        if all(value is None for value in values):
            continue
        errors = [_standard_error(by_joint, joint, term) for joint in joints]
        shift = _SPREAD * ((r + 0.5) / len(friction) - 0.5)
        points = styled_curve(name, [i + shift for i in range(len(joints))], values, r)
        bars = [_BAR * error if error is not None else 0.0 for error in errors]
        error_bars = {"type": "data", "array": bars, "width": 3}
        curves.append({**points, "mode": "markers", "marker": {"size": _MARKER}, "error_y": error_bars})
    return curves


def _value(friction: Mapping[str, FrictionReport], joint: str, term: str) -> float | None:
    value: float | None = getattr(friction[joint], term) if joint in friction else None
    return value


def _standard_error(friction: Mapping[str, FrictionReport], joint: str, term: str) -> float | None:
    error: float | None = getattr(friction[joint].standard_error, term) if joint in friction else None
    return error
