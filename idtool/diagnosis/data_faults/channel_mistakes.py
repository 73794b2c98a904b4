"""Mistakes in a log's channels: signs, order and units that a driver or a logger may have got wrong.

Each comes with the change of the channels that undoes it. Letters as in `channel_fit`.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from idtool.common.arrays import Array
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.data.inspection import FaultKind
from idtool.data.signals import Motion
from idtool.diagnosis.data_faults.channel_fit import Change
from idtool.robot.urdf.reading import UrdfJoint

_MAX_JOINTS = 4  # of a group, up to which all subsets are tried


@dataclass(frozen=True)
class Mistake:
    """A mistake that may have been made.

    Attributes
    ----------
    fault
        Its kind.
    details
        Message and advice for each joint that it concerns.
    joints
        Indices of these joints.
    T
        Matrix of the corrected torques from the logged ones, shape (nv, nv).
    position
        Correction of the position and its derivatives; None: they are right.
    others
        Mistakes that the data can't distinguish from it.
    """

    fault: FaultKind
    details: tuple[tuple[str, str], ...]
    joints: tuple[int, ...]
    T: Array
    position: Change | None = None
    others: tuple[Mistake, ...] = ()

    def faults(self, names: Sequence[str], before: float, after: float, computed: Set[str]) -> Iterator[Notice]:
        """The mistake as faults, one a joint.

        Parameters
        ----------
        names
            Of all joints.
        before, after
            Share of the torque that is unexplained with the mistake and without.
        computed
            Names of joints whose torque is computed from the command.
        """
        shares = (
            f"the best realizable model leaves {100 * after:.1f} % of the mean square torque unexplained with this "
            "correction, and "
        )
        shares += f"{100 * before:.1f} % without it" if before < 1 else "all of it without"
        alternatives = [f"{names[other.joints[0]]}: {other.details[0][0]}" for other in self.others]
        or_else = f"; the data cannot distinguish this fault from {join_names(alternatives)}" if alternatives else ""
        for joint, (defect, advice) in zip(self.joints, self.details, strict=True):
            if names[joint] in computed:
                advice = "its tau is computed, so check q, v, qcmd and the gains of the `controller`"
            yield Notice(self.fault, "problem", names[joint], f"{defect} ({shares}{or_else})", advice)


@dataclass(frozen=True)
class Evidence:
    """Joints whose channels look wrong by themselves.

    Attributes
    ----------
    inverted
        Those whose v has the opposite sign of dq/dt.
    out_of_range
        Those whose q goes far beyond their limits.
    torque_factors
        Those whose torque is about a thousand times that of the URDF's bodies, or a thousandth; and what it would then
        have to be multiplied by.
    """

    inverted: set[int]
    out_of_range: set[int]
    torque_factors: Mapping[int, float]

    @property
    def joints(self) -> set[int]:
        """All of them."""
        return self.inverted | self.out_of_range | set(self.torque_factors)


@dataclass(frozen=True)
class Suspects:
    """Joints of a group in which mistakes are looked for, by index.

    Attributes
    ----------
    group
        All joints of the group.
    single
        Joints that may be the only one with a mistake.
    pairs
        Pairs that may both be inverted, or stand under each other's names.
    """

    group: tuple[int, ...]
    single: tuple[int, ...]
    pairs: tuple[tuple[int, int], ...]

    def subsets(self) -> list[tuple[int, ...]]:
        """Joints that may have the same mistake, small subsets first: of few joints, all subsets."""
        if len(self.group) > _MAX_JOINTS:
            return [*((j,) for j in self.single), *self.pairs, self.group]
        subsets: list[tuple[int, ...]] = []
        for size in range(1, len(self.group) + 1):
            subsets += itertools.combinations(self.group, size)
        return subsets

    def among(self, joints: set[int]) -> Suspects:
        """The suspects among some joints."""
        return Suspects(
            tuple(j for j in self.group if j in joints),
            tuple(j for j in self.single if j in joints),
            tuple(pair for pair in self.pairs if joints.issuperset(pair)),
        )


def possible_mistakes(suspects: Suspects, joints: Sequence[UrdfJoint], evidence: Evidence) -> list[Mistake]:
    """Mistakes in the channels of joints that share bodies, the more likely ones first.

    Parameters
    ----------
    suspects
        The joints that share bodies.
    joints
        All joints.
    evidence
        What the channels show without a model of the bodies.
    """
    names = [joint.name for joint in joints]
    nv = len(joints)
    inverted = [j for j in suspects.single if j in evidence.inverted]
    not_inverted = [j for j in suspects.single if j not in evidence.inverted]
    with_wrong_unit = _subsets_of_wrong_unit(suspects, evidence.out_of_range)
    mistakes = [_position_unit(subset, joints) for subset in with_wrong_unit]
    mistakes += [_inverted_position(j, nv) for j in inverted]
    mistakes += [_inverted_torque(subset, nv) for subset in suspects.subsets()]
    mistakes += [torque_order(_swap(nv, i, k), names) for i, k in suspects.pairs]
    mistakes += [_inverted_position(j, nv) for j in not_inverted]
    mistakes += [_inverted_joint(j, nv) for j in suspects.single]
    mistakes += [_joint_order(_swap(nv, i, k), names) for i, k in suspects.pairs]
    if len(suspects.group) > 1:
        for j in suspects.single:
            if j in evidence.torque_factors:
                mistakes.append(_torque_unit(j, evidence.torque_factors[j], nv))
    return mistakes


def _subsets_of_wrong_unit(suspects: Suspects, out_of_range: set[int]) -> list[tuple[int, ...]]:
    """Joints whose positions may be in a wrong unit, larger subsets first: joints mostly have one unit."""
    possible = suspects.among(out_of_range)
    subsets = list(reversed(possible.subsets()))
    if subsets and len(possible.group) < len(suspects.group):
        subsets.insert(1, suspects.group)
    return subsets


def torque_order(order: Sequence[int], names: Sequence[str]) -> Mistake:
    """Mistake of torques in another order.

    Parameters
    ----------
    order
        For each joint, at which joint its torque was logged.
    names
        Of all joints.
    """
    moved = tuple(j for j, k in enumerate(order) if j != k)
    details = tuple((f"its torque is recorded under {names[order[j]]}", "correct the order of tau") for j in moved)
    return Mistake("wrong_joint_order", details, moved, np.eye(len(names))[list(order)])


def _inverted_torque(subset: tuple[int, ...], nv: int) -> Mistake:
    detail = "tau has the opposite sign of the torque that moves the joint", "set its `log.scale` to -1"
    return Mistake("wrong_sign", (detail,) * len(subset), subset, _diagonal(subset, -1.0, nv))


def _inverted_position(j: int, nv: int) -> Mistake:
    detail = "q has the opposite sign of the motion that tau causes", "set its `log.scale` to -1"
    return Mistake("wrong_sign", (detail,), (j,), np.eye(nv), _scaled((j,), -1.0))


def _inverted_joint(j: int, nv: int) -> Mistake:
    detail = (
        "q, v and tau all have the opposite sign of the joint's axis in the URDF",
        "set their `log.scale` to -1, or reverse the axis",
    )
    return Mistake("wrong_sign", (detail,), (j,), _diagonal((j,), -1.0, nv), _scaled((j,), -1.0))


def _position_unit(subset: tuple[int, ...], joints: Sequence[UrdfJoint]) -> Mistake:
    details, factors = [], []
    for j in subset:
        unit, factor = ("mm", 1e-3) if joints[j].kind == "prismatic" else ("degrees", np.pi / 180)
        details.append((f"q is in {unit}", f"set its `log.scale` to {factor:.6g}"))
        factors.append(factor)
    return Mistake("wrong_unit", tuple(details), subset, np.eye(len(joints)), _scaled(subset, np.array(factors)))


def _torque_unit(j: int, factor: float, nv: int) -> Mistake:
    unit = "thousandths" if factor < 1 else "thousands"
    detail = f"tau is in {unit} of the other joints' unit", f"set its `log.scale` to {factor:g}"
    return Mistake("wrong_unit", (detail,), (j,), _diagonal((j,), factor, nv))


def _joint_order(order: Sequence[int], names: Sequence[str]) -> Mistake:
    rows = list(order)
    torques = torque_order(order, names)
    details = []
    for j in torques.joints:
        details.append((f"its q, v and tau are recorded under {names[order[j]]}", "correct the names"))

    def change(motion: Motion) -> Motion:
        return replace(
            motion,
            q=motion.q[rows],
            v=motion.v[rows],
            a=motion.a[rows],
            velocity_deadband=motion.velocity_deadband[rows],
        )

    return replace(torques, details=tuple(details), position=change)


def _swap(nv: int, i: int, k: int) -> list[int]:
    order = list(range(nv))
    order[i], order[k] = k, i
    return order


def _diagonal(joints: tuple[int, ...], factor: float, nv: int) -> Array:
    T = np.eye(nv)
    T[joints, joints] = factor
    return T


def _scaled(joints: tuple[int, ...], factor: float | Array) -> Change:
    """Change that multiplies the positions of some joints by a factor."""

    def change(motion: Motion) -> Motion:
        scale = np.ones((len(motion.q), 1))
        scale[list(joints), 0] = factor
        return replace(
            motion,
            q=motion.q * scale,
            v=motion.v * scale,
            a=motion.a * scale,
            velocity_deadband=motion.velocity_deadband * np.abs(scale[:, 0]),
        )

    return change
