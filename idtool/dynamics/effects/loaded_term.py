"""`LoadedTerm`: a term by the torque that actuators give, taken from the model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.joint_term import JointTerm
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.effects.survey import Present, Survey


class LoadedTerm(JointTerm):
    """A term whose column depends on the actuators' torque.

    In the torque equation that is what the rest of the model predicts: measured torque in a column would explain its
    own noise, and all that the model lacks. Forwards it is what acts.
    """

    _along: Callable[[Motion], Present] | None = None

    @classmethod
    def probe(cls, survey: Survey, joint: int, shape: Mapping[str, float]) -> Probe:
        """See `JointEffect.probe`."""
        found = super().probe(survey, joint, shape)

        def columns(motion: Motion, present: Present) -> Mapping[int, Array]:
            return found.columns(replace(motion, tau=present.predicted(motion)), present)

        return replace(found, columns=columns)

    def refer(self, model: Callable[[Motion], Present], theta: Array) -> None:
        """See `Effect.refer`."""
        self._along, self._theta = model, theta

    def write(self, motion: Motion, out: Sequence[Array]) -> None:
        """See `Effect.write`."""
        if self._along is not None:
            tau = self._along(motion).predicted(motion)
            motion = replace(motion, tau=self.with_own(tau, self._theta, motion))
        super().write(motion, out)

    def with_own(self, tau: Array, theta: Array, motion: Motion) -> Array:
        """What actuators give with the term, from what they give without, shape (nv, N); theta as in `join`."""
        return tau
