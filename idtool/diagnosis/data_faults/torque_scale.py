"""Faults in the size of torques: a wrong unit, by the URDF's masses, torques that no motor has, and cut-off extremes.

Letters as in `channel_fit`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import LogError
from idtool.common.linear_algebra import nonnegative_least_squares
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.data.inspection import InspectedJoint
from idtool.data.logs.log import JointLog
from idtool.diagnosis.data_faults.channel_fit import Change, ChannelFit
from idtool.estimation.dataset.experiment import Experiment
from idtool.estimation.dataset.reduction import Factor

_MIN_WEIGHT_SHARE = 0.03  # of a torque's power, from which weight determines the unit
_MIN_INERTIA_SHARE = 0.3  # of a torque's power, from which inertia does
_ROUNDING = 1e-3  # of weight and inertia together, below which one of them is rounding error
_MIN_EXPLAINED = 0.7  # of a torque's power, that weight, inertia and friction must explain together
_LIMIT_SEVERAL = 5.0  # factor by the weight on several joints, beyond which the unit is wrong
_LIMIT_ONE = 10.0  # factor by the weight on one joint
_LIMIT_INERTIA = 30.0  # factor by inertia alone
_MIN_MASS = 0.02  # kg: lighter links are placeholders
_MIN_SIGNIFICANCE = 3.0  # standard errors, that the torque must continue beyond its extreme
_MIN_EXCESS = 0.01  # of the extreme, that the torque must continue beyond it
_MAX_OVER_OTHERS = 1e3  # median of a joint's torque over the rms of any other joint's
_MAX_OVER_URDF = 1e4  # torque over that of the URDF's bodies: friction of light joints makes a thousandfold


def check_torques(experiment: Experiment) -> None:
    """Check that no joint's torque is beyond all measure, which would make every fit fail.

    That is one far above both the other joints' torque and that of the URDF's bodies: friction alone may be many times
    the latter. Most samples have to be so large: a spike is no matter of the unit.

    Raises
    ------
    LogError
        If there is one.
    """
    names = experiment.equation.joints
    for run in experiment.runs:
        log = run.signals.log
        for j, over_others in _far_above_others(log, names):
            only_run = replace(experiment, runs=(run,))
            over_urdf = 10 ** float(ChannelFit(only_run).excess[j])
            if over_urdf > _MAX_OVER_URDF:
                ratios = (
                    f"{short_number(over_urdf, 1)} times that of the URDF's bodies and "
                    f"{short_number(over_others, 1)} times any other joint's"
                )
                advice = "correct its unit in the log or, of the robot's logs, with `log.scale` in the configuration"
                raise LogError(log.path, f"tau of joint {names[j]} cannot be right: it is {ratios}; {advice}")


def _far_above_others(log: JointLog, names: Sequence[str]) -> Iterator[tuple[int, float]]:
    """Index of a joint whose torque is far above that of all others most of the time, and its ratio to theirs."""
    measured = [j for j, name in enumerate(names) if log.has("tau", name)]
    tau = {j: log.signals["tau"][:, log.joints.index(names[j])] for j in measured}
    rms = {j: float(np.sqrt(np.nanmean(np.square(x)))) for j, x in tau.items()}
    for j in measured:
        largest_other = max((rms[k] for k in measured if k != j), default=0.0)
        usual = float(np.nanmedian(np.abs(tau[j])))
        if 0 < _MAX_OVER_OTHERS * largest_other < usual:
            yield j, rms[j] / largest_other


def wrong_torque_unit(fit: ChannelFit, change: Change, T: Array) -> Iterator[Notice]:
    """Fault if all torques are another multiple of the URDF's than wrong masses explain.

    Weight is used before inertia, to which rotors may add any amount.

    Parameters
    ----------
    fit
        The sample of the logs.
    change, T
        The positions and torques with all other mistakes undone.
    """
    weight, inertia = _scale_factors(fit, change, T)
    factors = weight or inertia
    if not factors:
        return
    limit = _LIMIT_INERTIA
    if weight:
        limit = _LIMIT_SEVERAL if len(weight) > 1 else _LIMIT_ONE
    logs = np.log(list(factors.values()))
    all_too_large = bool(np.all(logs > np.log(limit)))
    all_too_small = bool(np.all(logs < -np.log(limit)))
    if not (all_too_large or all_too_small):
        return
    if all_too_large and _has_placeholder_masses(fit):
        return
    factor = float(np.exp(np.median(logs)))
    ratio = f"tau is {short_number(factor)} times the {'gravity' if weight else 'inertial'} torque of the URDF's bodies"
    cause = "if tau is a motor torque or a current, or is in another unit such as mN·m,"
    advice = f"{cause} set its `log.scale`; otherwise the URDF's masses are wrong"
    yield Notice("wrong_unit", "problem", None, f"{ratio} at {join_names(list(factors))}", advice)


def _has_placeholder_masses(fit: ChannelFit) -> bool:
    """True if the URDF's masses are placeholders: next to none, or the same for three links and more."""
    masses = np.array([body.pi[0] for body in fit.bodies if body.kind == "link"])
    return bool(np.median(masses) < _MIN_MASS or (len(masses) > 2 and np.ptp(masses) == 0))


def _scale_factors(fit: ChannelFit, change: Change, T: Array) -> tuple[dict[str, float], dict[str, float]]:
    """By joint, the torque's multiple of the URDF's weight and inertia, where the data determine it."""
    joints = fit.equation.joints
    parts: list[list[Array]] = [[np.zeros((5, 0))] for _ in joints]
    for motion in map(change, fit.motions):
        at_rest = replace(motion, v=0 * motion.v, a=0 * motion.a)
        moving_columns = fit.equation.columns(motion)
        resting_columns = fit.equation.columns(at_rest)
        torques = T @ np.stack([block[-1] for block in moving_columns])
        for j, own in enumerate(parts):
            rigid = fit.rigid_torque(j, moving_columns[j])
            gravity = fit.rigid_torque(j, resting_columns[j])
            v = motion.v[j]
            coulomb = np.tanh(v / motion.velocity_deadband[j])
            own.append(np.stack([gravity, rigid - gravity, v, coulomb, torques[j]]))

    weight: dict[str, float] = {}
    inertia: dict[str, float] = {}
    for name, own in zip(joints, parts, strict=True):
        x = np.concatenate(own, axis=1)
        size = np.linalg.norm(x, axis=1)
        if not size[-1] > 0:
            continue
        columns = x[:-1] / np.where(size[:-1] > 0, size[:-1], 1.0)[:, None]
        share, rest = nonnegative_least_squares(columns.T, x[-1] / size[-1])
        if rest**2 > 1 - _MIN_EXPLAINED:
            continue
        for factors, k, min_share in ((weight, 0, _MIN_WEIGHT_SHARE), (inertia, 1, _MIN_INERTIA_SHARE)):
            if share[k] ** 2 > min_share and size[k] > _ROUNDING * size[:2].max():
                factors[name] = float(share[k] * size[-1] / size[k])
    return weight, inertia


def clipped_torque(fit: ChannelFit, j: int, joint: InspectedJoint) -> Iterator[Notice]:
    """Fault if the torque of joint j continues beyond the extremes at which its channel stays.

    A drive's limit keeps the torque itself there, which is no fault. So the torque equation gets one more column, which
    is 1 or −1 where the channel is at an extreme: its coefficient is the mean of the torque missing there.

    Parameters
    ----------
    fit
        The sample of the logs.
    j
        Index of the joint.
    joint
        Its inspection.
    """
    tau = joint.signals["tau"]
    tolerance = max(0.5 * (tau.step or 0.0), 1e-9 * (tau.maximum - tau.minimum))
    total: Factor | None = None
    for batch in fit.batches:
        logged = batch.motion.logged_tau[j]
        at_maximum = logged > tau.maximum - tolerance
        at_minimum = logged < tau.minimum + tolerance
        extreme = at_maximum.astype(float) - at_minimum
        block = fit.equation.columns(batch.motion)[j]
        columns = batch.filter(np.vstack([block[:-1], extreme, block[-1]]))
        factor = Factor.from_columns(columns, batch.low_pass.redundancy)
        total = factor if total is None else total + factor
    if total is None:
        return
    missing, error = _missing_torque(total)
    level = max(abs(tau.minimum), abs(tau.maximum))
    if missing > max(_MIN_SIGNIFICANCE * error, _MIN_EXCESS * level):
        extremes = (
            f"tau is cut off at {short_number(tau.minimum)} and {short_number(tau.maximum)} in "
            f"{100 * tau.stuck:.1f} % of the samples"
        )
        beyond = f"where the motion requires {short_number(missing, 2)} more on average"
        name = fit.equation.joints[j]
        yield Notice("clipped", "problem", name, f"{extremes}, {beyond}", "reduce the excitation, or raise the limit")


def _missing_torque(factor: Factor) -> tuple[float, float]:
    """Negative coefficient of the last column and its standard error; 0 and infinity if it is not determined."""
    Y = factor.R[:, :-1]
    tau = factor.R[:, -1]
    size = np.linalg.norm(Y, axis=0)
    if size[-1] == 0:
        return 0.0, np.inf
    others = np.flatnonzero(size[:-1] > 0)
    A = Y[:, others] / size[others]
    targets = np.column_stack([Y[:, -1], tau])
    extreme_rest, tau_rest = (targets - A @ np.linalg.lstsq(A, targets, rcond=1e-8)[0]).T
    power = float(extreme_rest @ extreme_rest)
    if power < 1e-8 * size[-1] ** 2:
        return 0.0, np.inf
    slope = float(extreme_rest @ tau_rest) / power
    residual_squares = float(np.square(tau_rest - slope * extreme_rest).sum())
    degrees_of_freedom = max(factor.independent - len(others), 1.0)
    return -slope, float(np.sqrt(residual_squares / power / degrees_of_freedom))
