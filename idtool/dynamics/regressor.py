"""Effects → blocks of (columns, torque), one per joint, batch after batch.

Y_j (n, m_j): the columns of joint j's equation that are not identically zero, tau_j (n,) its torque, both through the
same low-pass. Here transposed and in one array, the torque last: (m_j + 1, n).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import ndimage

from idtool.common.arrays import Array, Indices, Mask
from idtool.data.signals import Batch, Motion
from idtool.dynamics.effects.base import Coefficient, Effect
from idtool.dynamics.effects.survey import Present
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.present import PresentModel
from idtool.robot.model import Model

_UNDEFINED = 0.3  # share of a filtered sample's weight that may come from samples where a column is not defined
_CLEAR = 0.03  # of its weight by magnitude, with which such samples do not show in it


def _turns(v: Array) -> Mask:
    """Samples between which a joint turns round, however fast, shape (N,)."""
    turns = np.zeros(len(v), dtype=bool)
    at = np.flatnonzero(v[1:] * v[:-1] < 0)
    turns[at] = turns[at + 1] = True
    return turns


def _beside(effect: Effect, other: Effect) -> bool:
    """Whether another effect is part of the model that one refers to."""
    return type(other) is not type(effect) and type(other).true is Effect.true


@dataclass(frozen=True)
class LinearModel:
    """The torque equation as a list of effects.

    Attributes
    ----------
    joints
        Names of the nv joints.
    effects
        The terms; their coefficients one after the other are the p unknowns.
    reference
        Coefficients that the effects go by which need to know the model, by key; others are taken at their prior.
    """

    joints: tuple[str, ...]
    effects: tuple[Effect, ...]
    reference: Mapping[tuple[str, str, str, tuple[float, ...]], float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for effect in self.effects:
            own = [self.reference.get(c.key, c.prior) for c in effect.coefficients]
            effect.refer(self._without(effect), np.array(own))

    def _without(self, effect: Effect) -> Callable[[Motion], Present]:
        """The model without effects of its kind, along a motion as it was, which no effect turns into another."""
        kept: list[PresentModel] = []  # the last: several ask about one motion

        def along(motion: Motion) -> Present:
            if not kept or kept[0].measured is not motion:
                others = LinearModel(self.joints, tuple(x for x in self.effects if _beside(effect, x)))
                theta = np.array([self.reference.get(c.key, c.prior) for c in others.coefficients])
                kept[:] = [PresentModel(others, theta, motion)]
            return kept[0]

        return along

    @property
    def refers(self) -> bool:
        """Whether columns depend on what the coefficients are."""
        return any(type(effect).refer is not Effect.refer for effect in self.effects)

    def about(self, theta: Array) -> LinearModel:
        """The same with columns as they are by coefficients, shape (p,)."""
        reference = {c.key: float(x) for c, x in zip(self.coefficients, theta, strict=True)}
        return LinearModel(self.joints, tuple(copy(effect) for effect in self.effects), reference)

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """The p unknowns."""
        return tuple(c for effect in self.effects for c in effect.coefficients)

    @property
    def prior(self) -> Array:
        """Their values before any data, shape (p,)."""
        return np.array([c.prior for c in self.coefficients])

    def offsets(self) -> Indices:
        """Where each effect's coefficients begin, and p."""
        return np.cumsum([0, *(len(effect.coefficients) for effect in self.effects)])

    def active(self) -> tuple[Indices, ...]:
        """Per joint, which of the p unknowns appear in its equation."""
        starts = self.offsets()[:-1]
        return tuple(
            np.concatenate([start + effect.active[j] for start, effect in zip(starts, self.effects, strict=True)])
            for j in range(len(self.joints))
        )

    def columns(self, motion: Motion) -> list[Array]:
        """Unfiltered columns and torque, per joint; shape (m_j + 1, N) each, the torque last.

        All as it was, not as it was measured, and the torque less what takes no coefficient.
        """
        for effect in self.effects:
            motion = effect.true(motion)
        blocks = [np.empty((len(active) + 1, len(motion.t))) for active in self.active()]
        first = [0] * len(self.joints)
        for effect in self.effects:
            sizes = [len(active) for active in effect.active]
            effect.write(motion, [block[f : f + s] for block, f, s in zip(blocks, first, sizes, strict=True)])
            first = [f + s for f, s in zip(first, sizes, strict=True)]
        known = self._known(motion)
        for block, tau in zip(blocks, motion.tau - known if known is not None else motion.tau, strict=True):
            block[-1] = tau
        return blocks

    def torques(self, motion: Motion) -> Array:
        """What the last rows of `columns` would be with each of the motion's `torques`, shape (K, nv, N)."""
        found = np.empty_like(motion.torques)
        for k, tau in enumerate(motion.torques):
            true = replace(motion, tau=tau)
            for effect in self.effects:
                true = effect.true(true)
            known = self._known(true)
            found[k] = true.tau - known if known is not None else true.tau
        return found

    def _known(self, motion: Motion) -> Array | None:
        """Torque of the effects that takes no coefficient, shape (nv, N)."""
        known = [torque for effect in self.effects if (torque := effect.known(motion)) is not None]
        return np.sum(known, axis=0) if known else None

    def block(self, batch: Batch) -> list[Array]:
        """Filtered columns and torque in the band; per joint (m_j + 1, n), the torque last.

        Samples that owe more than 30 % of their weight to moments where a column is not defined, such as the sign of
        a velocity of zero, are left out of that joint's block.
        """
        return [b if keep.all() else b[:, keep] for b, keep in zip(*self.rows(batch), strict=True)]

    def rows(self, batch: Batch) -> tuple[list[Array], list[Mask]]:
        """The same with all samples, and per joint whether each counts, shape (n,)."""
        return [batch.filter(columns) for columns in self.columns(batch.motion)], self.kept(batch)

    def kept(self, batch: Batch) -> list[Mask]:
        """Per joint, whether each filtered sample counts, shape (n,)."""
        kept = [np.ones(len(batch.t), dtype=bool) for _ in self.joints]
        for joint, masks in self._undefined(batch).items():
            for mask in masks:
                if mask.any():
                    kept[joint] &= batch.filter(mask.astype(float)) <= _UNDEFINED
        return kept

    def clear(self, batch: Batch, apart: float = 0.0) -> list[Mask]:
        """Those that count and have next to nothing of moments where a column is not defined, by joint, shape (n,).

        A light joint's friction is hundreds of times its noise, and what is wrong at a reversal rings in the filter for
        long. Where they need not be further apart, half of a joint's samples are kept even if it turns round always:
        of all moments together, since where one effect's column is defined, another's may not be.

        Parameters
        ----------
        batch
            The samples.
        apart
            How far from such moments they must be beside [s].
        """
        kept, motion = self.kept(batch), batch.motion
        for joint, masks in self._undefined(batch).items():
            mask = np.logical_or.reduce(masks)
            if around := round(apart / motion.dt):
                mask = ndimage.binary_dilation(mask | _turns(motion.v[joint]), iterations=around)
            share = batch.low_pass.share(mask, batch.before, batch.after)
            kept[joint] &= share <= (_CLEAR if around else max(_CLEAR, float(np.median(share))))
        return kept

    def _undefined(self, batch: Batch) -> dict[int, list[Mask]]:
        """Joints, and where a column of theirs is not defined, effect by effect, shape (N,) each."""
        masks: dict[int, list[Mask]] = {}
        for effect in self.effects:
            for joint, mask in effect.undefined(batch.motion).items():
                masks.setdefault(joint, []).append(mask)
        return masks

    def torque(self, motion: Motion, theta: Array) -> Array:
        """The torque that the model predicts, as the sensors give it, unfiltered.

        Parameters
        ----------
        motion
            N samples, as measured.
        theta
            Coefficients, shape (..., p).

        Returns
        -------
        Shape (..., nv, N) [N·m or N].
        """
        blocks = self.columns(motion)
        rows = [theta[..., active] @ block[:-1] for active, block in zip(self.active(), blocks, strict=True)]
        tau = np.stack(rows, axis=-2)
        true = motion
        for effect in self.effects:
            true = effect.true(true)
        known = self._known(true)
        if known is not None:
            tau = tau + known
        for effect in reversed(self.effects):
            tau = effect.measured(tau, motion)
        return tau

    def mechanism(self, model: Model, theta: Array) -> Mechanism:
        """The same equation run forwards.

        Parameters
        ----------
        model
            The tree of bodies that it is of.
        theta
            Coefficients, shape (p,).
        """
        mechanism = Mechanism(model)
        for effect, first, last in zip(self.effects, self.offsets()[:-1], self.offsets()[1:], strict=True):
            effect.join(theta[first:last], mechanism)
        return mechanism
