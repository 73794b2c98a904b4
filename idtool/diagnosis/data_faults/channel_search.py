"""Search for wrong signs, order and units of the channels, by whether realizable bodies explain the torque.

If they explain the torque as logged, there is no fault that matters. If they do not, every mistake of
`channel_mistakes` is undone in turn, in all independent groups of joints at once. One is accepted if it reduces the
unexplained torque manyfold: for a wrong model, a missing effect or noise, an inverted or swapped channel is no help.

Letters as in `channel_fit`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import field, replace
from itertools import zip_longest

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.data.inspection.velocity_findings import is_another_unit
from idtool.data.signals import Motion
from idtool.diagnosis.data_faults.channel_fit import MIN_UNEXPLAINED, Change, ChannelFit
from idtool.diagnosis.data_faults.channel_mistakes import (
    Evidence,
    LogScale,
    Mistake,
    PossibleMistakes,
    Suspects,
    torque_order,
    velocity_factor,
)
from idtool.estimation.dataset.experiment import Progress
from idtool.robot.urdf.reading import UrdfJoint

_SUSPICIOUS = 0.005  # u above which mistakes are looked for
# Decrease of the sum over the joints of log u. Without a mistake, none of 200 logs had more than 0.5.
_MIN_IMPROVEMENT = 1.5
_MAX_MEAN_RATIO = 0.35  # of the mean of u, after over before
_MAX_FINAL_MEAN = 0.15  # of u, above which no fault is reported in the end
_EQUAL_IMPROVEMENT = 0.7  # difference of two improvements below which the preferred mistake is taken
_MAX_ROUNDS = 4
_FULL_SEARCH_JOINTS = 7  # of a group, in all of which mistakes are looked for, however long it takes
_MIN_SUSPECTS = 2  # joints of a larger group, likewise
_FITS_PER_SUSPECT = 3  # about as many as there are mistakes of one joint, and of a pair of joints
_MAX_FIT_WORK = 3.5e9  # fits of one round for a larger group, times the cube of the number of coefficients
_MIN_EXCESS = 1.5  # log10 of a torque over the URDF's, from which it may be a thousandfold
_U_WITHOUT_FIT = 1e9
_STAGE = "looking for wrong channels"
_MIN_ORDER_IMPROVEMENT = 2.0  # the same with unconstrained coefficients, for another order of the torques
_FAR_BEYOND = 10.0  # times the URDF's range, that a joint can't cover
_MAX_TRAVEL = 8 * np.pi  # rad of a joint without limits

Choice = tuple[Indices, Mistake]  # the joints whose torque it explains, and a mistake to be undone


@dataclass
class ChannelSearch:
    """The search for mistakes.

    Attributes
    ----------
    fit
        The sample of the logs.
    joints
        The nv joints.
    logged_ranges
        Least and greatest logged q of each, shape (nv, 2) [rad or m].
    velocity_gains
        Gain of v over dq/dt by name of the joint, where v was logged; NaN where the two do not agree otherwise.
    computed
        Names of joints whose torque is computed by the controller's law.
    log_scale
        How the channels were scaled.
    progress
        Callback for the stage and its progress, from 0 to 1.
    accepted
        Mistakes that were accepted, in turn.
    T
        Matrix of the torques from the logged ones, with the accepted mistakes undone, shape (nv, nv).
    position
        Correction of the positions, likewise.
    """

    fit: ChannelFit
    joints: tuple[UrdfJoint, ...]
    logged_ranges: Array
    velocity_gains: Mapping[str, float]
    computed: Set[str]
    log_scale: LogScale
    progress: Progress
    accepted: list[Mistake] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.T = np.eye(len(self.joints))
        self._names = [joint.name for joint in self.joints]
        self.position: Change = _as_logged
        self._sample = self.fit.reduced(self.position)
        self._u: Array | None = None  # with the accepted mistakes undone
        self._reported: list[Mistake] = []

    def faults(self) -> Iterator[Notice]:
        """All faults of signs, order and units that the motion shows."""
        self.progress(_STAGE, 0.0)
        self._u = self._sample.unexplained(self.T)
        if self._u is None and self._out_of_range():  # units may be so wrong that no fit is found
            self._u = np.full(len(self.joints), _U_WITHOUT_FIT)
        if self._u is not None:
            yield from self._mistake_faults(self._u)
            yield from self._position_faults(self._u)
        yield from self._velocity_faults()

    def _mistake_faults(self, u: Array) -> Iterator[Notice]:
        """Faults found by undoing one mistake after the other, of joints that are explained in the end."""
        undone: list[tuple[Choice, float, float]] = []  # with the joints' mean of u before and after
        for k in range(_MAX_ROUNDS):
            choices = self._better_torque_order(u) if k == 0 else []
            choices = choices or self._best_mistakes(u)
            mistakes = [mistake for _, mistake in choices]
            after = self._unexplained_without(mistakes) if mistakes else None
            if after is None:
                break
            undone += [((joints, mistake), u[joints].mean(), after[joints].mean()) for joints, mistake in choices]
            self._accept(mistakes)
            u = after
        self._u = u
        for (joints, mistake), before, after_mean in undone:
            if u[joints].mean() < _MAX_FINAL_MEAN:
                self._reported.append(mistake)
                yield from mistake.faults(self._names, before, after_mean, self.computed)

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

    def _best_mistakes(self, u: Array) -> list[Choice]:
        """The mistake of each group that is best undone next, together with equally good ones."""
        candidates = self._suspected_mistakes(u)
        improvements: list[list[float]] = [[] for _ in candidates]
        steps = list(zip_longest(*candidates))  # the k-th mistake of all groups at once
        for k, step in enumerate(steps):
            self.progress(_STAGE, k / len(steps))
            tried = {g: mistake for g, mistake in enumerate(step) if mistake is not None}
            for g, after in self._unexplained_without_each(tried).items():
                improvements[g].append(-np.inf if after is None else _improvement(u, after, self.fit.groups[g]))

        best: list[Choice] = []
        for group, mistakes, of_group in zip(self.fit.groups, candidates, improvements, strict=True):
            if max(of_group, default=-np.inf) > _MIN_IMPROVEMENT:
                least = max(max(of_group) - _EQUAL_IMPROVEMENT, _MIN_IMPROVEMENT)
                first, *others = (mistake for mistake, x in zip(mistakes, of_group, strict=True) if x >= least)
                best.append((group, replace(first, others=tuple(others))))
        return best

    def _unexplained_without_each(self, mistakes: Mapping[int, Mistake]) -> dict[int, Array | None]:
        """Shares u with the mistake of each group undone, by group.

        All are undone at once, since groups share no bodies; one by one if there is no fit then.
        """
        together = self._unexplained_without(list(mistakes.values()))
        if together is not None or len(mistakes) == 1:
            return dict.fromkeys(mistakes, together)
        return {g: self._unexplained_without([mistake]) for g, mistake in mistakes.items()}

    def _suspected_mistakes(self, u: Array) -> list[list[Mistake]]:
        """Mistakes that may have been made, by group."""
        evidence = self._evidence()
        possible = PossibleMistakes(self.joints, evidence, self.log_scale)
        unusable = {j for j in evidence.out_of_range if self._names[j] in self.computed}
        by_group = []
        for group in self.fit.groups:
            mistakes: list[Mistake] = []
            if max(u[group]) > _SUSPICIOUS:
                mistakes = possible.of(self._suspects(u, group, evidence))
            if max(u) == _U_WITHOUT_FIT:
                mistakes = [mistake for mistake in mistakes if mistake.kind == "wrong_unit"]
            if unusable.intersection(group.tolist()):
                mistakes = []  # the torque is computed from impossible positions and shows nothing
            by_group.append([mistake for mistake in mistakes if self._may_explain(u, mistake, group)])
        return by_group

    def _evidence(self) -> Evidence:
        """Signs of wrong channels that are left once the accepted mistakes are undone."""
        velocity_gains = {}
        for j, name in enumerate(self._names):
            if name in self.velocity_gains:
                velocity_gains[j] = self.velocity_gains[name] / self._position_factor(j, self.accepted)
        torque_factors = {}
        for j, excess in enumerate(self.fit.excess.tolist()):
            if abs(excess) > _MIN_EXCESS and j not in self._with_wrong_unit():
                torque_factors[j] = 1e-3 if excess > 0 else 1e3
        return Evidence(velocity_gains, self._out_of_range(), torque_factors)

    def _suspects(self, u: Array, group: Indices, evidence: Evidence) -> Suspects:
        """Joints of a group in which mistakes are looked for: of many, the most suspicious ones.

        For each mistake, all bodies are fitted once more. The time for it grows with the cube of the number of their
        coefficients.
        """
        most_suspicious_first = _most_suspicious_first(u, group, evidence)
        single_count = paired_count = len(group)
        if len(group) > _FULL_SEARCH_JOINTS:
            max_fits = int(_MAX_FIT_WORK / len(self.fit.equation.coefficients) ** 3)
            max_suspects = max(max_fits // _FITS_PER_SUSPECT, _MIN_SUSPECTS)  # single joints and pairs
            single_count = min(max_suspects, len(group))
            max_pairs = max(max_suspects - single_count, 1)
            paired_count = (1 + math.isqrt(1 + 8 * max_pairs)) // 2  # n joints make n (n − 1) / 2 pairs
        return Suspects(
            tuple(group.tolist()),
            tuple(sorted(most_suspicious_first[:single_count])),
            tuple(itertools.combinations(sorted(most_suspicious_first[:paired_count]), 2)),
        )

    def _may_explain(self, u: Array, mistake: Mistake, group: Indices) -> bool:
        """False if undoing a mistake of the torques alone improves too little even with unconstrained coefficients."""
        if mistake.position is not None:
            return True
        least = np.maximum(self._sample.free(mistake.T @ self.T), MIN_UNEXPLAINED)
        return float(np.log(u[group] / least[group]).sum()) > _MIN_IMPROVEMENT

    def _better_torque_order(self, u: Array) -> list[Choice]:
        """Another order of the torques of all joints that explains them far better; empty if there is none."""
        if max(u) < _SUSPICIOUS or max(u) == _U_WITHOUT_FIT or len(u) < 2:
            return []
        from scipy.optimize import linear_sum_assignment

        cost = np.log(np.maximum(self._sample.exchanged, MIN_UNEXPLAINED))
        _, order = linear_sum_assignment(cost)
        decrease = np.trace(cost) - cost[np.arange(len(u)), order].sum()
        if decrease < _MIN_ORDER_IMPROVEMENT:
            return []
        mistake = torque_order([int(k) for k in order], self._names)
        after = self._unexplained_without([mistake])
        if after is None or _improvement(u, after, np.arange(len(u))) <= _MIN_IMPROVEMENT:
            return []
        return [(np.array(mistake.joints), mistake)]

    def _out_of_range(self) -> set[int]:
        """Joints whose q lies beyond their limits by more than their range, or covers many turns."""
        out_of_range = set()
        for j, (joint, (low, high)) in enumerate(zip(self.joints, self.logged_ranges, strict=True)):
            if _has_limits(joint):
                is_beyond = max(high - joint.upper, joint.lower - low) > joint.upper - joint.lower
            else:
                is_beyond = joint.kind != "prismatic" and high - low > _MAX_TRAVEL
            if is_beyond:
                out_of_range.add(j)
        return out_of_range - self._with_wrong_unit()

    def _with_wrong_unit(self) -> set[int]:
        """Joints whose wrong unit is among the accepted mistakes."""
        return {j for mistake in self.accepted if mistake.kind == "wrong_unit" for j in mistake.joints}

    def _position_factor(self, j: int, mistakes: Sequence[Mistake]) -> float:
        """Factor of a joint's position that undoes mistakes."""
        return math.prod(mistake.position_factors.get(j, 1.0) for mistake in mistakes)

    def _position_faults(self, u: Array) -> Iterator[Notice]:
        """Impossible positions that the torque does not show, or that it is computed from."""
        known = self._with_wrong_unit()
        out_of_range = self._out_of_range()
        for j, (joint, (low, high)) in enumerate(zip(self.joints, self.logged_ranges, strict=True)):
            spoils_torque = j in out_of_range and joint.name in self.computed and u[j] > _MAX_FINAL_MEAN
            farthest = max(_FAR_BEYOND * (joint.upper - joint.lower), np.pi)
            is_far = _has_limits(joint) and high - low > farthest
            if j not in known and (is_far or spoils_torque):
                message = f"q ranges from {short_number(low)} to {short_number(high)}"
                if _has_limits(joint):
                    message += f", but in the URDF from {short_number(joint.lower)} to {short_number(joint.upper)}"
                message += "; it may be in degrees, mm or counts"
                yield Notice("wrong_unit", "problem", joint.name, message, "set its `log.scale`")

    def _velocity_faults(self) -> Iterator[Notice]:
        """Velocities with another sign or unit than their positions, unless they were corrected together."""
        corrected = {(mistake.kind, j) for mistake in self._reported for j in mistake.position_factors}
        out_of_range = self._out_of_range()
        for j, joint in enumerate(self.joints):
            gain = self.velocity_gains.get(joint.name, np.nan)
            if not np.isfinite(gain):
                continue
            factor = velocity_factor(gain, self._position_factor(j, self._reported))
            advice = self.log_scale.advice(joint.name, {"v": factor})
            if j in out_of_range:
                advice = "correct q, then run the diagnosis again: whether v is wrong depends on q"
            if factor < 0 and ("wrong_sign", j) not in corrected:
                message = f"v is {short_number(gain)} times the derivative of q"
                if self._u is not None and self._u[j] < _MAX_FINAL_MEAN:
                    message += ", and q agrees with tau"
                yield Notice("wrong_sign", "problem", joint.name, message, advice)
            if is_another_unit(factor) and ("wrong_unit", j) not in corrected:
                message = f"the magnitude of v is {short_number(abs(gain))} times that of the derivative of q"
                if gain < 0:
                    message += ", and its sign is the opposite"
                yield Notice("wrong_unit", "problem", joint.name, message, advice)


def _has_limits(joint: UrdfJoint) -> bool:
    return 0 < joint.upper - joint.lower < np.inf


def _most_suspicious_first(u: Array, group: Indices, evidence: Evidence) -> list[int]:
    """Joints of a group: those whose q or tau is impossible, then in turn one whose v is inverted and one of the worst.

    An inverted v mostly says nothing about q and tau, so it must not keep others from being looked at.
    """
    worst_first = group[np.argsort(-u[group], kind="stable")].tolist()
    impossible = [j for j in worst_first if j in evidence.out_of_range or j in evidence.torque_factors]
    inverted = [j for j in worst_first if j in evidence.inverted]
    in_turn = itertools.chain.from_iterable(zip_longest(inverted, worst_first))
    return list(dict.fromkeys([*impossible, *(j for j in in_turn if j is not None)]))


def _improvement(before: Array, after: Array, group: Indices) -> float:
    """Decrease of the sum of log u over some joints; −inf if their mean does not decrease enough."""
    if after[group].mean() > _MAX_MEAN_RATIO * before[group].mean():
        return -np.inf
    return float(np.log(before[group] / after[group]).sum())


def _as_logged(motion: Motion) -> Motion:
    return motion


def _composed(first: Change, then: Change) -> Change:
    return lambda motion: then(first(motion))
