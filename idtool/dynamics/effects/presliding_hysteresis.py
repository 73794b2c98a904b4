"""Friction that builds up over a displacement after each reversal: Dahl's model, and LuGre's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array, Mask
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.joint_term import JointTerm
from idtool.dynamics.effects.named_effect import NonlinearParameter
from idtool.dynamics.effects.probe import geometric_grid
from idtool.dynamics.mechanism import Mechanism

_FORGETS = 4.0  # displacements along the path after which 2 % are left of the initial state
_SHORTEST = 5e-4  # displacements that are tried, as shares of the travel
_LONGEST = 0.15
_TRIALS = 8
_NOISE_PLAY = 3.0  # deadband · dt: path to and fro that is noise


class PreslidingHysteresis(JointTerm):
    """amplitude · (z + damping dz/dt), dz/dt = v / displacement · (1 − z sign(v)); the amplitude is identified.

    Dahl, Solid friction damping of mechanical vibrations, AIAA Journal 14 (1976). The state z depends on the path
    alone: after a reversal it turns from −1 to 1 within a few displacements, and then is the sign of the velocity. So
    this replaces Coulomb friction: leave that out of the joint's `friction`, or the two share its level. With a
    damping [s], which may be left out, the bristles are damped: Canudas de Wit et al., A new model for control of
    systems with friction, IEEE Transactions on Automatic Control 40 (1995), with sigma_1 = amplitude · damping /
    displacement, without the Stribeck curve.
    """

    id = "presliding_hysteresis"
    description = "friction builds up over a displacement after each reversal"
    excitation_hint = "small reversals of several amplitudes"
    cause = "distance_since_reversal"
    follows_direction = True
    generalizes = ("coulomb_friction",)
    coefficient_name = "amplitude"
    is_friction = True
    units = ("N·m", "N")
    nonlinear_parameters = (
        NonlinearParameter("displacement", ("rad", "m"), positive=True),
        NonlinearParameter("damping", ("s", "s"), optional_maximum=0.5),
    )

    @classmethod
    @override
    def trial_values(cls, summary: DataSummary, joint: int) -> Iterator[Mapping[str, float]]:
        """Displacements of a small share of the travel, which would pass for a spring otherwise."""
        travel = summary.q_range[joint]
        for displacement in geometric_grid(_SHORTEST * travel, _LONGEST * travel, _TRIALS):
            yield {"displacement": displacement, "damping": 0.0}

    @classmethod
    @override
    def dry_friction(cls, values: Mapping[str, Any]) -> float:
        return float(values["amplitude"])

    def torque(self, state: Array, v: Array) -> Array:
        """Torque per unit of the amplitude; see `HysteresisTerm.torque`."""
        rate = (v - state * np.abs(v)) / self.nonlinear_values["displacement"]
        return np.asarray(state + self.nonlinear_values["damping"] * rate)

    def next_state(self, state: Array, path: Array) -> Array:
        """State after a path; see `HysteresisTerm.next_state`.

        Along a path in one direction, z − sign(path) falls by e every displacement.
        """
        decay = np.exp(-np.abs(path) / self.nonlinear_values["displacement"])
        return np.asarray(np.sign(path) * (1 - decay) + state * decay)

    @override
    def column(self, motion: Motion) -> Array:
        """Torque of the state along the measured path.

        The initial state is that of a joint which has always moved as it does at the first sample, or 0 if it rests.
        """
        joint = int(self.joint)
        v = motion.v[joint]
        path = self._path_steps(motion)
        decay = np.exp(-np.abs(path) / self.nonlinear_values["displacement"])
        gain = np.sign(path) * (1 - decay)
        z = float(np.tanh(v[0] / float(motion.velocity_deadband[joint])))
        states = [z]
        for d, g in zip(decay.tolist(), gain.tolist(), strict=True):
            z = d * z + g
            states.append(z)
        return self.torque(np.array(states), v)

    @override
    def invalid_mask(self, motion: Motion) -> dict[int, Mask]:
        """Samples before the joint has moved so far, to and fro, that its initial state does not matter.

        Two states along the same path approach each other by e every displacement, in whichever direction it leads.
        """
        moved = np.append(0.0, np.cumsum(np.abs(self._path_steps(motion))))
        return {int(self.joint): moved < _FORGETS * self.nonlinear_values["displacement"]}

    def _path_steps(self, motion: Motion) -> Array:
        """Displacement of the joint from each sample to the next without its noise, shape (N − 1,)."""
        joint = int(self.joint)
        play = _NOISE_PLAY * float(motion.velocity_deadband[joint]) * motion.dt
        return np.diff(_without_noise(motion.q[joint], play))

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        mechanism.hysteresis_terms.append((self, float(theta[0])))


def _without_noise(q: Array, play: float) -> Array:
    """Path without motion to and fro by less than a play, shape (N,).

    Each such pair of steps would move the state a little towards zero, and a joint at rest lose all of it to noise.
    """
    position = float(q[0])
    positions = []
    for x in q.tolist():
        if x > position + play:
            position = x - play
        elif x < position - play:
            position = x + play
        positions.append(position)
    return np.array(positions)
