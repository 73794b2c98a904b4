"""A step of a diagnosis as one picture: the residual torque against what causes the effect, before and after."""

from __future__ import annotations

from collections.abc import Mapping

from idtool.common.units import position_units
from idtool.reporting.diagnosis_text import effect_name, owner_name
from idtool.reporting.plots.figure import MEDIUM, Figure, Panel, banded_curve, curve, figure
from idtool.reporting.plots.residuals import AXES
from idtool.reporting.plots.sampling import round_significant
from idtool.reporting.results.diagnosis import EffectProfileReport, StepReport

_COLORS = {"before": 1, "after": 5}  # c1 and c5
_EFFECT_COLOR = "c2"


def effect_profile_figure(step: StepReport, units: Mapping[str, str]) -> Figure | None:
    """Residual torque of a joint before and after a step, with its scatter, and the torque of the effect.

    Parameters
    ----------
    step
        The step.
    units
        Unit of the torque, by joint.

    Returns
    -------
    None for a step without a profile.
    """
    profile = step.profile
    if profile is None or not len(profile.values):
        return None
    at = profile.values.tolist()
    curves = []
    for name, bins in (("before", profile.before), ("after", profile.after)):
        lower, upper = bins.mean - bins.deviation, bins.mean + bins.deviation
        curves += banded_curve(name, at, bins.mean.tolist(), lower.tolist(), upper.tolist(), _COLORS[name])
    if profile.effect_torque is not None:
        torque = round_significant(profile.effect_torque.tolist())
        label = f"{effect_name(step.effect)} alone"
        curves.append(curve(label, round_significant(at), torque, _EFFECT_COLOR, 2.5, "dash"))
    direction = " along the motion" if profile.in_direction_of_motion else ""
    x_title = _x_title(profile, units)
    return figure(
        f"Residual torque of {profile.joint} against {x_title.partition(' [')[0]}",
        x_title,
        [Panel(f"residual{direction} [{units[profile.joint]}]", curves)],
        f"Residual torque of {profile.joint} against {x_title}, before and after adding {effect_name(step.effect)} on "
        f"{owner_name(step)}",
        MEDIUM,
        x_log=profile.cause == "distance_since_reversal",
    )


def _x_title(profile: EffectProfileReport, units: Mapping[str, str]) -> str:
    """Title of the x axis: the cause with its unit, and its joint if that is another one."""
    tau = units[profile.cause_joint]
    title = AXES[profile.cause].format(q=position_units(units)[profile.cause_joint], tau=tau)
    quantity, bracket, unit = title.partition(" [")
    if profile.cause_joint != profile.joint:
        quantity += f" of {profile.cause_joint}"
    if profile.period is not None:
        quantity += " within one period"
    return quantity + bracket + unit
