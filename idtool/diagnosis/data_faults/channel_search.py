"""Search for wrong signs, order and units of the channels, by whether realizable bodies explain the torque.

If they explain the torque as logged, there is no fault that matters. If they do not, every mistake of
`channel_mistakes` is undone in turn, in all independent groups of joints at once. One is accepted if it reduces the
unexplained torque manyfold: for a wrong model, a missing effect or noise, an inverted or swapped channel is no help.

Letters as in `channel_fit`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, field, replace
from itertools import zip_longest

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.data.inspection.velocity_findings import is_another_unit
from idtool.data.signals import Motion
from idtool.diagnosis.data_faults.channel_fit import MIN_UNEXPLAINED, Change, ChannelFit
from idtool.diagnosis.data_faults.channel_mistakes import Evidence, Mistake, Suspects, possible_mistakes, torque_order
from idtool.estimation.dataset.experiment import Progress
from idtool.robot.urdf.reading import UrdfJoint

_SUSPICIOUS = 0.005  # u above which mistakes are looked for
_MIN_GAIN = 1.5  # reduction of the sum over the joints of log u; without a mistake none of 200 logs had more than 0.5
_MAX_MEAN_RATIO = 0.35  # of the mean of u, after over before
_MAX_FINAL_MEAN = 0.15  # of u, above which no fault is reported in the end
_EQUAL_GAIN = 0.7  # difference of two gains below which the preferred mistake is taken
_MAX_ROUNDS = 4
_FEW_JOINTS = 7  # of a group, in all of which mistakes are looked for, however long it takes
_FEWEST_SUSPECTS = 2  # joints of a larger group, likewise
_MISTAKES = 3  # about as many as are looked for in each joint and in each pair of joints
_MOST_WORK = (
    3.5e9  # mistakes of a larger group that are undone one by one, times the cube of the number of coefficients
)
_MIN_EXCESS = 1.5  # log10 of a torque over the URDF's, from which it may be a thousandfold
_NO_FIT = 1e9  # u where no fit is found at all
_STAGE = "looking for wrong channels"
_MIN_ORDER_GAIN = 2.0  # as `_MIN_GAIN`, of another order of the torques, with unconstrained coefficients
_FAR_BEYOND = 10.0  # times the URDF's range, that a joint can't cover
_MAX_TRAVEL = 8 * np.pi  # rad of a joint without limits

GroupMistakes = dict[int | None, Mistake]  # by index of the group; None for a mistake in several groups


@dataclass
class ChannelSearch:
    """The search for mistakes.

    Attributes
    ----------
    fit
        The sample of the logs.
    joints
        The nv joints.
    limits
        Least and greatest logged q of each, shape (nv, 2).
    gains
        Gain of v over dq/dt by joint, where the two agree.
    computed
        Names of joints whose torque is computed by the controller's law.
    progress
        Callback for the stage and its progress, from 0 to 1.
    accepted
        Mistakes that were accepted, in turn.
    """

    fit: ChannelFit
    joints: tuple[UrdfJoint, ...]
    limits: Array
    gains: Mapping[str, float]
    computed: Set[str]
    progress: Progress
    accepted: list[Mistake] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.T = np.eye(len(self.joints))
        self._names = [joint.name for joint in self.joints]
        self.position: Change = _as_logged
        self._sample = self.fit.reduced(self.position)
        self._u: Array | None = None  # with the accepted mistakes undone

    def faults(self) -> Iterator[Notice]:
        """All faults of signs, order and units that the motion shows."""
        self.progress(_STAGE, 0.0)
        u = self._sample.unexplained(self.T)
        if u is None and self._out_of_range():  # units may be so wrong that no fit is found
            u = np.full(len(self.joints), _NO_FIT)
        self._u = u
        if u is not None:
            yield from self._mistake_faults(u)
            yield from self._position_faults(u)
        yield from self._velocity_faults()

    def _mistake_faults(self, u: Array) -> Iterator[Notice]:
        """Faults found by undoing one mistake after the other, of groups that are explained in the end."""
        faults: list[tuple[Indices, Notice]] = []
        chosen: GroupMistakes = {}
        order = self._better_torque_order(u)
        if order is not None and self._reduces_unexplained(u, order):
            chosen = {None: order}
        for _ in range(_MAX_ROUNDS):
            chosen = chosen or self._best_mistakes(u)
            after = self._unexplained_without(list(chosen.values())) if chosen else None
            if after is None:
                break
            for g, mistake in chosen.items():
                group = np.array(mistake.joints) if g is None else self.fit.groups[g]
                for fault in mistake.faults(self._names, u[group].mean(), after[group].mean(), self.computed):
                    faults.append((group, fault))
            self._accept(list(chosen.values()))
            u = self._u = after
            chosen = {}
        for group, fault in faults:
            if u[group].mean() < _MAX_FINAL_MEAN:
                yield fault

    def _reduces_unexplained(self, u: Array, mistake: Mistake) -> bool:
        after = self._unexplained_without([mistake])
        return after is not None and _gain(u, after, np.arange(len(u))) > _MIN_GAIN

    def _accept(self, mistakes: list[Mistake]) -> None:
        self.T, self.position = self._with_undone(mistakes)
        self._sample = self.fit.reduced(self.position)
        self.accepted += mistakes

    def _with_undone(self, mistakes: list[Mistake]) -> tuple[Array, Change]:
        """Torques and positions with more mistakes undone."""
        T = self.T
        position = self.position
        for mistake in mistakes:
            T = mistake.T @ T
            if mistake.position is not None:
                position = _composed(position, mistake.position)
        return T, position

    def _unexplained_without(self, mistakes: list[Mistake]) -> Array | None:
        """Shares u with more mistakes undone, shape (nv,); None without a fit, or if other joints hardly move."""
        T, position = self._with_undone(mistakes)
        sample = self._sample if position is self.position else self.fit.reduced(position)
        if not np.array_equal(sample.hardly_moving, self._sample.hardly_moving):
            return None
        return sample.unexplained(T)

    def _best_mistakes(self, u: Array) -> GroupMistakes:
        """The mistake that is best undone next, by group, together with equally good ones."""
        candidates = self._suspected_mistakes(u)
        gains: list[list[float]] = [[] for _ in candidates]
        steps = list(zip_longest(*candidates))  # the k-th mistake of all groups at once
        for k, step in enumerate(steps):
            self.progress(_STAGE, k / len(steps))
            after = self._unexplained_without([mistake for mistake in step if mistake])
            for g, mistake in enumerate(step):
                if mistake:
                    gains[g].append(-np.inf if after is None else _gain(u, after, self.fit.groups[g]))

        best: GroupMistakes = {}
        for g, own_gains in enumerate(gains):
            if not own_gains or max(own_gains) <= _MIN_GAIN:
                continue
            limit = max(own_gains) - _EQUAL_GAIN
            first, *others = (mistake for mistake, x in zip(candidates[g], own_gains, strict=True) if x > limit)
            best[g] = replace(first, others=tuple(others))
        return best

    def _suspected_mistakes(self, u: Array) -> list[list[Mistake]]:
        """Mistakes that may have been made, by group."""
        evidence = self._evidence()
        unusable = {j for j in evidence.out_of_range if self._names[j] in self.computed}
        by_group = []
        for group in self.fit.groups:
            mistakes: list[Mistake] = []
            if max(u[group]) > _SUSPICIOUS:
                mistakes = possible_mistakes(self._suspects(u, group, evidence), self.joints, evidence)
            if max(u) == _NO_FIT:
                mistakes = [mistake for mistake in mistakes if mistake.fault == "wrong_unit"]
            if unusable.intersection(group.tolist()):
                mistakes = []  # the torque is computed from impossible positions and shows nothing
            by_group.append([mistake for mistake in mistakes if self._may_explain(u, mistake, group)])
        return by_group

    def _evidence(self) -> Evidence:
        """What the channels show by themselves."""
        inverted = {j for j, joint in enumerate(self.joints) if self.gains.get(joint.name, 1.0) < 0}
        torque_factors = {}
        for j, excess in enumerate(self.fit.excess.tolist()):
            if abs(excess) > _MIN_EXCESS:
                torque_factors[j] = 1e-3 if excess > 0 else 1e3
        return Evidence(inverted, self._out_of_range(), torque_factors)

    def _suspects(self, u: Array, group: Indices, evidence: Evidence) -> Suspects:
        """Joints of a group in which mistakes are looked for: of many, those with evidence and those explained worst.

        For each mistake, all bodies are fitted once more, which takes about as long as the cube of the number of their
        coefficients.
        """
        has_evidence = np.isin(group, list(evidence.joints))
        order = np.lexsort([-u[group], ~has_evidence])  # by the last key first
        most_suspicious_first = group[order].tolist()
        singles = exchanged = len(group)
        if len(group) > _FEW_JOINTS:
            most_fits = int(_MOST_WORK / len(self.fit.equation.coefficients) ** 3)
            most_suspects = max(most_fits // _MISTAKES, _FEWEST_SUSPECTS)  # single joints and pairs
            singles = min(most_suspects, len(group))
            most_pairs = max(most_suspects - singles, 1)
            exchanged = (1 + math.isqrt(1 + 8 * most_pairs)) // 2  # n joints make n (n − 1) / 2 pairs
        return Suspects(
            tuple(group.tolist()),
            tuple(sorted(most_suspicious_first[:singles])),
            tuple(itertools.combinations(sorted(most_suspicious_first[:exchanged]), 2)),
        )

    def _may_explain(self, u: Array, mistake: Mistake, group: Indices) -> bool:
        """False if even unconstrained coefficients gain too little from undoing a mistake of the torques alone."""
        return mistake.position is not None or self._largest_gain(u, mistake, group) > _MIN_GAIN

    def _largest_gain(self, u: Array, mistake: Mistake, group: Indices) -> float:
        """Bound on the gain from undoing a mistake of the torques alone."""
        least = np.maximum(self._sample.free(mistake.T @ self.T), MIN_UNEXPLAINED)
        return float(np.log(u[group] / least[group]).sum())

    def _better_torque_order(self, u: Array) -> Mistake | None:
        """Another order of the torques that fits the joints' own equations far better."""
        if max(u) < _SUSPICIOUS or max(u) == _NO_FIT or len(u) < 2:
            return None
        from scipy.optimize import linear_sum_assignment

        cost = np.log(np.maximum(self._sample.exchanged, MIN_UNEXPLAINED))
        _, order = linear_sum_assignment(cost)
        if np.trace(cost) - cost[np.arange(len(u)), order].sum() < _MIN_ORDER_GAIN:
            return None
        return torque_order([int(k) for k in order], self._names)

    def _out_of_range(self) -> set[int]:
        """Joints whose q lies beyond their limits by more than their range, or covers many turns."""
        out_of_range = set()
        for j, (joint, (low, high)) in enumerate(zip(self.joints, self.limits, strict=True)):
            limit_range = joint.upper - joint.lower
            if 0 < limit_range < np.inf:
                is_beyond = max(high - joint.upper, joint.lower - low) > limit_range
            else:
                is_beyond = joint.kind != "prismatic" and high - low > _MAX_TRAVEL
            if is_beyond:
                out_of_range.add(j)
        return out_of_range - self._with_wrong_unit()

    def _with_wrong_unit(self) -> set[int]:
        """Joints whose wrong unit is among the accepted mistakes."""
        return {j for mistake in self.accepted if mistake.fault == "wrong_unit" for j in mistake.joints}

    def _position_faults(self, u: Array) -> Iterator[Notice]:
        """Impossible positions that the torque does not show, or that it is computed from."""
        known = self._with_wrong_unit()
        out_of_range = self._out_of_range()
        for j, (joint, (low, high)) in enumerate(zip(self.joints, self.limits, strict=True)):
            limit_range = joint.upper - joint.lower
            spoils_torque = j in out_of_range and joint.name in self.computed and u[j] > _MAX_FINAL_MEAN
            is_far = 0 < limit_range < np.inf and high - low > max(_FAR_BEYOND * limit_range, np.pi)
            if j not in known and (is_far or spoils_torque):
                in_urdf = f"in the URDF from {short_number(joint.lower)} to {short_number(joint.upper)}"
                message = (
                    f"q ranges from {short_number(low)} to {short_number(high)}, but {in_urdf}; it may be in "
                    "degrees, mm or counts"
                )
                yield Notice("wrong_unit", "problem", joint.name, message, "set its `log.scale`")

    def _velocity_faults(self) -> Iterator[Notice]:
        """Velocities with another sign or unit than their positions, unless the positions are wrong."""
        corrected = {(mistake.fault, j) for mistake in self.accepted if mistake.position for j in mistake.joints}
        for j, joint in enumerate(self.joints):
            gain = self.gains.get(joint.name, 1.0)
            if gain < 0 and ("wrong_sign", j) not in corrected:
                message = f"v is {short_number(gain)} times the derivative of q"
                if self._u is not None and self._u[j] < _MAX_FINAL_MEAN:
                    message += ", and q agrees with tau"
                yield Notice("wrong_sign", "problem", joint.name, message, "set the `log.scale` of v to -1")
            if is_another_unit(gain) and ("wrong_unit", j) not in corrected:
                ratio = f"the magnitude of v is {short_number(abs(gain))} times that of the derivative of q"
                advice = f"set the `log.scale` of v to {short_number(1 / gain, 4)}"
                yield Notice("wrong_unit", "problem", joint.name, ratio, advice)


def _gain(before: Array, after: Array, group: Indices) -> float:
    """Reduction of the sum of log u over some joints; −inf if their mean is not reduced enough."""
    if after[group].mean() > _MAX_MEAN_RATIO * before[group].mean():
        return -np.inf
    return float(np.log(before[group] / after[group]).sum())


def _as_logged(motion: Motion) -> Motion:
    return motion


def _composed(first: Change, then: Change) -> Change:
    return lambda motion: then(first(motion))
