"""Signs, order and units of the channels, by what bodies can be.

Where bodies that can be explain the torque as logged, nothing is wrong that matters here. Where they do not, every
mistake of `channel_mistakes` is undone in turn, in all independent parts of the robot at once. One is believed when
the rest of the torque shrinks manifold by it: a wrong model, a missing effect or noise are no better off with a channel
turned or swapped.

Letters as in `channel_fit`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, field, replace
from itertools import zip_longest

import numpy as np
from scipy.optimize import linear_sum_assignment

from idtool.common.arrays import Array, Indices
from idtool.common.notice import Notice
from idtool.data.inspection.velocity_findings import is_another_unit
from idtool.data.signals import Motion
from idtool.diagnosis.data_faults.channel_fit import EXPLAINED, Change, ChannelFit
from idtool.diagnosis.data_faults.channel_mistakes import Mistake, possible_mistakes, torque_order
from idtool.estimation.dataset.experiment import Progress
from idtool.robot.urdf.reading import Joint

_SUSPICIOUS = 0.005  # u above which mistakes are looked for
_GAIN = 1.5  # what the sum over the joints of log u has to fall by; without a mistake none of 200 logs gained 0.5
_LESS = 0.35  # to which the mean of u has to fall
_LEFT = 0.15  # mean of u above which nothing is believed in the end
_ALIKE = 0.7  # of the sum that has to fall: of two that differ by less the former is believed
_ROUNDS = 4
_HOPELESS = 1e9  # u where no fit is found at all
_STAGE = "looking for wrong channels"
_ORDER = 2.0  # by which the sum has to fall by any coefficients whatever in another order of the torques
_RANGES = 10.0  # of the URDF that a joint can't cover, whatever the torque says
_TURNS = 8 * np.pi  # rad that a joint without limits may be taken to cover


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
        Least and greatest q of each, shape (nv, 2).
    gains
        Of v over dq/dt, by joint, where the two agree.
    computed
        Names of joints whose torque is the controller's.
    progress
        Told the stage and how far it has come.
    accepted
        Mistakes that are believed, in turn.
    """

    fit: ChannelFit
    joints: tuple[Joint, ...]
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

    def faults(self) -> Iterator[Notice]:
        """All faults of signs, order and units that the motion tells."""
        self.progress(_STAGE, 0.0)
        u = self._sample.unexplained(self.T)
        if u is None and self._outside():  # units may be so wrong that no fit is found
            u = np.full(len(self.joints), _HOPELESS)
        if u is not None:
            yield from self._mistakes(u)
            yield from self._beyond(u)
        yield from self._velocities()

    def _mistakes(self, u: Array) -> Iterator[Notice]:
        """Undo one mistake after the other, as long as that helps; yield those that make sense in the end."""
        faults: list[tuple[Indices, Notice]] = []
        order = self._order(u)
        chosen: dict[int | None, Mistake] = {None: order} if order is not None and self._helps(u, order) else {}
        for _ in range(_ROUNDS):
            chosen = chosen or self._best(u)
            after = self._unexplained_without(list(chosen.values())) if chosen else None
            if after is None:
                break
            for g, mistake in chosen.items():
                group = np.array(mistake.joints) if g is None else self.fit.groups[g]
                for fault in mistake.faults(self._names, u[group].mean(), after[group].mean(), self.computed):
                    faults.append((group, fault))
            self._accept(list(chosen.values()))
            u, chosen = after, {}
        for group, fault in faults:
            if u[group].mean() < _LEFT:
                yield fault

    def _helps(self, u: Array, mistake: Mistake) -> bool:
        after = self._unexplained_without([mistake])
        return after is not None and _gain(u, after, np.arange(len(u))) > _GAIN

    def _accept(self, chosen: list[Mistake]) -> None:
        self.T, self.position = self._without(chosen)
        self._sample = self.fit.reduced(self.position)
        self.accepted += chosen

    def _without(self, mistakes: list[Mistake]) -> tuple[Array, Change]:
        """Torques and positions with more mistakes undone."""
        T, position = self.T, self.position
        for mistake in mistakes:
            T = mistake.T @ T
            if mistake.position is not None:
                position = _after(position, mistake.position)
        return T, position

    def _unexplained_without(self, mistakes: list[Mistake]) -> Array | None:
        """Shares u with more mistakes undone, shape (nv,); None without a fit, or where other joints are mute."""
        T, position = self._without(mistakes)
        sample = self._sample if position is self.position else self.fit.reduced(position)
        return sample.unexplained(T) if np.array_equal(sample.mute, self._sample.mute) else None

    def _best(self, u: Array) -> dict[int | None, Mistake]:
        """By independent part of the robot, the mistake that is best undone next, with those that do as well."""
        lists = self._suspected(u)
        gains: dict[int, list[float]] = {g: [] for g in range(len(lists))}
        steps = list(zip_longest(*lists))
        for k, step in enumerate(steps):
            self.progress(_STAGE, k / len(steps))
            after = self._unexplained_without([mistake for mistake in step if mistake])
            for g, mistake in enumerate(step):
                if mistake:
                    gains[g].append(-np.inf if after is None else _gain(u, after, self.fit.groups[g]))
        best: dict[int | None, Mistake] = {}
        for g, own in gains.items():
            if own and max(own) > _GAIN:
                first, *others = (mistake for mistake, x in zip(lists[g], own, strict=True) if x > max(own) - _ALIKE)
                best[g] = replace(first, others=tuple(others))
        return best

    def _suspected(self, u: Array) -> list[list[Mistake]]:
        """By independent part of the robot, the mistakes that may have been made.

        A mistake of the torques alone is left out where no fit could be so good, not even one of any coefficients.
        """
        outside = self._outside()
        turned = {j for j, joint in enumerate(self.joints) if self.gains.get(joint.name, 1.0) < 0}
        lists = []
        for group in self.fit.groups:
            suspicious = max(u[group]) > _SUSPICIOUS
            own: list[Mistake] = []
            if suspicious:
                own = possible_mistakes(list(map(int, group)), self.joints, turned, outside, self.fit.excess)
            if max(u) == _HOPELESS:
                own = [mistake for mistake in own if mistake.fault == "wrong_unit"]
            if any(j in outside and self._names[j] in self.computed for j in group):
                own = []  # the torque is computed from what can't be, and tells nothing
            lists.append([one for one in own if one.position or self._largest_gain(u, one, group) > _GAIN])
        return lists

    def _largest_gain(self, u: Array, mistake: Mistake, group: Indices) -> float:
        """The most that undoing a mistake of the torques alone may gain."""
        least = np.maximum(self._sample.free(mistake.T @ self.T), EXPLAINED)
        return float(np.log(u[group] / least[group]).sum())

    def _order(self, u: Array) -> Mistake | None:
        """Another order of the torques, where the joints' own equations ask for one."""
        if max(u) < _SUSPICIOUS or max(u) == _HOPELESS or len(u) < 2:
            return None
        cost = np.log(np.maximum(self._sample.exchanged, EXPLAINED))
        _, order = linear_sum_assignment(cost)
        if np.trace(cost) - cost[np.arange(len(u)), order].sum() < _ORDER:
            return None
        return torque_order([int(k) for k in order], self._names)

    def _outside(self) -> set[int]:
        """Joints whose q lies beyond their limits by more than their range, or of many turns."""
        outside = set()
        for j, (joint, (low, high)) in enumerate(zip(self.joints, self.limits, strict=True)):
            range_ = joint.upper - joint.lower
            if 0 < range_ < np.inf:
                beyond = max(high - joint.upper, joint.lower - low) > range_
            else:
                beyond = joint.kind != "prismatic" and high - low > _TURNS
            if beyond:
                outside.add(j)
        return outside - self._of_wrong_unit()

    def _of_wrong_unit(self) -> set[int]:
        """Joints whose wrong unit is among the accepted mistakes."""
        return {j for mistake in self.accepted if mistake.fault == "wrong_unit" for j in mistake.joints}

    def _beyond(self, u: Array) -> Iterator[Notice]:
        """Positions that can't be, where the torque does not mind or, being computed from them, can't tell."""
        known = self._of_wrong_unit()
        outside = self._outside()
        for j, (joint, (low, high)) in enumerate(zip(self.joints, self.limits, strict=True)):
            range_ = joint.upper - joint.lower
            spoilt = j in outside and joint.name in self.computed and u[j] > _LEFT
            far = 0 < range_ < np.inf and high - low > max(_RANGES * range_, np.pi)
            if j not in known and (far or spoilt):
                travel = f"q goes from {low:.4g} to {high:.4g}, by the URDF from {joint.lower:.4g} to {joint.upper:.4g}"
                message = f"{travel}, as degrees, mm or counts do"
                yield Notice("wrong_unit", "problem", joint.name, message, "set its `log.scale`")

    def _velocities(self) -> Iterator[Notice]:
        """Velocities that have another sign or unit than their positions, where it is not the positions' fault."""
        put_right = {(mistake.fault, j) for mistake in self.accepted if mistake.position for j in mistake.joints}
        for j, joint in enumerate(self.joints):
            gain = self.gains.get(joint.name, 1.0)
            if gain < 0 and ("wrong_sign", j) not in put_right:
                ratio = f"v is {gain:.3g} times the derivative of q, which agrees with tau"
                yield Notice("wrong_sign", "problem", joint.name, ratio, "set the `log.scale` of v to -1")
            if is_another_unit(gain) and ("wrong_unit", j) not in put_right:
                ratio = f"v is {abs(gain):.4g} times the derivative of q in size"
                advice = f"set the `log.scale` of v to {1 / gain:.4g}"
                yield Notice("wrong_unit", "problem", joint.name, ratio, advice)


def _gain(before: Array, after: Array, which: Indices) -> float:
    """By how much the sum of log u falls over some of the joints; none where their mean does not fall by as much."""
    if after[which].mean() > _LESS * before[which].mean():
        return -np.inf
    return float(np.log(before[which] / after[which]).sum())


def _as_logged(motion: Motion) -> Motion:
    return motion


def _after(first: Change, then: Change) -> Change:
    return lambda motion: then(first(motion))
