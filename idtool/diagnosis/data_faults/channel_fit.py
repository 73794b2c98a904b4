"""Fit of realizable bodies to the torque, with mistakes in a log's channels undone.

A bounded sample of the logs is fitted by a model with everything that a joint is likely to have besides its bodies:
friction, an offset, a spring and a rotor. So torque that one of them explains is not taken as a fault. What remains is
what physics rules out for any robot: friction that drives, negative inertia, one mass that two joints feel as two.
Channels that were swapped, inverted or scaled require just that. The URDF's masses have next to no influence.

Letters: nv joints, n samples in the band; u_j share of the power of joint j's torque that is left unexplained; T
(nv, nv) true torques from the logged ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import SolverError
from idtool.common.linear_algebra import least_squares
from idtool.data.signals import Batch, Motion
from idtool.dynamics.effects import build_effects, effect_types
from idtool.dynamics.effects.joint_effect import JointEffect
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.experiment import Experiment
from idtool.estimation.dataset.reduction import Factor
from idtool.estimation.problem.estimate import estimate
from idtool.robot.config import WEAK_PRIOR, Config
from idtool.robot.sets import choose_set

Change = Callable[[Motion], Motion]

_SEGMENTS = 8  # of the logs
_SEGMENT_ROWS = 384  # samples in the band of each
_MAX_SEGMENTS = 64  # where gaps make them shorter
MIN_UNEXPLAINED = 1e-3  # of a torque's power: a smaller rest is no better explained
_MIN_NOISE = 1e-6  # of a torque's power
_ROWS_PER_COEFFICIENT = 4.0  # that a joint needs to be evaluated
_RANK = 1e-8  # of the largest singular value


class ChannelFit:
    """A bounded sample of the logs, and the model to fit to it.

    Attributes
    ----------
    equation
        The torque equation with all plain effects.
    batches
        Segments of the logs, evenly spread.
    motions
        The same in the band and decimated, n samples each.
    groups
        Joints that have a body in common, directly or through others. A change of one group's channels does not
        affect another group.
    prior
        Parameters of all bodies by the URDF, shape (10 bodies,).

    Parameters
    ----------
    experiment
        Model and logs.
    """

    def __init__(self, experiment: Experiment) -> None:
        self.bodies = experiment.model.bodies
        self.sets = tuple(choose_set(body, "full") for body in self.bodies)
        names = experiment.model.names
        config = _with_plain_effects(experiment.config, names)
        self.equation = LinearModel(names, build_effects(experiment.model, config))
        self.batches = tuple(_sample_batches(experiment))
        self.motions = tuple(map(_in_band, self.batches))
        self.groups = _groups(experiment.model.support())
        self.prior = np.concatenate([body.pi for body in self.bodies])

    def reduced(self, change: Change) -> ReducedSample:
        """The sample with position, velocity and acceleration changed, reduced to factors."""
        total: tuple[Factor, ...] | None = None
        for motion, batch in zip(self.motions, self.batches, strict=True):
            redundancy = batch.low_pass.redundancy
            factors = tuple(Factor.from_columns(columns, redundancy) for columns in self._columns(change(motion)))
            total = factors if total is None else tuple(a + b for a, b in zip(total, factors, strict=True))
        return ReducedSample(self, total or ())

    def _columns(self, motion: Motion) -> Iterator[Array]:
        """Per joint its columns and all torques where it moves, shape (m_j + nv, n)."""
        moving = np.ones(motion.q.shape, dtype=bool)
        for effect in self.equation.effects:
            for joint, mask in effect.invalid_mask(motion).items():
                moving[joint] &= ~mask
        blocks = self.equation.columns(motion)
        torques = np.stack([block[-1] for block in blocks])
        for block, mask in zip(blocks, moving, strict=True):
            yield np.vstack([block[:-1], torques])[:, mask]

    @cached_property
    def excess(self) -> Array:
        """log10 of the rms of each torque over that of the URDF's bodies, 0 where one is zero; shape (nv,)."""
        rigid_power = np.zeros(len(self.equation.joints))
        power = np.zeros(len(self.equation.joints))
        for motion in self.motions:
            for j, block in enumerate(self.equation.columns(motion)):
                rigid_power[j] += np.square(self.rigid_torque(j, block)).sum()
                power[j] += np.square(block[-1]).sum()
        is_known = (rigid_power > 0) & (power > 0)
        ratio = np.where(is_known, power, 1) / np.where(is_known, rigid_power, 1)
        return np.where(is_known, 0.5 * np.log10(ratio), 0.0)

    def rigid_torque(self, j: int, block: Array) -> Array:
        """Torque of joint j for the motion of the URDF's bodies, from the joint's columns, shape (n,)."""
        active = self.equation.active()[j]
        bodies = active[active < len(self.prior)]
        return np.asarray(self.prior[bodies] @ block[: len(bodies)])


@dataclass(frozen=True)
class ReducedSample:
    """The sample reduced to factors, with some positions and with torques as logged.

    Attributes
    ----------
    fit
        The sample.
    factors
        Per joint, that of [Y_j, all torques]; empty if no segment is long enough.
    """

    fit: ChannelFit
    factors: tuple[Factor, ...]

    def unexplained(self, T: Array) -> Array | None:
        """Share of each torque's power that realizable bodies leave unexplained.

        Parameters
        ----------
        T
            Shape (nv, nv).

        Returns
        -------
        u, at least 1e-3, shape (nv,); 1e-3 for a joint that hardly moves. None if no fit was found.
        """
        if not self.factors:
            return None
        nv = len(self.factors)
        data = []
        for factor, row in zip(self.factors, T, strict=True):
            R = np.column_stack([factor.R[:, :-nv], factor.R[:, -nv:] @ row])
            data.append(replace(factor, R=R))
        power = np.array([np.square(factor.R[:, -1]).sum() / max(factor.rows, 1) for factor in data])
        noise = np.sqrt(self.free(T) * power)
        noise[noise == 0] = 1.0
        fit = self.fit
        try:
            theta = estimate(fit.equation, fit.bodies, tuple(data), fit.sets, WEAK_PRIOR, noise=noise).theta
        except (SolverError, np.linalg.LinAlgError):  # channels may be too wrong for any fit
            return None
        u = np.empty(nv)
        for j, (factor, active) in enumerate(zip(data, fit.equation.active(), strict=True)):
            u[j] = _power_share(factor.squared_error(theta[active]), float(np.square(factor.R[:, -1]).sum()))
        return np.where(self.hardly_moving, MIN_UNEXPLAINED, np.maximum(u, MIN_UNEXPLAINED))

    @property
    def hardly_moving(self) -> Mask:
        """Joints that move too little to be evaluated, shape (nv,)."""
        return np.array([factor.rows < _ROWS_PER_COEFFICIENT * factor.R.shape[1] for factor in self.factors])

    def free(self, T: Array) -> Array:
        """Share of each torque that unconstrained coefficients leave, joint by joint: a bound on u; shape (nv,)."""
        shares = []
        for row, (rest, whole) in zip(T, self._powers, strict=True):
            shares.append(_power_share(row @ rest @ row, row @ whole @ row))
        return np.array(shares)

    @property
    def exchanged(self) -> Array:
        """Share of joint k's torque that unconstrained coefficients leave in joint j's equation, shape (nv, nv)."""
        return np.array([list(map(_power_share, np.diag(rest), np.diag(whole))) for rest, whole in self._powers])

    @cached_property
    def _powers(self) -> list[tuple[Array, Array]]:
        """Products of all torques, (nv, nv) each: of their residuals under a joint's columns, and of themselves."""
        nv = len(self.factors)
        powers = []
        for factor in self.factors:
            Y, torques = factor.R[:, :-nv], factor.R[:, -nv:]
            size = np.linalg.norm(Y, axis=0)
            size[size == 0] = 1.0
            rest = torques - Y / size @ least_squares(Y / size, torques, _RANK)[0]
            powers.append((rest.T @ rest, torques.T @ torques))
        return powers


def _power_share(rest: float, power: float) -> float:
    """Share of a residual in a torque's power, at least 1e-6; 1 without any torque."""
    return max(float(rest / power), _MIN_NOISE) if power > 0 else 1.0


def _with_plain_effects(config: Config, joints: tuple[str, ...]) -> Config:
    """The configuration with all plain effects on every joint."""
    present = {(entry.effect, entry.joint) for entry in config.effects}
    plain = [kind for kind in effect_types().values() if kind.is_commonplace and issubclass(kind, JointEffect)]
    added = [kind.zero_entry(joint) for joint in joints for kind in plain if (kind.id, joint) not in present]
    return config.model_copy(update={"effects": (*config.effects, *added)})


def _sample_batches(experiment: Experiment) -> Iterator[Batch]:
    """Segments evenly spread over all logs, of bounded total length."""
    segments = []
    full_segments = 0.0  # that the logs contain
    for run in experiment.runs:
        length = _SEGMENT_ROWS * run.signals.low_pass.stride
        for part in run.signals.ranges:
            for start in range(part.start, part.stop, length):
                segments.append((run.signals, slice(start, min(start + length, part.stop))))
            full_segments += (part.stop - part.start) / length
    wanted = round(_SEGMENTS * len(segments) / max(full_segments, 1.0))
    count = min(len(segments), max(_SEGMENTS, wanted), _MAX_SEGMENTS)
    for i in np.linspace(0, len(segments) - 1, count).astype(int):
        signals, segment = segments[i]
        yield from signals.batches([segment])


def _in_band(batch: Batch) -> Motion:
    """A batch's motion in the band and decimated."""
    motion, low_pass = batch.motion, batch.low_pass
    q, v, a, tau = (batch.filter(x) for x in (motion.q, motion.v, motion.a, motion.tau))
    dt = motion.dt * low_pass.stride
    deadband, log, recording = motion.velocity_deadband, motion.log, motion.recording
    return Motion(batch.t, q, v, a, tau, tau, deadband, dt, log=log, recording=recording)


def _groups(support: Mask) -> tuple[Indices, ...]:
    """Joints that share bodies, from the mask of the nv joints that move each body, shape (bodies, nv)."""
    group = np.arange(support.shape[1])
    for moved in support:
        together = np.isin(group, group[moved])
        if moved.any():
            group[together] = group[together].min()
    return tuple(np.flatnonzero(group == g) for g in np.unique(group))
