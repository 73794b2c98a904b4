"""What a log's channels may be taken for: signs, order and units that would make sense of the torque.

Each trial changes the channels as if one mistake of a driver or a logger were undone. Letters as in `fault_fit`.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from idtool.diagnosis.fault_fit import Change
from idtool.diagnosis.fault_record import Fault
from idtool.names import some
from idtool.robot import Joint
from idtool.signals import Motion

Array = NDArray[np.float64]

_POSITION, _ALL = ("q", "v", "a"), ("q", "v", "a", "tau")
_EXCESS = 1.5  # log10 of a torque over what the URDF says, from which it may be a thousandfold


@dataclass(frozen=True)
class Trial:
    """A mistake that may have been made.

    Attributes
    ----------
    fault
        What it would be.
    what
        Per joint that it concerns, what it is and what to do, one sentence of two parts.
    joints
        Indices of these joints.
    change
        The channels with the mistake undone.
    """

    fault: str
    what: tuple[tuple[str, str], ...]
    joints: tuple[int, ...]
    change: Change
    others: tuple[Trial, ...] = ()

    def faults(self, names: Sequence[str], before: float, after: float) -> Iterator[Fault]:
        """The mistake as faults, one a joint.

        Parameters
        ----------
        names
            Of all joints.
        before, after
            Share of the torque that is unexplained with the mistake and without.
        """
        shares = f"put right, bodies that can be leave {after:.1%} of the torque's power unexplained, else "
        shares += f"{before:.1%}" if before < 1 else "all of it"
        for joint, (what, do) in zip(self.joints, self.what, strict=True):
            also = [f"{names[other.joints[0]]}: {other.what[0][0]}" for other in self.others]
            or_else = f"; the data can't tell it from {some(also)}" if also else ""
            yield Fault(self.fault, names[joint], f"{what} ({shares}{or_else}): {do}")


def trials(
    group: Sequence[int], joints: Sequence[Joint], turned: set[int], outside: set[int], excess: Array
) -> list[Trial]:
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
    found = [_turned_position(j) for j in group if j in turned]
    found += [_position_unit(tuple(sorted(outside & set(group))), joints)] if outside & set(group) else []
    found += [_position_unit((j,), joints) for j in group if j in outside and len(outside & set(group)) > 1]
    found += [_turned_torque((j,)) for j in group]
    found += [_turned_torque(tuple(group))] if len(group) > 1 else []
    found += [_torque_order(_swap(len(joints), i, k), names) for i, k in itertools.combinations(group, 2)]
    found += [_turned_position(j) for j in group if j not in turned]
    found += [_turned_joint(j) for j in group]
    found += [_joint_order(_swap(len(joints), i, k), names) for i, k in itertools.combinations(group, 2)]
    if len(group) > 1:
        found += [_torque_unit(j, 10 ** (-3 * np.sign(excess[j]))) for j in group if abs(excess[j]) > _EXCESS]
    return found


def torque_order(order: Sequence[int], names: Sequence[str]) -> Trial:
    """Torques that stand in another order.

    Parameters
    ----------
    order
        For each joint, at which joint its torque was logged.
    names
        Of all joints.
    """
    return _torque_order(order, names)


def _turned_torque(which: tuple[int, ...]) -> Trial:
    what = "tau has the opposite sign of the torque that moves the joint", "set its `log.scale` to -1"
    return Trial("wrong_sign", (what,) * len(which), which, _scaled(which, ("tau",), -1))


def _turned_position(j: int) -> Trial:
    what = "q runs against the direction in which tau acts", "set its `log.scale` to -1"
    return Trial("wrong_sign", (what,), (j,), _scaled((j,), _POSITION, -1))


def _turned_joint(j: int) -> Trial:
    what = "q, v and tau all run against the joint's axis in the URDF", "set their `log.scale` to -1, or turn the axis"
    return Trial("wrong_sign", (what,), (j,), _scaled((j,), _ALL, -1))


def _position_unit(which: tuple[int, ...], joints: Sequence[Joint]) -> Trial:
    what, factors = [], []
    for j in which:
        unit, factor = ("mm", 1e-3) if joints[j].kind == "prismatic" else ("degrees", np.pi / 180)
        what.append((f"q is in {unit}", f"set its `log.scale` to {factor:.6g}"))
        factors.append(factor)
    return Trial("wrong_unit", tuple(what), which, _scaled(which, _POSITION, np.array(factors)))


def _torque_unit(j: int, factor: float) -> Trial:
    unit = "thousandths" if factor < 1 else "thousands"
    what = f"tau is in {unit} of the unit of the other joints'", f"set its `log.scale` to {factor:g}"
    return Trial("wrong_unit", (what,), (j,), _scaled((j,), ("tau",), factor))


def _torque_order(order: Sequence[int], names: Sequence[str]) -> Trial:
    which = tuple(j for j, k in enumerate(order) if j != k)
    what = tuple((f"its torque stands under {names[order[j]]}", "put the order of tau right") for j in which)
    return Trial("wrong_joint_order", what, which, lambda motion: replace(motion, tau=motion.tau[list(order)]))


def _joint_order(order: Sequence[int], names: Sequence[str]) -> Trial:
    which = tuple(j for j, k in enumerate(order) if j != k)
    what = tuple((f"q, v and tau of it stand under {names[order[j]]}", "put the names right") for j in which)
    return Trial("wrong_joint_order", what, which, _reordered(list(order)))


def _swap(nv: int, i: int, k: int) -> list[int]:
    order = list(range(nv))
    order[i], order[k] = k, i
    return order


def _reordered(order: list[int]) -> Change:
    def change(motion: Motion) -> Motion:
        own = {name: getattr(motion, name)[order] for name in (*_ALL, "still")}
        return replace(motion, **own)

    return change


def _scaled(which: tuple[int, ...], signals: tuple[str, ...], factor: float | Array) -> Change:
    """Signals of some joints times a factor."""

    def change(motion: Motion) -> Motion:
        scale = np.ones((len(motion.q), 1))
        scale[list(which), 0] = factor
        own = {name: getattr(motion, name) * scale for name in signals}
        if "v" in signals:
            own["still"] = motion.still * np.abs(scale[:, 0])
        return replace(motion, **own)

    return change


def composed(changes: Sequence[Change]) -> Change:
    """One change after the other."""

    def change(motion: Motion) -> Motion:
        for one in changes:
            motion = one(motion)
        return motion

    return change

