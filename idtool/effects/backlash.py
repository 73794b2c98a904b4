"""Play between a joint's motor and its link."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from idtool.effects.held_effect import HeldJointEffect
from idtool.effects.joint_effect import Held
from idtool.inertia import symmetric
from idtool.mechanism import Gear, Mechanism

Array = NDArray[np.float64]

_CONTACT = 2 * np.pi * 200.0  # rad/s: the motor on its teeth, far above what a log's band holds
_DAMPING = 0.5  # of what is critical
_LEAST = 1e-9  # kg·m² or kg


class Backlash(HeldJointEffect):
    """Play of a width between the motor's side, which is measured and driven, and the link's.

    Where the joint has no `joint_elasticity`, the teeth are a spring on which the motor's own inertia would swing at
    200 Hz, half critically damped: needs a rotor or `rotor_inertia` on the joint.

    Nothing of it stands in the torque equation. There the joint and all that it moves have the motor's motion, which is
    wrong from where the carried torque turns round until the teeth have met again: a blip of some ten milliseconds.
    """

    id = "backlash"
    held = (Held("width", positive=True),)

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`."""
        teeth = mechanism.gears.get(self.joint) or self._teeth(mechanism)
        mechanism.gears[self.joint] = replace(teeth, play=self.shape["width"])

    def _teeth(self, mechanism: Mechanism) -> Gear:
        inertia = float(mechanism.armature[self.joint])
        for body, pi in zip(mechanism.model.bodies, mechanism.pi, strict=True):
            if body.kind == "rotor":
                inertia += body.ratios[self.joint] ** 2 * float(body.axis @ symmetric(pi[4:]) @ body.axis)
        return Gear(max(inertia, _LEAST) * _CONTACT**2, _DAMPING)
