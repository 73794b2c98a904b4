"""`LinearModel`: effects → blocks of columns and torque, one per joint, batch after batch.

Y_j (n, m_j) holds the columns of joint j's equation that are not identically zero, tau_j (n,) its torque, both through
the same low-pass. Here a block is their transpose in one array, the torque last: (m_j + 1, n).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import field, replace
from functools import cached_property, partial
from hashlib import blake2b
from typing import NamedTuple

import numpy as np

from idtool.common.arrays import Array, Indices, Mask, dilated
from idtool.common.dataclass import dataclass
from idtool.data.column_cache import IdentityKey
from idtool.data.signals import Batch, Motion, reversals
from idtool.dynamics.contact_model import ContactModel
from idtool.dynamics.effects.effect import Coefficient, Effect
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.named_effect import NamedEffect
from idtool.dynamics.effects.rigid_body import RigidBodies
from idtool.dynamics.effects.torque_sensor import TorqueSensorEffect
from idtool.dynamics.linearized_model import LinearizedModel, effect_columns, kept_columns_of, kept_effect_columns
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.row_filter import ProjectedRows, RowFilter, SeparateRows, Shares
from idtool.robot.model import RobotModel

_MAX_INVALID_WEIGHT = 0.3  # share of a valid filtered sample's weight that may come from invalid samples
_PROJECTED_TOGETHER = 40  # columns from which contact forces are eliminated together, to bound the memory
_WEIGHT_ROUNDING = 1e-12  # many samples have the median of the weights, which are computed by a Fourier transform
_CLEAN_WEIGHT = 0.03  # share by magnitude up to which invalid samples do not show in a filtered one

OperatingPoint = Mapping[tuple[str, str, str, tuple[float, ...]], float]  # coefficients by key


class ComparedTorques(NamedTuple):
    """Measured and predicted torque as they are compared, low-passed.

    Attributes
    ----------
    measured
        Shape (nv, n) [N·m or N].
    predicted
        Shape (..., nv, n) for coefficients of shape (..., p).
    is_compared
        Mask of the rows that are compared, shape (nv,).
    """

    measured: Array
    predicted: Array
    is_compared: Mask


@dataclass(frozen=True)
class LinearModel:
    """The torque equation as a list of effects.

    Attributes
    ----------
    joints
        Names of the nv joints.
    effects
        The terms; their coefficients one after the other are the p unknowns.
    operating_point
        Coefficients, by key, for the effects whose columns depend on them; others are taken at their prior.
    contacts
        Forces at the contacts; None: the base is fixed, and there are none. Filtered rows are without what the unknown
        ones can exert, which takes coefficients from one row to another.
    known_bodies
        Parameters of all bodies, if they are known, shape (10 · bodies,). Then the bodies have no columns in filtered
        rows, and their torque is subtracted from the measured one. None: they are identified.
    """

    joints: tuple[str, ...]
    effects: tuple[Effect, ...]
    operating_point: OperatingPoint = field(default_factory=dict)
    contacts: ContactModel | None = None
    known_bodies: Array | None = None
    _true_motions: dict[IdentityKey[Motion], Motion] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _masks: dict[IdentityKey[Motion], dict[int, list[Mask]]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        for effect in self.effects:
            theta = np.array([self.operating_point.get(c.key, c.prior) for c in effect.coefficients])
            effect.set_operating_point(self._model_without(effect), theta)

    def _model_without(self, effect: Effect) -> Callable[[Motion], Linearization]:
        """The model without effects of one kind, along a true motion, which no effect corrects again."""
        others = [
            other
            for other in self.effects
            if type(other) is not type(effect) and type(other).correct_motion is Effect.correct_motion
        ]
        latest: LinearizedModel | None = None  # several effects ask about one motion

        def along(motion: Motion) -> Linearization:
            nonlocal latest
            if latest is None or latest.measured_motion is not motion:
                copies = tuple(copy(other) for other in others)  # those of this model keep their operating point
                equation = LinearModel(self.joints, copies, self.operating_point, self.contacts)
                latest = LinearizedModel(equation, equation.operating_theta, motion)
            return latest

        return along

    @property
    def depends_on_parameters(self) -> bool:
        """True if columns depend on the coefficients."""
        return any(type(effect).set_operating_point is not Effect.set_operating_point for effect in self.effects)

    @property
    def has_sensors(self) -> bool:
        """True if an effect acts between the true and the measured torque."""
        return any(type(effect).apply_sensor is not Effect.apply_sensor for effect in self.effects)

    def linearized_at(self, theta: Array) -> LinearModel:
        """The model with its columns at other coefficients, shape (p,)."""
        operating_point = {c.key: float(x) for c, x in zip(self.coefficients, theta, strict=True)}
        effects = tuple(copy(effect) for effect in self.effects)
        return replace(self, effects=effects, operating_point=operating_point)

    def with_contacts(self, contacts: ContactModel) -> LinearModel:
        """The model with other contacts."""
        return replace(self, effects=tuple(copy(effect) for effect in self.effects), contacts=contacts)

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """The p unknowns."""
        return self._coefficients

    @cached_property
    def _coefficients(self) -> tuple[Coefficient, ...]:
        return tuple(c for effect in self.effects for c in effect.coefficients)

    @property
    def prior(self) -> Array:
        """Values of the unknowns before any data, shape (p,)."""
        return np.array([c.prior for c in self.coefficients])

    @property
    def operating_theta(self) -> Array:
        """Values of the unknowns at the operating point, shape (p,)."""
        return np.array([self.operating_point.get(c.key, c.prior) for c in self.coefficients])

    def offsets(self) -> Indices:
        """Index of each effect's first coefficient, and p."""
        return np.cumsum([0, *(len(effect.coefficients) for effect in self.effects)])

    def effect_slices(self) -> Iterator[tuple[Effect, slice]]:
        """Each effect with the range of its coefficients among the p unknowns."""
        offsets = self.offsets().tolist()
        for effect, start, end in zip(self.effects, offsets[:-1], offsets[1:], strict=True):
            yield effect, slice(start, end)

    def find_named_effect(self, key: Hashable) -> tuple[NamedEffect, slice] | None:
        """Effect of a key and the range of its coefficients among the p unknowns; None if there is none."""
        for effect, part in self.effect_slices():
            if isinstance(effect, NamedEffect) and effect.key == key:
                return effect, part
        return None

    def active(self) -> tuple[Indices, ...]:
        """Per joint, indices of the unknowns in its filtered rows."""
        return self._active

    @cached_property
    def _active(self) -> tuple[Indices, ...]:
        effects = [(effect, part.start) for effect, part in self.effect_slices() if self._has_filtered_columns(effect)]
        if self.contacts is None:
            return self._active_of(effects)
        all_indices = _joined([first + np.arange(len(effect.coefficients)) for effect, first in effects])
        return tuple(all_indices for _ in self.joints)

    def active_in_columns(self) -> tuple[Indices, ...]:
        """Per joint, indices of the unknowns in its `columns`."""
        return self._active_of([(effect, part.start) for effect, part in self.effect_slices()])

    def _active_of(self, effects: Sequence[tuple[Effect, int]]) -> tuple[Indices, ...]:
        """Per joint, indices of the unknowns of effects, each with the index of its first one."""
        active = []
        for joint in range(len(self.joints)):
            active.append(_joined([first + effect.active[joint] for effect, first in effects]))
        return tuple(active)

    def _has_filtered_columns(self, effect: Effect) -> bool:
        """False for bodies that are known."""
        return self.known_bodies is None or not isinstance(effect, RigidBodies)

    def columns(self, motion: Motion) -> list[Array]:
        """Unfiltered columns and torque, per joint; shape (m_j + 1, N) each, the torque last.

        Both are of the true motion, and the torque is less that without a coefficient.
        """
        true = self.true_motion(motion)
        blocks = [np.empty((len(active) + 1, len(true.t))) for active in self.active_in_columns()]
        row = [0] * len(self.joints)  # the next of each block
        for effect in self.effects:
            out = []
            for joint, block in enumerate(blocks):
                count = len(effect.active[joint])
                out.append(block[row[joint] : row[joint] + count])
                row[joint] += count
            effect.columns(true, out)
        tau = self._identified_torque(true)
        for joint, block in enumerate(blocks):
            block[-1] = tau[joint]
        return blocks

    def residual(self, motion: Motion, theta: Array) -> Array:
        """Torque less columns · theta, unfiltered, both as in `columns`; shape (nv, N) [N·m or N].

        Parameters
        ----------
        motion
            N samples, as measured.
        theta
            Coefficients, shape (p,).
        """
        true = self.true_motion(motion)
        residual = self.torque_left_for_bodies(true, theta)
        for effect, part in self.effect_slices():
            if isinstance(effect, RigidBodies):
                residual -= _torque(effect, theta[part], true)
        return residual

    def torque_left_for_bodies(self, true_motion: Motion, theta: Array) -> Array:
        """Measured torque less that of all effects but the rigid bodies, unfiltered, shape (nv, N) [N·m or N].

        Parameters
        ----------
        true_motion
            N samples, as the effects correct them.
        theta
            Coefficients, shape (p,).
        """
        torque = self._identified_torque(true_motion).copy()
        for effect, part in self.effect_slices():
            if not isinstance(effect, RigidBodies):
                torque -= _torque(effect, theta[part], true_motion)
        return torque

    def filtered_columns(self, batch: Batch, row_filter: RowFilter | None = None) -> list[Array]:
        """Filtered columns and torque of all samples, per joint; shape (m_j + 1, n) each, the torque last.

        Parameters
        ----------
        batch
            The samples.
        row_filter
            From `row_filter`; None: that of this equation.
        """
        if self.contacts is not None:
            return self._projected_columns(row_filter or self.row_filter(batch))
        true = self.true_motion(batch.motion)
        tau = batch.filter(self._torque_of_unknowns(true))
        parts: list[list[Array]] = [[] for _ in self.joints]
        for effect in filter(self._has_filtered_columns, self.effects):
            columns = _filtered_columns(effect, true, batch)
            for joint in effect.active_joints:
                parts[joint].append(columns[joint])
        return [np.concatenate([*part, row[None]]) for part, row in zip(parts, tau, strict=True)]

    def _projected_columns(self, row_filter: RowFilter) -> list[Array]:
        """`filtered_columns` without what unknown contact forces can exert."""
        true = self.true_motion(row_filter.batch.motion)
        effects = filter(self._has_filtered_columns, self.effects)
        parts = [_projected_columns_of(effect, true, row_filter) for effect in effects]
        tau = row_filter.filter_rows(self._torque_of_unknowns(true))
        return list(np.concatenate([*parts, tau[:, None]], axis=1))

    def filtered_torque(self, batch: Batch, row_filter: RowFilter) -> Array:
        """Filtered torque as in `columns`, shape (nv, n): in `filtered_columns`, that of known bodies is subtracted."""
        return row_filter.filter_rows(self._identified_torque(self.true_motion(batch.motion)))

    def row_filter(
        self, batch: Batch, defined_for: LinearModel | None = None, min_distance: float | None = None
    ) -> RowFilter:
        """Filter that takes the rows of a batch to the band, and tells which of them count.

        Parameters
        ----------
        batch
            The samples.
        defined_for
            Equation whose columns must be defined where a row counts; None: this one.
        min_distance
            Least distance in time from undefined samples and reversals, for `clean_samples` [s]; None: `valid_samples`.
            With contacts, None is as 0: a joint's row is left out at every sample at which it is not defined, before
            the filter can spread it.
        """
        mask_equation = defined_for or self
        if self.contacts is None:
            if min_distance is None:
                return SeparateRows(batch, mask_equation.valid_samples(batch))
            return SeparateRows(batch, mask_equation.clean_samples(batch, min_distance))
        true = self.true_motion(batch.motion)
        excluded = mask_equation._excluded_samples(batch.motion, min_distance or 0.0)
        evaluate = partial(self.contacts.projector, true, excluded)
        kept = true.kept_columns
        if kept is None or not kept.are_along(true.q, true.v, true.a):
            return ProjectedRows(batch, self.contacts, evaluate())
        digest = blake2b()
        if true.contacts is not None:
            digest.update(np.float64(true.contacts.radius_change).tobytes())
        for joint, mask in sorted(excluded.items()):
            digest.update(joint.to_bytes(4, "little"))
            digest.update(np.packbits(mask).tobytes())
        key = ("projector", IdentityKey(self.contacts), digest.digest())
        (projector,) = kept.get(key, lambda: (evaluate(),))
        return ProjectedRows(batch, self.contacts, projector, key)

    def _excluded_samples(self, motion: Motion, min_distance: float) -> dict[int, Mask]:
        """By joint, mask of the samples of a motion at which columns are not defined, or that are near such a sample.

        With a distance above 0 [s], samples near a reversal of the joint are excluded too.
        """
        reach = round(min_distance / motion.dt)
        true = self.true_motion(motion)
        excluded = {}
        for joint, masks in self._invalid_masks_along(motion).items():
            mask = np.logical_or.reduce(masks)
            if reach:
                if true.q[joint].any():  # the base and the wrench sensors have no position, and no friction
                    mask = mask | reversals(true.v[joint])
                mask = dilated(mask, reach)
            excluded[joint] = mask
        return excluded

    def delayed_torques(self, motion: Motion) -> Array:
        """The last rows of `filtered_columns`, unfiltered, with each of the motion's ``torques``, shape (K, nv, N)."""
        out = np.empty_like(motion.delayed_torques)
        for k, tau in enumerate(motion.delayed_torques):
            true = self.true_motion(replace(motion, tau=tau))
            out[k] = self._torque_of_unknowns(true)
        return out

    def true_motion(self, motion: Motion) -> Motion:
        """Motion as the effects correct it."""
        if motion.kept_columns is None:
            return self._corrected(motion)
        key = IdentityKey(motion)
        if key not in self._true_motions:
            self._true_motions[key] = self._corrected(motion)
        return self._true_motions[key]

    def _corrected(self, motion: Motion) -> Motion:
        for effect in self.effects:
            motion = effect.correct_motion(motion)
        kept = motion.kept_columns
        if kept is None or kept.are_along(motion.q, motion.v, motion.a):
            return motion
        kept_along_corrected = kept.along(motion.q, motion.v, motion.a, motion.motor_minus_link.values())
        return replace(motion, kept_columns=kept_along_corrected)

    def _identified_torque(self, motion: Motion) -> Array:
        """Torque of a true motion less that without a coefficient, shape (nv, N)."""
        fixed = self._fixed_torque(motion)
        torque = motion.tau if fixed is None else motion.tau - fixed
        return torque if self.contacts is None else torque + self.contacts.measured_force(motion)

    def _torque_of_unknowns(self, motion: Motion) -> Array:
        """`_identified_torque` less that of known bodies, shape (nv, N)."""
        torque = self._identified_torque(motion)
        if self.known_bodies is None:
            return torque
        (bodies,) = (effect for effect in self.effects if isinstance(effect, RigidBodies))
        return torque - _torque(bodies, self.known_bodies, motion)

    def _fixed_torque(self, motion: Motion) -> Array | None:
        """Torque of the effects without a coefficient, shape (nv, N)."""
        torques = []
        for effect in self.effects:
            torque = effect.fixed_torque(motion)
            if torque is not None:
                torques.append(torque)
        return np.sum(torques, axis=0) if torques else None

    def block(self, batch: Batch) -> list[Array]:
        """Filtered columns and torque in the band; per joint (m_j + 1, n), the torque last.

        Samples that owe more than 30 % of their weight to moments where a column is not defined, such as the sign of
        a velocity of zero, are left out of that joint's block.
        """
        blocks, valid = self.filtered_rows(batch)
        return [block if keep.all() else block[:, keep] for block, keep in zip(blocks, valid, strict=True)]

    def filtered_rows(self, batch: Batch) -> tuple[list[Array], list[Mask]]:
        """Filtered columns and torque of all samples, and the mask of valid ones, shape (n,); per joint."""
        return self.filtered_columns(batch), self.valid_samples(batch)

    def counted_rows(self, batch: Batch) -> tuple[list[Array], Shares]:
        """Filtered columns and torque of all samples, and the share of each sample that counts, shape (n,); per row."""
        row_filter = self.row_filter(batch)
        return self.filtered_columns(batch, row_filter), row_filter.shares

    def valid_samples(self, batch: Batch) -> list[Mask]:
        """Per joint, mask of the filtered samples whose columns are defined, shape (n,).

        With contacts, all are; see `row_filter`.
        """
        valid = [np.ones(len(batch.t), dtype=bool) for _ in self.joints]
        if self.contacts is not None:
            return valid
        for joint, masks in self._invalid_masks(batch).items():
            for mask in masks:
                if mask.any():
                    valid[joint] &= batch.filter(mask.astype(float)) <= _MAX_INVALID_WEIGHT
        return valid

    def clean_samples(self, batch: Batch, min_distance: float = 0.0) -> list[Mask]:
        """Per joint, mask of the valid samples with next to no weight on invalid ones, shape (n,).

        A light joint's friction is hundreds of times its noise, and what is wrong at a reversal rings in the filter for
        long. With a ``min_distance`` of 0, half of a joint's samples are kept even if it reverses all the time. The
        weight is that of all effects' invalid samples together, since where one effect's column is defined, another's
        may not be.

        Parameters
        ----------
        batch
            The samples.
        min_distance
            Least distance in time from invalid samples and reversals [s].
        """
        clean = self.valid_samples(batch)
        if self.contacts is not None:
            return clean
        for joint, invalid in self._excluded_samples(batch.motion, min_distance).items():
            weight = batch.low_pass.masked_share(invalid, batch.before, batch.after)
            limit = _CLEAN_WEIGHT
            if min_distance == 0:
                limit = max(limit, float(np.median(weight)))
            clean[joint] &= weight <= limit + _WEIGHT_ROUNDING
        return clean

    def undefined_shares(self, batch: Batch) -> tuple[Array, Array]:
        """Shares of each filtered sample's weight, by magnitude, that come from samples where a column is undefined.

        Returns
        -------
        Those of friction, whose direction is unknown there, and those of other effects, shape (nv, n) each. With
        contacts, they are 0: such samples are left out of the rows before the filter.
        """
        shares = np.zeros((2, len(self.joints), len(batch.t)))
        if self.contacts is not None:
            return shares[0], shares[1]
        for row, is_friction in zip(shares, (True, False), strict=True):
            for joint, masks in self._invalid_masks(batch, is_friction).items():
                invalid = np.logical_or.reduce(masks)
                row[joint] = batch.low_pass.masked_share(invalid, batch.before, batch.after)
        return shares[0], shares[1]

    def _invalid_masks(self, batch: Batch, is_friction: bool | None = None) -> dict[int, list[Mask]]:
        """By joint, the masks of its effects' invalid samples, shape (N,) each; of friction or of others, or of all."""
        if is_friction is not None or batch.motion.kept_columns is None:
            return self._evaluated_masks(batch.motion, is_friction)
        return self._invalid_masks_along(batch.motion)

    def _invalid_masks_along(self, motion: Motion) -> dict[int, list[Mask]]:
        """By joint, the masks of all effects' invalid samples along a motion, shape (N,) each."""
        if motion.kept_columns is None:
            return self._evaluated_masks(motion)
        key = IdentityKey(motion)
        if key not in self._masks:
            self._masks[key] = self._evaluated_masks(motion)
        return self._masks[key]

    def _evaluated_masks(self, motion: Motion, is_friction: bool | None = None) -> dict[int, list[Mask]]:
        """`_invalid_masks` along a motion."""
        masks: dict[int, list[Mask]] = {}
        true = self.true_motion(motion)
        for effect in self.effects:
            if is_friction is not None and is_friction != (isinstance(effect, NamedEffect) and effect.is_friction):
                continue
            for joint, mask in effect.invalid_mask(true).items():
                masks.setdefault(joint, []).append(mask)
        if not is_friction:
            for joint in motion.unknown_torque:
                masks.setdefault(joint, []).append(np.ones(len(motion.t), dtype=bool))
        return masks

    def torque(self, motion: Motion, theta: Array) -> Array:
        """Measured torque that the model predicts, unfiltered.

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
        tau = self._predicted_torque(motion, theta)
        for effect in reversed(self.effects):
            tau = effect.apply_sensor(tau, motion)
        return tau

    def _predicted_torque(self, motion: Motion, theta: Array) -> Array:
        """True torque that the model predicts, shape (..., nv, N)."""
        tau = self._predicted_by_columns(motion, theta)
        fixed = self._fixed_torque(self.true_motion(motion))
        if fixed is not None:
            tau = tau + fixed
        return np.asarray(tau)

    def _predicted_by_columns(self, motion: Motion, theta: Array) -> Array:
        """Columns times coefficients, shape (..., nv, N)."""
        if theta.ndim == 1:
            true = self.true_motion(motion)
            torques = [_torque(effect, theta[part], true) for effect, part in self.effect_slices()]
            return np.asarray(np.sum(torques, axis=0))
        rows = []
        for active, block in zip(self.active_in_columns(), self.columns(motion), strict=True):
            rows.append(theta[..., active] @ block[:-1])
        return np.stack(rows, axis=-2)

    def compared_torques(self, batch: Batch, theta: Array, row_filter: RowFilter | None = None) -> ComparedTorques:
        """Measured and predicted torque as they are compared, in the band.

        Both are as the sensors give them, but where a motor saturates, as it reaches the joint: what lies between the
        motor and the log, such as a gain, is then undone too.

        Torque sensors see the predicted torque in the band: bent by one that saturates, the noise of its accelerations
        would not average to zero. Rows are not compared, and do not differ, if their torque is not known, or if unknown
        contact forces leave nothing of them.

        Parameters
        ----------
        batch
            Samples, as measured.
        theta
            Coefficients, shape (..., p).
        row_filter
            From `row_filter`; None: that of this equation.
        """
        if self.contacts is not None:
            return self._projected_torques(batch, theta, row_filter or self.row_filter(batch))
        undone = self._undone_sensors()
        measured = batch.motion
        for effect in reversed(undone):
            measured = effect.correct_motion(measured)

        remaining = [effect for effect in reversed(self.effects) if effect not in undone]
        predicted = self._predicted_torque(batch.motion, theta)
        for effect in remaining:
            if not isinstance(effect, TorqueSensorEffect):
                predicted = effect.apply_sensor(predicted, batch.motion)
        predicted = batch.filter(predicted)
        for effect in remaining:
            if isinstance(effect, TorqueSensorEffect):
                predicted = effect.apply_sensor(predicted, batch.motion)
        measured_torque = batch.filter(measured.tau)
        for joint in batch.motion.unknown_torque:
            predicted[..., joint, :] = measured_torque[joint]
        return ComparedTorques(measured_torque, predicted, self.compared_rows(batch))

    def compared_rows(self, batch: Batch, row_filter: RowFilter | None = None) -> Mask:
        """Mask of the rows that are compared, shape (nv,).

        Others are those of a joint whose torque is not known, and those of which unknown contact forces leave nothing.

        Parameters
        ----------
        batch
            The samples.
        row_filter
            From `row_filter`; None: that of this equation.
        """
        if self.contacts is not None:
            shares = (row_filter or self.row_filter(batch)).shares
            return np.array([share.any() for share in shares])
        is_compared = np.ones(len(self.joints), dtype=bool)
        is_compared[list(batch.motion.unknown_torque)] = False
        return is_compared

    def _projected_torques(self, batch: Batch, theta: Array, row_filter: RowFilter) -> ComparedTorques:
        """`compared_torques` of a robot with contacts: their difference is what no unknown contact force explains."""
        true = self.true_motion(batch.motion)
        residual = self._identified_torque(true) - self._predicted_by_columns(batch.motion, theta)
        rows_first = np.moveaxis(residual, -2, 0)
        projected_residual = np.moveaxis(row_filter.filter_rows(rows_first), 0, -2)
        measured = batch.filter(true.tau)
        predicted = measured - projected_residual
        return ComparedTorques(measured, predicted, self.compared_rows(batch, row_filter))

    def _undone_sensors(self) -> list[Effect]:
        """Sensors behind which errors are compared: motors that saturate, and what is nearer to the log on a joint.

        The one nearest to the log is the last.
        """
        joints = set()
        undone: list[Effect] = []
        for effect in reversed(self.effects):
            if not isinstance(effect, TorqueSensorEffect):
                continue
            if effect.compares_true_torque:
                joints.add(effect.joint)
            if effect.joint in joints:
                undone.append(effect)
        return undone

    def mechanism(self, model: RobotModel, theta: Array) -> Mechanism:
        """Forward model of the equation.

        Parameters
        ----------
        model
            The tree of bodies.
        theta
            Coefficients, shape (p,).
        """
        mechanism = Mechanism(model)
        for effect, part in self.effect_slices():
            effect.add_to_forward_model(theta[part], mechanism)
        return mechanism


def _joined(indices: Sequence[Indices]) -> Indices:
    """Indices one after the other; none for no array."""
    return np.concatenate([np.zeros(0, dtype=np.intp), *indices])


def _projected_columns_of(effect: Effect, motion: Motion, row_filter: RowFilter) -> Array:
    """Filtered columns of an effect along a true motion in all rows, shape (nv, m, n); kept ones where there are."""

    def evaluate() -> tuple[Array]:
        columns = effect_columns(effect, motion)
        nv, m, n = len(columns), len(effect.coefficients), len(row_filter.batch.t)
        filtered = np.zeros((nv, m, n))
        for rows, together in _columns_by_rows(effect):
            for first in range(0, len(together), _PROJECTED_TOGETHER):
                chosen = together[first : first + _PROJECTED_TOGETHER]
                in_rows = [columns[row][np.searchsorted(effect.active[row], chosen)] for row in rows]
                reached, in_reached = row_filter.filter_columns(rows, np.stack(in_rows))
                filtered[np.ix_(reached, chosen)] = in_reached
        return (filtered,)

    kept = kept_columns_of(effect, motion)
    if kept is None or row_filter.key is None:
        return evaluate()[0]
    (filtered,) = kept.get((row_filter.key, effect.column_key), evaluate)
    return filtered


def _columns_by_rows(effect: Effect) -> Iterator[tuple[Indices, Indices]]:
    """Rows of some joints, and the columns of an effect that appear in exactly these; so all its columns, in groups."""
    appears = np.zeros((len(effect.active), len(effect.coefficients)), dtype=bool)
    for row, active in zip(appears, effect.active, strict=True):
        row[active] = True
    patterns, pattern_of_column = np.unique(appears, axis=1, return_inverse=True)
    for i, pattern in enumerate(patterns.T):
        if not pattern.any():  # a column that appears in no row
            continue
        yield np.flatnonzero(pattern), np.flatnonzero(pattern_of_column.ravel() == i)


def _torque(effect: Effect, theta: Array, motion: Motion) -> Array:
    """Torque of an effect with its coefficients, shape (m,), along a true motion, shape (nv, N); kept if it can be."""
    if isinstance(effect, RigidBodies):
        kept = kept_columns_of(effect, motion)
        if kept is None:
            return effect.torque(theta, motion)
        (torque,) = kept.get(("torque", effect.column_key, theta.tobytes()), lambda: (effect.torque(theta, motion),))
        return torque
    columns = kept_effect_columns(effect, motion)
    return np.stack([theta[active] @ own for active, own in zip(effect.active, columns, strict=True)])


def _filtered_columns(effect: Effect, motion: Motion, batch: Batch) -> Sequence[Array]:
    """Filtered columns of an effect along a true motion, per joint; kept ones where there are."""

    def evaluate() -> list[Array]:
        filtered = effect.empty_columns(len(batch.t))
        effect.filtered_columns(motion, batch.filter, filtered)
        return filtered

    kept = kept_columns_of(effect, motion)
    return evaluate() if kept is None else kept.get(("filtered", effect.column_key), evaluate)
