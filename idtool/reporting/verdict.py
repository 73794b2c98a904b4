"""Verdict on a model: good, good for torque only, or not to be used. The worst of what a few stated rules allow.

==========  ==================================================================================================
torque      Do not use: an error above 30 % of the torque's standard deviation, or above the URDF's; unless it is
            noise, up to 1.5 times the noise floor. Torque only: no data were held out.
motion      Good: a rollout can be trusted for 0.5 s or longer. It can be trusted as long as its error is at most
            a quarter of how far the robot has moved. Under a controller: the error is at most half of that of a
            robot that follows its command. Torque only: otherwise, if rollouts run away, or without a simulation.
bodies      Do not use: a body that is not realizable. Torque only: masses or shapes that are implausible.
data        Do not use: a problem of the logs, or a cost that is not near its minimum.
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
from idtool.reporting.results.rollouts import Simulation
from idtool.reporting.results.verdict import VerdictLevel, VerdictReason

LEVELS: tuple[VerdictLevel, ...] = ("good", "torque_only", "do_not_use")  # the best first
LEVEL_TEXTS: Mapping[VerdictLevel, str] = {
    "good": "good",
    "torque_only": "good for torque only",
    "do_not_use": "do not use",
}

_MAX_TORQUE_SHARE = 0.3  # of the torque's standard deviation
_NOISE = 1.5  # times the noise floor, up to which an error is noise
_NO_WORSE = 1.001  # ratio of two errors, up to which one is no worse than the other
_TRUSTED_SHARE = 0.25  # of how far a robot has moved, that a rollout may be off
_TRUSTED_TIME = 0.5  # s, that a rollout must be trusted for
_TRUSTED_CLOSED_LOOP = 0.5  # of the error of a robot that follows its command
_MAX_GAP = 1e-2  # relative, of the cost to its minimum
_IMPLAUSIBLE = ("implausible_mass", "implausible_shape", "total_mass_changed")  # notices
_ABOUT_RESULT = ("not_realizable", "worse_than_prior")  # problems that other rules judge


def verdict(reasons: Sequence[VerdictReason]) -> VerdictLevel:
    """The worst of the levels."""
    return max((reason.level for reason in reasons), key=LEVELS.index)


def torque_reason(
    rms: Mapping[str, float | None],
    nrms: Mapping[str, float | None],
    units: Mapping[str, str],
    prior: Mapping[str, float | None] | None,
    noise_floor: Mapping[str, float | None] | None,
    where: str,
    was_fitted: bool = False,
) -> VerdictReason:
    """The torque error.

    Parameters
    ----------
    rms
        Error of the model, by joint and ``overall`` [N·m or N].
    nrms
        The error over the standard deviation of the torque, by joint.
    units
        Unit of each joint's torque.
    prior
        Error of the URDF on the same data; None: not known.
    noise_floor
        Error that noise alone makes, like ``rms``; None: not known.
    where
        The data, as in "on held-out data".
    was_fitted
        True if the model was fitted to the data, so that they say little about prediction.
    """
    error = rms["overall"] or 0.0
    share = _share_of_torque(rms, nrms)
    unit = common_unit(units)
    floor = noise_floor["overall"] if noise_floor else None
    is_noise = floor is not None and error <= _NOISE * floor
    size = f"{number(error)} {unit}"
    if share is not None:
        size = f"{percent(share)} of the torque's standard deviation, {size}"
    text = f"{where[:1].upper()}{where[1:]}, the torque error is {size} RMS"
    others = []
    if floor is not None:
        others.append(f"noise alone makes {number(floor)} {unit}")
    prior_error = prior["overall"] if prior else None
    if prior_error is not None:
        others.append(f"the error of the original URDF is {number(prior_error)} {unit}")
    if others:
        text += f"; {', and '.join(others)}"
    is_worse = prior_error is not None and error > _NO_WORSE * prior_error
    is_large = share is not None and share > _MAX_TORQUE_SHARE
    level: VerdictLevel = "torque_only" if was_fitted else "good"
    if (is_worse or is_large) and not is_noise:
        level = "do_not_use"
    return VerdictReason(about="torque", level=level, figure=share, text=f"{text}.")


def _share_of_torque(rms: Mapping[str, float | None], nrms: Mapping[str, float | None]) -> float | None:
    """Error over the standard deviation of the torque, of all joints together; None if it is not known of any."""
    squared_error = variance = 0.0
    for joint, share in nrms.items():
        error = rms[joint]
        if error is not None and share:
            squared_error += error**2
            variance += (error / share) ** 2
    return math.sqrt(squared_error / variance) if variance else None


def motion_reason(simulation: Simulation | None, why_not: str) -> VerdictReason:
    """How long a rollout can be trusted.

    Parameters
    ----------
    simulation
        The simulation; None: the model was not simulated.
    why_not
        Why it was not simulated, a clause.
    """
    if simulation is None:
        text = f"Whether the model predicts motion is not known: {why_not}."
        return VerdictReason(about="motion", level="torque_only", figure=None, text=text)
    unit = common_unit(simulation.units)
    if simulation.kind == "closed_loop":
        return _closed_loop_reason(simulation, unit)
    trusted = None
    for at in simulation.horizon:
        error, moved = at.position["overall"], at.baseline["overall"]
        if error is None or moved is None or error > _TRUSTED_SHARE * moved:
            break
        trusted = at
    if simulation.lost:
        runs = f"{simulation.lost} of {simulation.windows.simulated} rollouts run away"
        return VerdictReason(about="motion", level="torque_only", figure=0.0, text=f"{runs}: do not simulate with it.")
    if trusted is None:
        text = "Rollouts cannot be trusted"
        if simulation.horizon:
            first = simulation.horizon[0]
            text += f": after {_seconds(first.seconds)}, they are {_off(first.position, first.baseline, unit)}"
        return VerdictReason(about="motion", level="torque_only", figure=0.0, text=f"{text}.")
    level: VerdictLevel = "good" if trusted.seconds >= _TRUSTED_TIME else "torque_only"
    extent = f"for {_seconds(trusted.seconds)}" + (" or longer" if trusted is simulation.horizon[-1] else "")
    text = f"A rollout can be trusted {extent}: it is then {_off(trusted.position, trusted.baseline, unit)}."
    return VerdictReason(about="motion", level=level, figure=trusted.seconds, text=text)


def _closed_loop_reason(simulation: Simulation, unit: str) -> VerdictReason:
    """Reason by a simulation under the controller."""
    error, follows = simulation.position["overall"], simulation.baseline.position["overall"]
    if error is None or follows is None or simulation.lost:
        text = "Under its controller, the simulated robot runs away: do not simulate with it."
        return VerdictReason(about="motion", level="torque_only", figure=None, text=text)
    share = error / follows if follows else math.inf
    level: VerdictLevel = "good" if share <= _TRUSTED_CLOSED_LOOP else "torque_only"
    text = (
        f"Under its controller, the simulated robot is {number(error)} {unit} from the measured position; a robot that "
        f"followed its command exactly would be {number(follows)} {unit} from it."
    )
    return VerdictReason(about="motion", level=level, figure=share, text=text)


def _off(error: Mapping[str, float | None], stands: Mapping[str, float | None], unit: str) -> str:
    """How far a rollout is off, and how far the robot has moved."""
    moved = f"which has moved by {number(stands['overall'])} {unit}"
    return f"{number(error['overall'])} {unit} from the measured position, {moved}"


def _seconds(time: float) -> str:
    """A time in s or ms."""
    return f"{time:g} s" if time >= 0.1 else f"{1000 * time:g} ms"


def bodies_reason(bodies: Mapping[str, BodyReport], notices: Collection[Notice]) -> VerdictReason:
    """Masses and shapes of the bodies.

    Parameters
    ----------
    bodies
        The bodies.
    notices
        Notices about the fit.
    """
    mass = sum(body.mass for body in bodies.values())
    prior_mass = sum(float(body.prior[0]) for body in bodies.values())
    ratio = mass / prior_mass if prior_mass > 0 else None
    unrealizable = [name for name, body in bodies.items() if not body.realizable]
    if unrealizable:
        text = f"No physical body can have the parameters identified for {join_names(unrealizable)}."
        return VerdictReason(about="bodies", level="do_not_use", figure=ratio, text=text)
    doubts = [notice for notice in notices if notice.code in _IMPLAUSIBLE]
    if doubts:
        text = f"Masses or shapes are not plausible: {doubts[0].message}."
        return VerdictReason(about="bodies", level="torque_only", figure=ratio, text=text)
    text = f"All bodies are realizable; their mass is {number(mass)} kg, {number(prior_mass)} kg in the URDF"
    changes = {name: body.mass / body.prior[0] for name, body in bodies.items() if body.prior[0] > 0}
    if changes:
        name = max(changes, key=lambda name: abs(math.log(max(changes[name], 1e-9))))
        before, after = number(bodies[name].prior[0]), number(bodies[name].mass)
        text += f", and that of {name} changes most, from {before} to {after} kg"
    return VerdictReason(about="bodies", level="good", figure=ratio, text=f"{text}.")


def data_reason(base: BaseParametersResult | None, solver: SolverReport, notices: Collection[Notice]) -> VerdictReason:
    """What the logs determine, and whether they or the solution have a problem.

    Parameters
    ----------
    base
        The base parameters; None: not asked for.
    solver
        The solution.
    notices
        Notices about logs, model and fit.
    """
    figure = base.determined / base.structural if base and base.structural else None
    for reason in problem_reasons(notices):
        return reason
    if not abs(solver.duality_gap) <= _MAX_GAP:
        gap = percent(abs(solver.duality_gap))
        text = f"The solver did not find the optimum: the cost may exceed the minimum by {gap}."
        return VerdictReason(about="data", level="do_not_use", figure=figure, text=text)
    text = "What the logs determine was not computed (--quick)"
    if base:
        which = "all" if base.determined == base.structural else f"{base.determined} of the"
        text = f"The logs determine {which} {base.structural} combinations of parameters that the torque depends on"
    return VerdictReason(about="data", level="good", figure=figure, text=f"{text}.")


def problem_reasons(notices: Collection[Notice]) -> Iterator[VerdictReason]:
    """Reasons by problems of the logs or the model, which other rules do not judge."""
    for notice in notices:
        if notice.severity == "problem" and notice.code not in _ABOUT_RESULT:
            yield VerdictReason(about="data", level="do_not_use", figure=None, text=f"{notice.text}.")
