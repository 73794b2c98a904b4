"""The unit of all torques, by the URDF's masses, and whether a torque at its extremes is cut off.

Letters as in `channel_fit`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.optimize import nnls

from idtool.common.arrays import Array
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.data.inspection import Joint
from idtool.diagnosis.data_faults.channel_fit import Change, ChannelFit
from idtool.estimation.dataset.reduction import Factor

_WEIGHT, _INERTIA = 0.03, 0.3  # share of a torque's power that either must make up to tell the unit
_NONE = 1e-3  # of weight and inertia that one of them is, below which it is rounding
_EXPLAINED = 0.7  # of it that they and friction must explain together
_SEVERAL, _ONE, _HEAVY = 5.0, 10.0, 30.0  # factors: by the weight of several joints, of one, by inertia alone
_LIGHT = 0.02  # kg: links lighter than that move nothing that is measured
_BEYOND = 3.0  # standard errors, and
_BEYOND_SHARE = 0.01  # of the extreme, that the torque must go on beyond it


def torque_unit(fit: ChannelFit, change: Change, T: Array) -> Iterator[Notice]:
    """A fault where all torques are another multiple of what the URDF's bodies take than a wrong URDF explains.

    Weight is believed before inertia, to which rotors may add any amount.

    Parameters
    ----------
    fit
        The sample of the logs.
    change, T
        The positions and torques with all other mistakes undone.
    """
    weight, inertia = _factors(fit, change, T)
    factors = weight or inertia
    limit = (_SEVERAL if len(weight) > 1 else _ONE) if weight else _HEAVY
    logs = np.log(list(factors.values()))
    if not len(logs) or not (np.all(logs > np.log(limit)) or np.all(logs < -np.log(limit))):
        return
    if logs[0] > 0 and _place_holders(fit):
        return
    factor = float(np.exp(np.median(logs)))
    ratio = f"tau is {factor:.3g} times the {'weight' if weight else 'inertia'} of the URDF's bodies"
    cause = "if it is a motor's torque, a current, mN·m or the like"
    advice = f"{cause} set its `log.scale`; else the URDF's masses are wrong"
    yield Notice("wrong_unit", "problem", None, f"{ratio} at {join_names(list(factors))}", advice)


def _place_holders(fit: ChannelFit) -> bool:
    """Whether the URDF's masses only hold a place: next to none, or the same for three links and more."""
    masses = np.array([body.pi[0] for body in fit.bodies if body.kind == "link"])
    return bool(np.median(masses) < _LIGHT or (len(masses) > 2 and np.ptp(masses) == 0))


def _factors(fit: ChannelFit, change: Change, T: Array) -> tuple[dict[str, float], dict[str, float]]:
    """By joint, what to multiply weight and inertia with, where they tell."""
    rows: list[list[Array]] = [[np.zeros((5, 0))] for _ in fit.equation.joints]
    for motion in map(change, fit.motions):
        still = replace(motion, v=0 * motion.v, a=0 * motion.a)
        moving, resting = (fit.equation.columns(m) for m in (motion, still))
        torques = T @ np.stack([block[-1] for block in moving])
        for j, own in enumerate(rows):
            rigid, gravity = fit.rigid(j, moving[j]), fit.rigid(j, resting[j])
            v = motion.v[j]
            own.append(np.stack([gravity, rigid - gravity, v, np.tanh(v / motion.velocity_deadband[j]), torques[j]]))
    weight: dict[str, float] = {}
    inertia: dict[str, float] = {}
    for name, parts in zip(fit.equation.joints, rows, strict=True):
        x = np.concatenate(parts, axis=1)
        size = np.linalg.norm(x, axis=1)
        if not size[-1] > 0:
            continue
        share, rest = nnls((x[:-1] / np.where(size[:-1] > 0, size[:-1], 1.0)[:, None]).T, x[-1] / size[-1])
        if rest**2 > 1 - _EXPLAINED:
            continue
        for factors, k, least in ((weight, 0, _WEIGHT), (inertia, 1, _INERTIA)):
            if share[k] ** 2 > least and size[k] > _NONE * size[:2].max():
                factors[name] = float(share[k] * size[-1] / size[k])
    return weight, inertia


def cut_off(fit: ChannelFit, j: int, joint: Joint) -> Iterator[Notice]:
    """A fault where the torque of joint j goes on beyond the extremes at which its channel stays.

    A drive's limit keeps the torque itself there, which is no fault. So the torque equation gets a column more, which
    is 1 or −1 where the channel is at an extreme: its coefficient is the mean of what is missing there.

    Parameters
    ----------
    fit
        The sample of the logs.
    j
        Index of the joint.
    joint
        Its inspection.
    """
    tau, name = joint.signals["tau"], fit.equation.joints[j]
    near = max(0.5 * (tau.step or 0.0), 1e-9 * (tau.maximum - tau.minimum))
    total: Factor | None = None
    for batch in fit.batches:
        logged = batch.motion.logged[j]
        extreme = (logged > tau.maximum - near).astype(float) - (logged < tau.minimum + near)
        block = fit.equation.columns(batch.motion)[j]
        factor = Factor.from_columns(
            batch.filter(np.vstack([block[:-1], extreme, block[-1]])), batch.low_pass.redundancy
        )
        total = factor if total is None else total + factor
    if total is None:
        return
    missing, error = _missing(total)
    level = max(abs(tau.minimum), abs(tau.maximum))
    if missing > max(_BEYOND * error, _BEYOND_SHARE * level):
        extremes = f"tau is cut off at {tau.minimum:.4g} and {tau.maximum:.4g} in {tau.stuck:.1%} of the samples"
        beyond = f"where by the motion it goes on for {missing:.2g} in the mean"
        yield Notice("clipped", "problem", name, f"{extremes}, {beyond}", "excite less, or raise the limit")


def _missing(factor: Factor) -> tuple[float, float]:
    """Negative coefficient of the last column, by which the torque is too small there, and its standard error."""
    Y, tau = factor.R[:, :-1], factor.R[:, -1]
    size = np.linalg.norm(Y, axis=0)
    if size[-1] == 0:
        return 0.0, np.inf
    others = np.flatnonzero(size[:-1] > 0)
    others_, wanted = Y[:, others] / size[others], np.column_stack([Y[:, -1], tau])
    own, tau = (wanted - others_ @ np.linalg.lstsq(others_, wanted, rcond=1e-8)[0]).T
    power = float(own @ own)
    if power < 1e-8 * size[-1] ** 2:
        return 0.0, np.inf
    slope = float(own @ tau) / power
    rest = float(np.square(tau - slope * own).sum())
    free = max(factor.independent - len(others), 1.0)
    return -slope, float(np.sqrt(rest / power / free))
