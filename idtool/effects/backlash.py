"""Play between a joint's motor and its link."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from idtool.effects.held_effect import HeldJointEffect
from idtool.effects.joint_effect import Held
from idtool.mechanism import Gear, Mechanism

Array = NDArray[np.float64]

_DAMPING = 0.5  # of what is critical


class Backlash(HeldJointEffect):
    """Play of a width between the motor's side, which is measured and driven, and the link's.

    Where the joint has no `joint_elasticity`, the teeth are a spring on which motor and link would swing against each
    other at 200 Hz, half critically damped: needs a rotor or `rotor_inertia` on the joint.

    Nothing of it stands in the torque equation. There the joint and all that it moves have the motor's motion, which is
    wrong from where the carried torque turns round until the teeth have met again: a blip of some ten milliseconds.
    """

    id = "backlash"
    held = (Held("width", positive=True),)

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`."""
        teeth = mechanism.gears.get(self.joint, Gear(np.inf, _DAMPING))
        mechanism.gears[self.joint] = replace(teeth, play=self.shape["width"])
