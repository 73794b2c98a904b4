"""`LoadDependentTerm`: a term of the actuator torque, which is taken from the model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.joint_term import JointTerm
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.probe import Probe


class LoadDependentTerm(JointTerm):
    """A term whose column depends on the actuator torque.

    In the torque equation that is the torque which the rest of the model predicts: measured torque in a column would
    explain its own noise and everything that the model lacks. In the forward model it is the acting torque.
    """

    _model_along: Callable[[Motion], Linearization] | None = None

    @classmethod
    @override
    def probe(cls, summary: DataSummary, joint: int, nonlinear_values: Mapping[str, float]) -> Probe:
        probe = super().probe(summary, joint, nonlinear_values)

        def columns(motion: Motion, linearized: Linearization) -> Mapping[int, Array]:
            predicted = replace(motion, tau=linearized.predicted_torque)
            return probe.columns(predicted, linearized)

        return replace(probe, columns=columns)

    @override
    def set_operating_point(self, model: Callable[[Motion], Linearization], theta: Array) -> None:
        self._model_along = model
        self._theta = theta

    @override
    def columns(self, motion: Motion, out: Sequence[Array]) -> None:
        if self._model_along is not None:
            other_torque = self._model_along(motion).predicted_torque
            motion = replace(motion, tau=self.actuator_torque(other_torque, self._theta, motion))
        super().columns(motion, out)

    def actuator_torque(self, tau: Array, theta: Array, motion: Motion) -> Array:
        """Actuator torque with this term, from that without it, shape (nv, N).

        Parameters
        ----------
        tau
            Torque of the other effects, shape (nv, N).
        theta
            The term's coefficients, shape (m,).
        motion
            N samples.
        """
        return tau
