"""Mistakes in a log's channels: signs, order and units that a driver or a logger may have got wrong.

Each changes the channels as if it were undone. Letters as in `channel_fit`.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from idtool.common.arrays import Array
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.data.inspection import FaultKind
from idtool.data.signals import Motion
from idtool.diagnosis.data_faults.channel_fit import Change
from idtool.robot.urdf.reading import Joint

_FEW = 4  # joints of which any may be turned at once
_EXCESS = 1.5  # log10 of a torque over what the URDF says, from which it may be a thousandfold


@dataclass(frozen=True)
class Mistake:
    """A mistake that may have been made.

    Attributes
    ----------
    fault
        Its kind.
    details
        Per joint that it concerns, what is wrong and what to do.
    joints
        Indices of these joints.
    T
        Torques with the mistake undone from those that were logged, shape (nv, nv).
    position
        Position and its derivatives with the mistake undone; None: they are as they were logged.
    others
        Mistakes that the data can't tell from it.
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
            Names of joints whose torque is the controller's, from the command.
        """
        shares = f"put right, bodies that can be leave {after:.1%} of the torque's power unexplained, else "
        shares += f"{before:.1%}" if before < 1 else "all of it"
        alternatives = [f"{names[other.joints[0]]}: {other.details[0][0]}" for other in self.others]
        or_else = f"; the data can't tell it from {join_names(alternatives)}" if alternatives else ""
        for joint, (defect, advice) in zip(self.joints, self.details, strict=True):
            if names[joint] in computed:
                advice = "its tau is computed, so check q, v, qcmd and the gains of the `controller`"
            yield Notice(self.fault, "problem", names[joint], f"{defect} ({shares}{or_else})", advice)


def possible_mistakes(
    group: Sequence[int], joints: Sequence[Joint], turned: set[int], outside: set[int], excess: Array
) -> list[Mistake]:
    """Mistakes in the channels of joints that share bodies, those to be preferred first where two do as well.

    Parameters
    ----------
    group
        Indices of the joints.
    joints
        All joints.
    turned
        Joints whose v runs against their q.
    outside
        Joints whose q goes far beyond their limits.
    excess
        log10 of the size of each torque over what the URDF's bodies take, shape (nv,).
    """
    names = [joint.name for joint in joints]
    nv = len(joints)
    pairs = list(itertools.combinations(group, 2))
    suspects = list(reversed(_subsets(sorted(outside & set(group)))))  # more before fewer: units are mostly common
    suspects[1:1] = [tuple(group)] if suspects and len(suspects[0]) < len(group) else []
    mistakes = [_position_unit(which, joints) for which in suspects]
    mistakes += [_turned_position(j, nv) for j in group if j in turned]
    mistakes += [_turned_torque(which, nv) for which in _subsets(group)]
    mistakes += [torque_order(_swap(nv, i, k), names) for i, k in pairs]
    mistakes += [_turned_position(j, nv) for j in group if j not in turned]
    mistakes += [_turned_joint(j, nv) for j in group]
    mistakes += [_joint_order(_swap(nv, i, k), names) for i, k in pairs]
    if len(group) > 1:
        for j in group:
            if abs(excess[j]) > _EXCESS:
                mistakes.append(_torque_unit(j, 10 ** (-3 * np.sign(excess[j])), nv))
    return mistakes


def torque_order(order: Sequence[int], names: Sequence[str]) -> Mistake:
    """Torques that stand in another order.

    Parameters
    ----------
    order
        For each joint, at which joint its torque was logged.
    names
        Of all joints.
    """
    which = tuple(j for j, k in enumerate(order) if j != k)
    details = tuple((f"its torque stands under {names[order[j]]}", "put the order of tau right") for j in which)
    return Mistake("wrong_joint_order", details, which, np.eye(len(names))[list(order)])


def _turned_torque(which: tuple[int, ...], nv: int) -> Mistake:
    detail = "tau has the opposite sign of the torque that moves the joint", "set its `log.scale` to -1"
    return Mistake("wrong_sign", (detail,) * len(which), which, _diagonal(which, -1.0, nv))


def _turned_position(j: int, nv: int) -> Mistake:
    detail = "q runs against the direction in which tau acts", "set its `log.scale` to -1"
    return Mistake("wrong_sign", (detail,), (j,), np.eye(nv), _scaled((j,), -1.0))


def _turned_joint(j: int, nv: int) -> Mistake:
    detail = (
        "q, v and tau all run against the joint's axis in the URDF",
        "set their `log.scale` to -1, or turn the axis",
    )
    return Mistake("wrong_sign", (detail,), (j,), _diagonal((j,), -1.0, nv), _scaled((j,), -1.0))


def _position_unit(which: tuple[int, ...], joints: Sequence[Joint]) -> Mistake:
    details, factors = [], []
    for j in which:
        unit, factor = ("mm", 1e-3) if joints[j].kind == "prismatic" else ("degrees", np.pi / 180)
        details.append((f"q is in {unit}", f"set its `log.scale` to {factor:.6g}"))
        factors.append(factor)
    return Mistake("wrong_unit", tuple(details), which, np.eye(len(joints)), _scaled(which, np.array(factors)))


def _torque_unit(j: int, factor: float, nv: int) -> Mistake:
    unit = "thousandths" if factor < 1 else "thousands"
    detail = f"tau is in {unit} of the unit of the other joints'", f"set its `log.scale` to {factor:g}"
    return Mistake("wrong_unit", (detail,), (j,), _diagonal((j,), factor, nv))


def _joint_order(order: Sequence[int], names: Sequence[str]) -> Mistake:
    rows = list(order)
    of_torques = torque_order(order, names)
    details = []
    for j in of_torques.joints:
        details.append((f"q, v and tau of it stand under {names[order[j]]}", "put the names right"))

    def change(motion: Motion) -> Motion:
        q, v, a, still = motion.q[rows], motion.v[rows], motion.a[rows], motion.velocity_deadband[rows]
        return replace(motion, q=q, v=v, a=a, velocity_deadband=still)

    return replace(of_torques, details=tuple(details), position=change)


def _subsets(group: Sequence[int]) -> list[tuple[int, ...]]:
    """Small ones first: all of a few joints, of many only those of one, two or all."""
    sizes = range(1, len(group) + 1) if len(group) <= _FEW else (1, 2, len(group))
    return [which for size in sizes for which in itertools.combinations(group, size)]


def _swap(nv: int, i: int, k: int) -> list[int]:
    order = list(range(nv))
    order[i], order[k] = k, i
    return order


def _diagonal(which: tuple[int, ...], factor: float, nv: int) -> Array:
    T = np.eye(nv)
    T[which, which] = factor
    return T


def _scaled(which: tuple[int, ...], factor: float | Array) -> Change:
    """Positions of some joints times a factor."""

    def change(motion: Motion) -> Motion:
        scale = np.ones((len(motion.q), 1))
        scale[list(which), 0] = factor
        still = motion.velocity_deadband * np.abs(scale[:, 0])
        return replace(motion, q=motion.q * scale, v=motion.v * scale, a=motion.a * scale, velocity_deadband=still)

    return change
