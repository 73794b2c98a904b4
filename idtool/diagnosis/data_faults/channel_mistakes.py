"""Mistakes in a log's channels: signs, order and units that a driver or a logger may have got wrong.

Each comes with the change of the channels that undoes it. Letters as in `channel_fit`.
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
from idtool.robot.urdf.reading import UrdfJoint

_MAX_JOINTS = 4  # of a group, up to which all subsets are tried
_MIN_EXCESS = 1.5  # log10 of a torque over the URDF's, from which it may be a thousandfold


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


def possible_mistakes(
    group: Sequence[int],
    suspects: Sequence[int],
    exchanged: Sequence[int],
    joints: Sequence[UrdfJoint],
    inverted: set[int],
    out_of_range: set[int],
    excess: Array,
) -> list[Mistake]:
    """Mistakes in the channels of joints that share bodies, the more likely ones first.

    Parameters
    ----------
    group
        Indices of the joints.
    suspects
        Those of them whose channels may be wrong, if not those of all are.
    exchanged
        Those of them of which two may be wrong, or stand under each other's names.
    joints
        All joints.
    inverted
        Joints whose v has the opposite sign of dq/dt.
    out_of_range
        Joints whose q goes far beyond their limits.
    excess
        log10 of the rms of each torque over that of the URDF's bodies, shape (nv,).
    """
    names = [joint.name for joint in joints]
    nv = len(joints)
    pairs = list(itertools.combinations(exchanged, 2))
    with_wrong_unit = _subsets_of_wrong_unit(group, suspects, pairs, out_of_range)
    mistakes = [_position_unit(subset, joints) for subset in with_wrong_unit]
    mistakes += [_inverted_position(j, nv) for j in suspects if j in inverted]
    mistakes += [_inverted_torque(subset, nv) for subset in _subsets(group, suspects, pairs)]
    mistakes += [torque_order(_swap(nv, i, k), names) for i, k in pairs]
    mistakes += [_inverted_position(j, nv) for j in suspects if j not in inverted]
    mistakes += [_inverted_joint(j, nv) for j in suspects]
    mistakes += [_joint_order(_swap(nv, i, k), names) for i, k in pairs]
    if len(group) > 1:
        for j in suspects:
            if abs(excess[j]) > _MIN_EXCESS:
                mistakes.append(_torque_unit(j, 10 ** (-3 * np.sign(excess[j])), nv))
    return mistakes


def _subsets_of_wrong_unit(
    group: Sequence[int], suspects: Sequence[int], pairs: Sequence[tuple[int, int]], out_of_range: set[int]
) -> list[tuple[int, ...]]:
    """Joints whose positions may be in a wrong unit, larger subsets first: joints mostly have one unit."""
    possible = [j for j in group if j in out_of_range]
    possible_suspects = [j for j in suspects if j in out_of_range]
    possible_pairs = [pair for pair in pairs if out_of_range.issuperset(pair)]
    subsets = list(reversed(_subsets(possible, possible_suspects, possible_pairs)))
    if subsets and len(possible) < len(group):
        subsets.insert(1, tuple(group))
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


def _subsets(group: Sequence[int], suspects: Sequence[int], pairs: Sequence[tuple[int, int]]) -> list[tuple[int, ...]]:
    """Subsets, small ones first: all of a few joints; of many, single suspects, the given pairs and the whole."""
    if len(group) <= _MAX_JOINTS:
        return [subset for size in range(1, len(group) + 1) for subset in itertools.combinations(group, size)]
    return [*itertools.combinations(suspects, 1), *pairs, tuple(group)]


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
