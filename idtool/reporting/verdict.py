"""Verdict on a model: good, good for torque only, or not to be used. It is the worst of the levels of four reasons.

==========  ==================================================================================================
torque      Do not use: the error is above 30 % of the torque's standard deviation, or above that of the URDF. An
            error of at most 1.5 times the noise floor is noise, and no reason. Torque only: no data were held out.
motion      Good: a rollout can be trusted for 0.5 s or longer, which it can as long as its error is at most a
            quarter of how far the robot has moved. Under a controller: the error is at most half of the error of a
            robot that follows its command exactly. Torque only: otherwise; if rollouts diverge; without simulation.
bodies      Do not use: a body is not realizable. Torque only: a mass or shape is implausible.
data        Do not use: the logs have a problem, or the cost is not near its minimum.
==========  ==================================================================================================
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence

from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.common.number_text import number
from idtool.common.units import common_unit
from idtool.reporting.number_text import percent
from idtool.reporting.results.fit import BaseParametersResult, BodyReport, SolverReport
from idtool.reporting.results.rollouts import Horizon, Simulation
from idtool.reporting.results.verdict import VerdictLevel, VerdictReason

LEVELS: tuple[VerdictLevel, ...] = ("good", "torque_only", "do_not_use")  # the best first
LEVEL_TEXTS: Mapping[VerdictLevel, str] = {
    "good": "good",
    "torque_only": "good for torque only",
    "do_not_use": "do not use",
}

_MAX_TORQUE_ERROR = 0.3  # of the torque's standard deviation
_MAX_NOISE_RATIO = 1.5  # of an error to the noise floor, up to which the error is noise
_MAX_RATIO_TO_URDF = 1.001  # of an error to that of the URDF, up to which it is no worse but for rounding
_MAX_ROLLOUT_ERROR = 0.25  # of how far a robot has moved since the start of a rollout that can be trusted
_MIN_TRUSTED_TIME = 0.5  # s, that rollouts of a good model can be trusted for
_MAX_CLOSED_LOOP_ERROR = 0.5  # of the error of a robot that follows its command exactly
_MAX_DUALITY_GAP = 1e-2
_IMPLAUSIBLE_BODIES = ("implausible_mass", "implausible_shape", "total_mass_changed")  # codes of notices
_JUDGED_BY_OTHER_RULES = ("not_realizable", "worse_than_prior")  # codes of problems
_SHORT_TIME = 0.1  # s, below which times are given in ms
_MIN_MASS_RATIO = 1e-9  # of which the logarithm is taken
_SEARCH_STEP = "Find out what the model lacks: `idtool diagnose` with the same URDF, logs and configuration."


def worst_level(reasons: Sequence[VerdictReason]) -> VerdictLevel:
    """The verdict: the worst of the levels of some reasons."""
    return max((reason.level for reason in reasons), key=LEVELS.index)


def next_steps(reasons: Sequence[VerdictReason]) -> list[str]:
    """Suggested next steps with a model, one sentence each.

    Parameters
    ----------
    reasons
        All reasons of the verdict, problems of the logs first.
    """
    level = worst_level(reasons)
    if level == "good":
        return ["Use the model for control and simulation; `idtool export` writes it for MuJoCo or Drake."]
    if level == "torque_only":
        steps = ["Use the model for feedforward and gravity compensation, but not for simulation."]
        predicts_motion_badly = any(
            reason.about == "motion" and reason.level == "torque_only" and reason.figure is not None
            for reason in reasons
        )
        return [*steps, _SEARCH_STEP] if predicts_motion_badly else steps
    if reasons[0].about == "data":
        return ["First correct the data, or describe them correctly in the configuration; then repeat the command."]
    refused = next(reason for reason in reasons if reason.level == level)
    if refused.about == "bodies":
        return ["Fit again with tighter constraints."]
    if refused.about == "data":
        return ["Fit again with another solver."]
    return [_SEARCH_STEP]


def torque_reason(
    rms: Mapping[str, float | None],
    nrms: Mapping[str, float | None],
    units: Mapping[str, str],
    urdf_rms: Mapping[str, float | None] | None,
    noise_floor: Mapping[str, float | None] | None,
    where: str,
    was_fitted: bool = False,
) -> VerdictReason:
    """Reason by the torque error.

    Parameters
    ----------
    rms
        Error of the model, by joint and ``overall`` [N·m or N]; that of at least one joint is known.
    nrms
        The error over the standard deviation of the torque, by joint.
    units
        Unit of each joint's torque.
    urdf_rms
        Error of the URDF on the same data, like ``rms``; None: not known.
    noise_floor
        Error that noise alone makes, like ``rms``; None: not known.
    where
        The data, as in "On held-out data".
    was_fitted
        True if the model was fitted to the data, so that they say little about prediction.
    """
    error = rms["overall"]
    if error is None:
        text = f"{where}, the torque error is not known."
        return VerdictReason(about="torque", level="do_not_use", figure=None, text=text)
    relative_error = _relative_torque_error(rms, nrms)
    urdf_error = None if urdf_rms is None else urdf_rms["overall"]
    noise = None if noise_floor is None else noise_floor["overall"]

    unit = common_unit(units)
    size = f"{number(error)} {unit}"
    if relative_error is not None:
        size = f"{percent(relative_error)} of the torque's standard deviation, {size}"
    text = f"{where}, the torque error is {size} RMS"
    comparisons = []
    if noise is not None:
        comparisons.append(f"the noise floor is {number(noise)} {unit}")
    if urdf_error is not None:
        comparisons.append(f"the error of the original URDF is {number(urdf_error)} {unit}")
    if comparisons:
        text += f"; {', and '.join(comparisons)}"

    is_noise = noise is not None and error <= _MAX_NOISE_RATIO * noise
    is_large = relative_error is not None and relative_error > _MAX_TORQUE_ERROR
    is_worse = urdf_error is not None and error > _MAX_RATIO_TO_URDF * urdf_error
    level: VerdictLevel = "torque_only" if was_fitted else "good"
    if (is_large or is_worse) and not is_noise:
        level = "do_not_use"
    return VerdictReason(about="torque", level=level, figure=relative_error, text=f"{text}.")


def _relative_torque_error(rms: Mapping[str, float | None], nrms: Mapping[str, float | None]) -> float | None:
    """Error over the standard deviation of the torque, of all joints together; None if it is not known of any.

    The standard deviation of a joint's torque is its error over its relative error.
    """
    squared_error = variance = 0.0
    for joint, relative_error in nrms.items():
        error = rms[joint]
        if error is not None and relative_error:
            squared_error += error**2
            variance += (error / relative_error) ** 2
    return math.sqrt(squared_error / variance) if variance else None


def motion_reason(simulation: Simulation | None, why_not_simulated: str) -> VerdictReason:
    """Reason by a simulation, under the logged torque or a controller.

    Parameters
    ----------
    simulation
        The simulation; None: the model was not simulated.
    why_not_simulated
        Why it was not, a clause.
    """
    if simulation is None:
        text = f"Whether the model predicts motion is not known: {why_not_simulated}."
        return VerdictReason(about="motion", level="torque_only", figure=None, text=text)
    unit = common_unit(simulation.units)
    if simulation.lost:
        text = f"{simulation.lost} of {simulation.windows.simulated} simulations diverge: do not simulate the model."
        return VerdictReason(about="motion", level="torque_only", figure=None, text=text)
    if simulation.kind == "closed_loop":
        return _closed_loop_reason(simulation, unit)
    return _open_loop_reason(simulation, unit)


def _open_loop_reason(simulation: Simulation, unit: str) -> VerdictReason:
    """Reason by rollouts under the logged torque; the baseline is a robot that stands still."""
    last_trusted: Horizon | None = None
    for horizon in simulation.horizon:
        if not _can_be_trusted(horizon):
            break
        last_trusted = horizon
    if last_trusted is None:
        text = "Open-loop rollouts cannot be trusted"
        if simulation.horizon:
            text += f": {_error_text(simulation.horizon[0], unit)}"
        return VerdictReason(about="motion", level="torque_only", figure=0.0, text=f"{text}.")
    time = _time_text(last_trusted.seconds)
    if last_trusted is simulation.horizon[-1]:
        time = f"at least {time}"
    text = f"Open-loop rollouts can be trusted for {time}: {_error_text(last_trusted, unit)}."
    level: VerdictLevel = "good" if last_trusted.seconds >= _MIN_TRUSTED_TIME else "torque_only"
    return VerdictReason(about="motion", level=level, figure=last_trusted.seconds, text=text)


def _can_be_trusted(horizon: Horizon) -> bool:
    """True if the error is small against how far the robot has moved by then."""
    error = horizon.position["overall"]
    moved = horizon.baseline["overall"]
    return error is not None and moved is not None and error <= _MAX_ROLLOUT_ERROR * moved


def _closed_loop_reason(simulation: Simulation, unit: str) -> VerdictReason:
    """Reason by a simulation under the controller; the baseline is a robot that follows its command exactly."""
    error = simulation.position["overall"]
    baseline_error = simulation.baseline.position["overall"]
    ratio = error / baseline_error if error is not None and baseline_error else None
    is_good = ratio is not None and ratio <= _MAX_CLOSED_LOOP_ERROR
    text = (
        f"In closed-loop simulation, the RMS position error is {number(error)} {unit}; for comparison, the measured "
        f"position differs from the command by {number(baseline_error)} {unit} RMS."
    )
    return VerdictReason(about="motion", level="good" if is_good else "torque_only", figure=ratio, text=text)


def _error_text(horizon: Horizon, unit: str) -> str:
    """Error of the rollouts at a time after their start, and how far the robot has moved by then, in words."""
    error = f"{number(horizon.position['overall'])} {unit}"
    moved = f"{number(horizon.baseline['overall'])} {unit}"
    time = _time_text(horizon.seconds)
    return f"after {time}, the RMS position error is {error}, and the robot has moved by {moved} RMS"


def _time_text(seconds: float) -> str:
    """A time with its unit."""
    return f"{seconds:g} s" if seconds >= _SHORT_TIME else f"{1000 * seconds:g} ms"


def bodies_reason(bodies: Mapping[str, BodyReport], notices: Collection[Notice]) -> VerdictReason:
    """Reason by the masses and shapes of the bodies.

    Parameters
    ----------
    bodies
        The bodies.
    notices
        Notices about the fit.
    """
    mass = sum(body.mass for body in bodies.values())
    urdf_mass = sum(_urdf_mass(body) for body in bodies.values())
    ratio = mass / urdf_mass if urdf_mass > 0 else None
    unrealizable = [name for name, body in bodies.items() if not body.realizable]
    if unrealizable:
        text = f"No physical body can have the parameters identified for {join_names(unrealizable)}."
        return VerdictReason(about="bodies", level="do_not_use", figure=ratio, text=text)
    doubts = [notice.message for notice in notices if notice.code in _IMPLAUSIBLE_BODIES]
    if doubts:
        text = f"Masses or shapes are not plausible: {doubts[0]}."
        return VerdictReason(about="bodies", level="torque_only", figure=ratio, text=text)
    total = f"{number(mass)} kg ({number(urdf_mass)} kg in the URDF)"
    text = f"All bodies are physically realizable. Their total mass is {total}{_largest_change_text(bodies)}."
    return VerdictReason(about="bodies", level="good", figure=ratio, text=text)


def _largest_change_text(bodies: Mapping[str, BodyReport]) -> str:
    """Clause on the body whose mass has changed most; empty if the figures do not show it."""
    if not bodies:
        return ""
    name, body = max(bodies.items(), key=lambda item: _mass_change(item[1]))
    before = number(_urdf_mass(body))
    after = number(body.mass)
    if before == after:
        return ""
    return f"; the largest relative change is that of {name}, from {before} to {after} kg"


def _urdf_mass(body: BodyReport) -> float:
    """Mass in the URDF [kg]."""
    return float(body.prior[0])


def _mass_change(body: BodyReport) -> float:
    """Change of a mass from that in the URDF, either way: absolute logarithm of the ratio; 0 without a mass there."""
    urdf_mass = _urdf_mass(body)
    if not urdf_mass > 0:
        return 0.0
    ratio = max(body.mass / urdf_mass, _MIN_MASS_RATIO)
    return abs(math.log(ratio))


def data_reason(base_parameters: BaseParametersResult | None, solver: SolverReport) -> VerdictReason:
    """Reason by what the logs determine, and by how near the cost is to its minimum.

    Parameters
    ----------
    base_parameters
        The base parameters; None: they were not computed.
    solver
        The solution.
    """
    share = None
    text = "What the logs determine was not computed (--quick)."
    if base_parameters is not None:
        determined, structural = base_parameters.determined, base_parameters.structural
        share = determined / structural if structural else None
        count = f"all {structural}" if determined == structural else f"{determined} of the {structural}"
        text = (
            f"The logs determine {count} base parameters, the combinations of parameters on which the torque depends."
        )
    gap = abs(solver.duality_gap)
    if math.isnan(gap) or gap > _MAX_DUALITY_GAP:
        text = f"The solver did not find the optimum: the cost may exceed the minimum by {percent(gap)}."
        return VerdictReason(about="data", level="do_not_use", figure=share, text=text)
    return VerdictReason(about="data", level="good", figure=share, text=text)


def problem_reasons(notices: Collection[Notice]) -> Iterator[VerdictReason]:
    """Reasons by problems of the logs, without those that another reason judges; they come before all others."""
    for notice in notices:
        if notice.severity == "problem" and notice.code not in _JUDGED_BY_OTHER_RULES:
            yield VerdictReason(about="data", level="do_not_use", figure=None, text=f"{notice.text}.")
