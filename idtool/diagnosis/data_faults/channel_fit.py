"""Fit of realizable bodies to the torque, with a log's channels taken for something else than they say.

A bounded sample of the logs is fitted by the model with all that a joint may well have beside its bodies: friction,
an offset, a spring and a rotor. So no torque is called impossible that one of them explains. What remains impossible
is what physics forbids whatever the robot: friction that drives, inertia below zero, one mass felt by two joints as
two. Channels that were swapped, turned round or scaled ask for just that. The URDF's masses have next to no say.

Letters: nv joints, n samples in the band; u_j share of the power of joint j's torque that is left unexplained; T
(nv, nv) true torques from the logged ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.exceptions import SolverError
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

_PARTS, _ROWS = 8, 384  # stretches of the logs, and samples in the band of each
_MOST = 64  # stretches, where gaps make them shorter
EXPLAINED = 1e-3  # of a torque's power: a smaller rest is no better explained
_QUIET = 1e-6  # of a torque's power that its noise is taken to have at least
_FEWEST = 4.0  # rows for each coefficient, for a joint to have a say
_RANK = 1e-8  # of the largest singular value


class ChannelFit:
    """A bounded sample of the logs, and the model to fit to it.

    Attributes
    ----------
    equation
        The torque equation with all plain effects.
    batches
        Stretches of the logs, evenly spread.
    motions
        The same in the band and decimated, n samples each.
    groups
        Joints that have a body in common, directly or by others; nothing that is done to one group's channels
        concerns another.
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
        self.equation = LinearModel(names, build_effects(experiment.model, _generous(experiment.config, names)))
        self.batches = tuple(_spread(experiment))
        self.motions = tuple(map(_in_band, self.batches))
        self.groups = _groups(experiment.model.support())
        self.prior = np.concatenate([body.pi for body in self.bodies])

    def reduced(self, change: Change) -> ReducedSample:
        """The sample with position, velocity and acceleration changed, reduced to factors."""
        total: tuple[Factor, ...] | None = None
        for motion, batch in zip(self.motions, self.batches, strict=True):
            factors = tuple(Factor.from_columns(rows, batch.low_pass.redundancy) for rows in self._rows(change(motion)))
            total = factors if total is None else tuple(a + b for a, b in zip(total, factors, strict=True))
        return ReducedSample(self, total or ())

    def _rows(self, motion: Motion) -> Iterator[Array]:
        """Per joint its columns and all torques where it moves, shape (m_j + nv, n)."""
        moving = np.ones(motion.q.shape, dtype=bool)
        for effect in self.equation.effects:
            for joint, mask in effect.invalid_mask(motion).items():
                moving[joint] &= ~mask
        blocks = self.equation.columns(motion)
        torques = np.stack([block[-1] for block in blocks])
        for block, columns in zip(blocks, moving, strict=True):
            yield np.vstack([block[:-1], torques])[:, columns]

    @cached_property
    def excess(self) -> Array:
        """log10 of the size of each torque over what the URDF's bodies take, 0 where one is zero; shape (nv,)."""
        power = np.zeros((2, len(self.equation.joints)))
        for motion in self.motions:
            for j, block in enumerate(self.equation.columns(motion)):
                power[:, j] += np.square(self.rigid(j, block)).sum(), np.square(block[-1]).sum()
        known = power.all(axis=0)
        return np.where(known, 0.5 * np.log10(np.where(known, power[1], 1) / np.where(known, power[0], 1)), 0.0)

    def rigid(self, j: int, block: Array) -> Array:
        """Torque of joint j that the URDF's bodies take, from the joint's columns, shape (n,)."""
        active = self.equation.active()[j]
        bodies = active[active < len(self.prior)]
        return np.asarray(self.prior[bodies] @ block[: len(bodies)])


@dataclass(frozen=True)
class ReducedSample:
    """The sample reduced, positions being what they are taken for and torques as logged.

    Attributes
    ----------
    fit
        The sample.
    factors
        Per joint, that of [Y_j, all torques]; none where no stretch is long enough.
    """

    fit: ChannelFit
    factors: tuple[Factor, ...]

    def unexplained(self, T: Array) -> Array | None:
        """Share of each torque's power that bodies that can be leave unexplained.

        Parameters
        ----------
        T
            Shape (nv, nv).

        Returns
        -------
        u, at least 1e-3, shape (nv,), and so for a joint that tells nothing; None where no fit was found.
        """
        if not self.factors:
            return None
        nv, fit = len(self.factors), self.fit
        data = tuple(
            replace(f, R=np.column_stack([f.R[:, :-nv], f.R[:, -nv:] @ row]))
            for f, row in zip(self.factors, T, strict=True)
        )
        power = np.array([np.square(f.R[:, -1]).sum() / max(f.rows, 1) for f in data])
        noise = np.sqrt(self.free(T) * power)
        noise[noise == 0] = 1.0
        try:
            theta = estimate(fit.equation, fit.bodies, data, fit.sets, WEAK_PRIOR, noise=noise).theta
        except (SolverError, np.linalg.LinAlgError):  # channels may be beyond all sense
            return None
        left = [f.squared_error(theta[columns]) for f, columns in zip(data, fit.equation.active(), strict=True)]
        u = np.array([_quotient(x, float(np.square(f.R[:, -1]).sum())) for x, f in zip(left, data, strict=True)])
        return np.where(self.mute, EXPLAINED, np.maximum(u, EXPLAINED))

    @property
    def mute(self) -> Mask:
        """Joints that move too little to tell anything, shape (nv,)."""
        return np.array([factor.rows < _FEWEST * factor.R.shape[1] for factor in self.factors])

    def free(self, T: Array) -> Array:
        """Share of each torque that any coefficients whatever leave, joint by joint: u can't be less; shape (nv,)."""
        pairs = zip(T, self._powers, strict=True)
        return np.array([_quotient(row @ rest @ row, row @ whole @ row) for row, (rest, whole) in pairs])

    @property
    def exchanged(self) -> Array:
        """Share of joint k's torque that any coefficients whatever leave in joint j's equation, shape (nv, nv)."""
        return np.array([list(map(_quotient, np.diag(rest), np.diag(whole))) for rest, whole in self._powers])

    @cached_property
    def _powers(self) -> list[tuple[Array, Array]]:
        """Per joint, products of all torques with each other: of what its columns leave of them, and of them."""
        nv = len(self.factors)
        powers = []
        for factor in self.factors:
            Y, torques = factor.R[:, :-nv], factor.R[:, -nv:]
            size = np.linalg.norm(Y, axis=0)
            size[size == 0] = 1.0
            rest = torques - Y / size @ np.linalg.lstsq(Y / size, torques, rcond=_RANK)[0]
            powers.append((rest.T @ rest, torques.T @ torques))
        return powers


def _quotient(rest: float, power: float) -> float:
    """Share of the rest in a torque's power, at least 1e-6; 1 of none."""
    return max(float(rest / power), _QUIET) if power > 0 else 1.0


def _generous(config: Config, joints: tuple[str, ...]) -> Config:
    """The configuration with all plain effects on every joint."""
    present = {(entry.effect, entry.joint) for entry in config.effects}
    plain = [kind for kind in effect_types().values() if kind.is_commonplace and issubclass(kind, JointEffect)]
    added = [kind.zero_entry(joint) for joint in joints for kind in plain if (kind.id, joint) not in present]
    return config.model_copy(update={"effects": (*config.effects, *added)})


def _spread(experiment: Experiment) -> Iterator[Batch]:
    """Stretches evenly spread over all logs, of bounded length in all."""
    pieces, wanted = [], 0.0
    for run in experiment.runs:
        length = _ROWS * run.signals.low_pass.stride
        for whole in run.signals.ranges:
            starts = range(whole.start, whole.stop, length)
            pieces += [(run.signals, slice(start, min(start + length, whole.stop))) for start in starts]
            wanted += (whole.stop - whole.start) / length
    count = min(len(pieces), max(_PARTS, round(_PARTS * len(pieces) / max(wanted, 1.0))), _MOST)
    for i in np.linspace(0, len(pieces) - 1, count).astype(int):
        signals, part = pieces[i]
        yield from signals.batches([part])


def _in_band(batch: Batch) -> Motion:
    """A batch's motion in the band and decimated."""
    motion, low_pass = batch.motion, batch.low_pass
    q, v, a, tau = (batch.filter(x) for x in (motion.q, motion.v, motion.a, motion.tau))
    return Motion(batch.t, q, v, a, tau, tau, motion.velocity_deadband, motion.dt * low_pass.stride)


def _groups(support: Mask) -> tuple[Indices, ...]:
    """Joints that share bodies, from which of the nv joints move which body, shape (bodies, nv)."""
    group = np.arange(support.shape[1])
    for moved in support:
        together = np.isin(group, group[moved])
        if moved.any():
            group[together] = group[together].min()
    return tuple(np.flatnonzero(group == g) for g in np.unique(group))
