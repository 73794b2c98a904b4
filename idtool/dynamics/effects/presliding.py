"""Friction that builds up over a displacement after each reversal: Dahl's model, and LuGre's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import accumulate

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.data.signals import Motion
from idtool.dynamics.effects.joint_effect import Held
from idtool.dynamics.effects.joint_term import JointTerm
from idtool.dynamics.effects.probe import spread
from idtool.dynamics.effects.survey import Survey
from idtool.dynamics.mechanism import Mechanism

_FORGETS = 4.0  # displacements along the path after which 2 % are left of where a loop began
_SHORTEST, _LONGEST, _TRIED = 5e-4, 0.15, 8  # of the travel
_SHAKES = 3.0  # still · dt: path to and fro that is noise


class PreslidingHysteresis(JointTerm):
    """amplitude · (z + damping dz/dt), dz/dt = v / displacement · (1 − z sign(v)); the amplitude is not held.

    Dahl, Solid friction damping of mechanical vibrations, AIAA Journal 14 (1976). The state z depends on the path
    alone: after a reversal it turns from −1 to 1 within a few displacements, and then is the sign of the velocity. So
    this stands in the place of Coulomb friction: leave that out of the joint's `friction`, or the two share its level.
    With a damping [s], which may be left out, the bristles are damped: Canudas de Wit et al., A new model for control
    of systems with friction, IEEE Transactions on Automatic Control 40 (1995), with sigma_1 = amplitude · damping /
    displacement, without the Stribeck curve.
    """

    id = "presliding_hysteresis"
    means = "friction builds up over a displacement after each reversal"
    shows = "small reversals of several amplitudes"
    contains = ("coulomb_friction",)
    name = "amplitude"
    friction = True
    unit = ("N·m", "N")
    held = (Held("displacement", positive=True), Held("damping", most=0.5))

    @classmethod
    def tried(cls, survey: Survey, joint: int) -> Iterator[Mapping[str, float]]:
        """See `JointEffect.tried`: a small share of the travel, which would pass for a spring otherwise."""
        for displacement in spread(_SHORTEST * survey.travel[joint], _LONGEST * survey.travel[joint], _TRIED):
            yield {"displacement": displacement, "damping": 0.0}

    def torque(self, state: Array, v: Array) -> Array:
        """See `Loop.torque`."""
        rate = (v - state * np.abs(v)) / self.shape["displacement"]
        return np.asarray(state + self.shape["damping"] * rate)

    def after(self, state: Array, way: Array) -> Array:
        """See `Loop.after`: along a way in one direction, z − sign(way) falls by e every displacement."""
        left = np.exp(-np.abs(way) / self.shape["displacement"])
        return np.asarray(np.sign(way) * (1 - left) + state * left)

    def column(self, motion: Motion) -> Array:
        """The state along the measured path, from that of a joint which has moved as it does at the first sample.

        One that rests there begins in the middle.
        """
        joint = int(self.joint)
        v, still = motion.v[joint], float(motion.still[joint])
        way = self._way(motion)
        left = np.exp(-np.abs(way) / self.shape["displacement"])
        gain = np.sign(way) * (1 - left)
        first = float(np.tanh(v[0] / still))
        steps = zip(left.tolist(), gain.tolist(), strict=True)
        states = np.array(list(accumulate(steps, lambda z, step: step[0] * z + step[1], initial=first)))
        return self.torque(states, v)

    def undefined(self, motion: Motion) -> dict[int, Mask]:
        """Until the joint has moved so far, to and fro, that it does not matter where it came from.

        Two states along the same path come nearer by e every displacement, in whichever direction it leads.
        """
        moved = np.cumsum(np.abs(self._way(motion)))
        short = np.append(0.0, moved) < _FORGETS * self.shape["displacement"]
        return {int(self.joint): short}

    def _way(self, motion: Motion) -> Array:
        """The joint's way from each sample to the next without its shaking, shape (N − 1,)."""
        joint = int(self.joint)
        play = _SHAKES * float(motion.still[joint]) * motion.dt
        return np.diff(_steadied(motion.q[joint], play))

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`."""
        mechanism.loops.append((self, float(theta[0])))


def _steadied(q: Array, play: float) -> Array:
    """The path without what goes to and fro by less than a play, shape (N,).

    Each such pair of steps would move the state a little towards zero, and a joint at rest lose all of it to noise.
    """
    out, place = [], float(q[0])
    for x in q.tolist():
        place = x - play if x > place + play else x + play if x < place - play else place
        out.append(place)
    return np.array(out)
