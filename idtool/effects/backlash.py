"""Play between a joint's motor and its link."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from idtool.effects.held_effect import HeldJointEffect
from idtool.effects.joint_effect import Held
from idtool.effects.probe import spread
from idtool.effects.survey import Present, Survey
from idtool.mechanism import Gear, Mechanism
from idtool.model import Model
from idtool.signals import Motion

Array = NDArray[np.float64]

_DAMPING = 0.5  # of what is critical
_NARROW, _WIDE, _TRIED = 3e-4, 0.12, 9  # rad or m
_LEAST, _MOST = 0.5, 1.8  # of the change that the width makes
_LIGHT = 1e-9  # kg·m² or kg


class Backlash(HeldJointEffect):
    """Play of a width between the motor's side, which is measured and driven, and the link's.

    Where the joint has no `joint_elasticity`, the teeth are a spring on which motor and link would swing against each
    other at 200 Hz, half critically damped: needs a rotor or `rotor_inertia` on the joint.

    In the torque equation the link's motion is the measured one less the place of the motor within the play. While the
    teeth are apart, the motor moves as measured and the link falls freely, so that the play closes with carried torque
    / the link's inertia, both as the model without the play has them; where teeth meet they stay.
    """

    id = "backlash"
    held = (Held("width", positive=True),)

    def __init__(self, model: Model, joint: int, shape: Mapping[str, float] | None = None) -> None:
        super().__init__(model, joint, shape)
        self._along: Callable[[Motion], Present] | None = None

    @classmethod
    def shapes(cls) -> tuple[str, ...]:
        """See `NamedEffect.shapes`: none, since the moments at which teeth part and meet jump from sample to sample."""
        return ()

    @classmethod
    def tried(cls, survey: Survey, joint: int) -> Iterator[Mapping[str, float]]:
        """See `JointEffect.tried`: from what gears have to what would be felt by hand."""
        for width in spread(_NARROW, _WIDE, _TRIED):
            yield {"width": width}

    @classmethod
    def slopes(cls, survey: Survey, joint: int, shape: Mapping[str, float], motion: Motion, present: Present) -> Array:
        """See `HeldJointEffect.slopes`: all of the change, of which the coefficient should be 1."""
        return _change(motion, joint, shape["width"], present)

    @classmethod
    def solved(cls, c: float, shape: Mapping[str, float]) -> Mapping[str, float] | None:
        """See `HeldJointEffect.solved`."""
        return dict(shape) if _LEAST < c < _MOST else None

    def refer(self, model: Callable[[Motion], Present]) -> None:
        """See `Effect.refer`."""
        self._along = model

    def known(self, motion: Motion) -> Array | None:
        """See `Effect.known`."""
        return None if self._along is None else _change(motion, self.joint, self.shape["width"], self._along(motion))

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`."""
        teeth = mechanism.gears.get(self.joint, Gear(np.inf, _DAMPING))
        mechanism.gears[self.joint] = replace(teeth, play=self.shape["width"])


def _change(motion: Motion, joint: int, width: float, present: Present) -> Array:
    """What play adds to the predicted torque, shape (nv, N)."""
    carried, inertia = present.carried(motion, joint)
    place = _place(carried / np.maximum(inertia, _LIGHT), width, motion.dt)
    v = np.gradient(place, motion.dt)
    return present.moved(motion, joint, -place, -v, -np.gradient(v, motion.dt))


def _place(closing: Array, width: float, dt: float) -> Array:
    """Where the motor is within the play, in [−width/2, width/2], driven by an acceleration, shape (N,)."""
    half, out = width / 2, []
    x, v = (half if closing[0] > 0 else -half), 0.0
    for a in closing.tolist():
        v += a * dt
        x += v * dt
        if x >= half:
            x, v = half, min(v, 0.0)
        elif x <= -half:
            x, v = -half, max(v, 0.0)
        out.append(x)
    return np.array(out)
