"""Mistakes in a log's channels: signs, order and units that a driver or a logger may have got wrong.

Each comes with the change of the channels that undoes it. Letters as in `channel_fit`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import field, replace

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.data.inspection import FaultKind
from idtool.data.inspection.velocity_findings import is_another_unit
from idtool.data.signals import Motion
from idtool.diagnosis.data_faults.channel_fit import Change
from idtool.robot.urdf.reading import UrdfJoint

_MAX_JOINTS = 4  # of a group, up to which all subsets are tried


@dataclass(frozen=True)
class Mistake:
    """A mistake that may have been made.

    Attributes
    ----------
    kind
        Its kind.
    details
        Message and advice for each joint that it concerns.
    joints
        Indices of these joints.
    T
        Matrix of the corrected torques from the logged ones, shape (nv, nv).
    position
        Correction of the position and its derivatives; None: they are right.
    position_factors
        By joint, what its position is multiplied by, if that is the correction.
    others
        Mistakes that the data can't distinguish from it.
    """

    kind: FaultKind
    details: tuple[tuple[str, str], ...]
    joints: tuple[int, ...]
    T: Array
    position: Change | None = None
    position_factors: Mapping[int, float] = field(default_factory=dict)
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
        alternatives = "; or ".join(other.summary(names) for other in self.others)
        or_else = f"; the data cannot distinguish this fault from {alternatives}" if alternatives else ""
        for joint, (defect, advice) in zip(self.joints, self.details, strict=True):
            if names[joint] in computed:
                advice = "its tau is computed, so check q, v, qcmd and the gains of the `controller`"
            yield Notice(self.kind, "problem", names[joint], f"{defect} ({shares}{or_else})", advice)

    def summary(self, names: Sequence[str]) -> str:
        """The joints, and what is wrong with them."""
        messages = [message for message, _ in self.details]
        if len(set(messages)) == 1:
            return f"{join_names([names[j] for j in self.joints])}: {messages[0]}"
        return ", ".join(f"{names[j]}: {message}" for j, message in zip(self.joints, messages, strict=True))


@dataclass(frozen=True)
class Evidence:
    """Signs of wrong channels that are seen without a model of the bodies, by index of the joint.

    Attributes
    ----------
    velocity_gains
        Gain of v over dq/dt, of joints whose v was logged; NaN where the two do not agree otherwise.
    out_of_range
        Joints whose q goes far beyond their limits.
    torque_factors
        Corrections of torques that are about a thousand times those of the URDF's bodies, or a thousandth: 1e-3 or 1e3.
    """

    velocity_gains: Mapping[int, float]
    out_of_range: set[int]
    torque_factors: Mapping[int, float]

    @property
    def inverted(self) -> set[int]:
        """Joints whose v has the opposite sign of dq/dt."""
        return {j for j, gain in self.velocity_gains.items() if gain < 0}


@dataclass(frozen=True)
class Suspects:
    """Joints in which mistakes are looked for, by index.

    Attributes
    ----------
    joints
        All joints that share bodies, which may have the same mistake.
    singles
        Joints that may be the only one with a mistake.
    pairs
        Pairs that may both be inverted, or stand under each other's names.
    """

    joints: tuple[int, ...]
    singles: tuple[int, ...]
    pairs: tuple[tuple[int, int], ...]

    def subsets(self) -> list[tuple[int, ...]]:
        """Joints that may have the same mistake, small subsets first: of few joints, all subsets."""
        if len(self.joints) > _MAX_JOINTS:
            return [*((j,) for j in self.singles), *self.pairs, self.joints]
        subsets: list[tuple[int, ...]] = []
        for size in range(1, len(self.joints) + 1):
            subsets += itertools.combinations(self.joints, size)
        return subsets

    def among(self, joints: set[int]) -> Suspects:
        """The suspects among some joints."""
        return Suspects(
            tuple(j for j in self.joints if j in joints),
            tuple(j for j in self.singles if j in joints),
            tuple(pair for pair in self.pairs if joints.issuperset(pair)),
        )


@dataclass(frozen=True)
class LogScale:
    """Factors of ``log.scale``, by which the channels were multiplied when they were read.

    Attributes
    ----------
    factors
        By signal, for all joints or by joint; 1 where there is none.
    """

    factors: Mapping[str, Mapping[str, float] | float]

    def advice(self, joint: str, corrections: Mapping[str, float]) -> str:
        """Advice to multiply channels of a joint by further factors, given by signal."""
        signals_by_setting: dict[str, list[str]] = {}
        for signal, correction in corrections.items():
            setting = self._setting(signal, joint, correction)
            signals_by_setting.setdefault(setting, []).append(signal)
        settings = [f"of {_listed(signals)} to {setting}" for setting, signals in signals_by_setting.items()]
        return f"set the `log.scale` {' and '.join(settings)}"

    def _setting(self, signal: str, joint: str, correction: float) -> str:
        """New scale of a signal as text, with the unchanged one of the other joints where they share one."""
        factors = self.factors.get(signal, {})
        if isinstance(factors, Mapping):
            return short_number(correction * factors.get(joint, 1.0), 6)
        of_joint = short_number(correction * factors, 6)
        of_others = short_number(factors, 6)
        return f"{of_joint} for {joint} and {of_others} for the other joints"


@dataclass(frozen=True)
class PossibleMistakes:
    """Mistakes that may have been made in the channels of a robot's joints.

    Attributes
    ----------
    joints
        The nv joints.
    evidence
        What the channels show without a model of the bodies.
    log_scale
        How the channels were scaled.
    """

    joints: Sequence[UrdfJoint]
    evidence: Evidence
    log_scale: LogScale

    def of(self, suspects: Suspects) -> list[Mistake]:
        """Mistakes of suspects, the more likely ones first."""
        names = [joint.name for joint in self.joints]
        nv = len(names)
        inverted = [j for j in suspects.singles if j in self.evidence.inverted]
        not_inverted = [j for j in suspects.singles if j not in self.evidence.inverted]
        mistakes = [self._position_unit(subset) for subset in self._subsets_of_wrong_unit(suspects)]
        mistakes += [self._inverted_position(j) for j in inverted]
        mistakes += [self._inverted_torque(subset) for subset in suspects.subsets()]
        mistakes += [torque_order(_swap(nv, i, k), names) for i, k in suspects.pairs]
        mistakes += [self._inverted_position(j) for j in not_inverted]
        mistakes += [self._inverted_joint(j) for j in suspects.singles]
        mistakes += [_joint_order(_swap(nv, i, k), names) for i, k in suspects.pairs]
        if len(suspects.joints) > 1:
            mistakes += [self._torque_unit(j) for j in suspects.singles if j in self.evidence.torque_factors]
        return mistakes

    def _subsets_of_wrong_unit(self, suspects: Suspects) -> list[tuple[int, ...]]:
        """Joints whose positions may be in a wrong unit, larger subsets first: joints mostly have one unit."""
        possible = suspects.among(self.evidence.out_of_range)
        subsets = list(reversed(possible.subsets()))
        if subsets and len(possible.joints) < len(suspects.joints):
            subsets.insert(1, suspects.joints)
        return subsets

    def _inverted_torque(self, subset: tuple[int, ...]) -> Mistake:
        message = "tau has the opposite sign of the torque that moves the joint"
        details = tuple((message, self._scale_advice(j, {"tau": -1.0})) for j in subset)
        return Mistake("wrong_sign", details, subset, self._torque_factor(subset, -1.0))

    def _inverted_position(self, j: int) -> Mistake:
        message = "q has the opposite sign of the motion that tau causes"
        advice = self._motion_advice(j, self._motion_corrections(j, -1.0))
        return self._scaled_positions("wrong_sign", [(message, advice)], {j: -1.0}, np.eye(len(self.joints)))

    def _inverted_joint(self, j: int) -> Mistake:
        corrections = {**self._motion_corrections(j, -1.0), "tau": -1.0}
        message = f"{_listed(list(corrections))} have the opposite sign of the joint's axis in the URDF"
        advice = self._motion_advice(j, corrections)
        is_v_alike = "v" in corrections or j not in self.evidence.velocity_gains
        if is_v_alike and set(corrections.values()) == {-1.0}:
            advice = f"reverse the axis, or {advice}"
        return self._scaled_positions("wrong_sign", [(message, advice)], {j: -1.0}, self._torque_factor((j,), -1.0))

    def _position_unit(self, subset: tuple[int, ...]) -> Mistake:
        details = []
        factors = {}
        for j in subset:
            unit, factors[j] = ("mm", 1e-3) if self.joints[j].kind == "prismatic" else ("degrees", np.pi / 180)
            details.append((f"q is in {unit}", self._motion_advice(j, self._motion_corrections(j, factors[j]))))
        return self._scaled_positions("wrong_unit", details, factors, np.eye(len(self.joints)))

    def _torque_unit(self, j: int) -> Mistake:
        factor = self.evidence.torque_factors[j]
        unit = "thousandths" if factor < 1 else "thousands"
        detail = f"tau is in {unit} of the other joints' unit", self._scale_advice(j, {"tau": factor})
        return Mistake("wrong_unit", (detail,), (j,), self._torque_factor((j,), factor))

    def _scaled_positions(
        self, kind: FaultKind, details: Sequence[tuple[str, str]], factors: Mapping[int, float], T: Array
    ) -> Mistake:
        """Mistake that is undone by multiplying the positions of some joints by factors, and the torques by T."""
        return Mistake(kind, tuple(details), tuple(factors), T, _scaling(factors), factors)

    def _torque_factor(self, joints: tuple[int, ...], factor: float) -> Array:
        """Matrix T that multiplies the torques of some joints by a factor."""
        T = np.eye(len(self.joints))
        T[joints, joints] = factor
        return T

    def _motion_corrections(self, j: int, position_factor: float) -> dict[str, float]:
        """Factors of q and, if v is wrong with that, of v."""
        corrections = {"q": position_factor}
        gain = self.evidence.velocity_gains.get(j, math.nan)
        if math.isfinite(gain):
            factor = velocity_factor(gain, position_factor)
            if factor != 1:
                corrections["v"] = factor
        return corrections

    def _motion_advice(self, j: int, corrections: Mapping[str, float]) -> str:
        """As in `_scale_advice`; where v does not agree with q, with the advice to look at it."""
        advice = self._scale_advice(j, corrections)
        if math.isnan(self.evidence.velocity_gains.get(j, 1.0)):
            advice += "; then compare v, which may be wrong in the same way, with the derivative of q"
        return advice

    def _scale_advice(self, j: int, corrections: Mapping[str, float]) -> str:
        return self.log_scale.advice(self.joints[j].name, corrections)


def _listed(signals: Sequence[str]) -> str:
    """Signals as in a sentence."""
    *first, last = signals
    return f"{', '.join(first)} and {last}" if first else last


def velocity_factor(gain: float, position_factor: float = 1.0) -> float:
    """Factor that makes v the derivative of the corrected q: ±1, or that of q, or as measured if v has its own unit.

    Parameters
    ----------
    gain
        Gain of v over dq/dt, both as logged.
    position_factor
        Factor that q is to be multiplied by.
    """
    factor = position_factor / gain
    if not is_another_unit(factor):  # only the sign of v may be wrong
        return math.copysign(1.0, factor)
    if not is_another_unit(gain):  # v is in the unit of q
        return math.copysign(position_factor, factor)
    return float(f"{factor:.4g}")  # the gain is measured


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


def _joint_order(order: Sequence[int], names: Sequence[str]) -> Mistake:
    rows = list(order)
    torques = torque_order(order, names)
    details = []
    for j in torques.joints:
        details.append((f"its q, v and tau are recorded under {names[order[j]]}", "correct the names"))

    def exchange(motion: Motion) -> Motion:
        return replace(
            motion,
            q=motion.q[rows],
            v=motion.v[rows],
            a=motion.a[rows],
            velocity_deadband=motion.velocity_deadband[rows],
        )

    return replace(torques, details=tuple(details), position=exchange)


def _swap(nv: int, i: int, k: int) -> list[int]:
    order = list(range(nv))
    order[i], order[k] = k, i
    return order


def _scaling(factors: Mapping[int, float]) -> Change:
    """Change that multiplies the positions of some joints by factors."""

    def scale(motion: Motion) -> Motion:
        by_joint = np.ones((len(motion.q), 1))
        by_joint[list(factors), 0] = list(factors.values())
        return replace(
            motion,
            q=motion.q * by_joint,
            v=motion.v * by_joint,
            a=motion.a * by_joint,
            velocity_deadband=motion.velocity_deadband * np.abs(by_joint[:, 0]),
        )

    return scale
