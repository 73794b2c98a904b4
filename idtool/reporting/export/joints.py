"""Torque on joints in MuJoCo: attributes of the joint, springs in tendons, and tendons that its motor drives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field

from idtool.common.dataclass import dataclass
from idtool.common.number_text import short_number
from idtool.dynamics.effects.simulator_element import (
    ConstantTorque,
    Damping,
    FrictionLoss,
    OneSidedSpring,
    QuadraticDamping,
    SimulatorElement,
    Spring,
    TorqueTransfer,
)
from idtool.reporting.export.base import Part
from idtool.reporting.export.identified import EffectTorque


@dataclass
class JointForces:
    """Forces on one joint, in MuJoCo's terms.

    Its torque is ctrl + bias − damping v − drag v abs(v) − frictionloss sign(v) − stiffness (q − springref), SI; its
    links are as they are drawn where q = ref.

    Attributes
    ----------
    stops
        Side, position and stiffness of springs that act beyond a position.
    torque_shares
        Share of its motor's torque that acts on other joints, by name.
    """

    damping: float = 0.0
    drag: float = 0.0
    frictionloss: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    springref: float = 0.0
    bias: float = 0.0
    ref: float = 0.0
    stops: list[tuple[float, float, float]] = field(default_factory=list)
    torque_shares: dict[str, float] = field(default_factory=dict)

    def add_spring(self, stiffness: float, springref: float) -> str:
        """Add a spring, to which one that is there already adds; how the file carries it."""
        if self.stiffness:
            total = self.stiffness + stiffness
            springref = (self.stiffness * self.springref + stiffness * springref) / total
            stiffness = total
        self.stiffness = stiffness
        self.springref = springref
        return f"stiffness, springref {short_number(springref)}"

    def attributes(self) -> dict[str, str]:
        """Attributes of the joint's tag that are not zero."""
        names = ("damping", "frictionloss", "armature", "stiffness", "springref", "ref")
        attributes = {name: repr(float(getattr(self, name))) for name in names if getattr(self, name)}
        if self.drag:
            attributes["damping"] = f"{float(self.damping)!r} {float(self.drag)!r}"
        return attributes


class ForcesByJoint(dict[str, JointForces]):
    """Forces on the joints, by name.

    Parameters
    ----------
    joints
        The joints' names, in the model's order.
    """

    def __init__(self, joints: Sequence[str]) -> None:
        super().__init__({name: JointForces() for name in joints})

    def add_term(self, term: EffectTorque) -> Part | None:
        """Add a term; None where MuJoCo has nothing like it."""
        if not term.elements or not all(map(_is_supported, term.elements)):
            return None
        details = [self._add(element) for element in term.elements]
        return term.part(" and ".join(details))

    def _add(self, element: SimulatorElement) -> str:
        """Add an element that MuJoCo has; how the file carries it."""
        names = list(self)
        forces = self[names[element.joint]]
        match element:
            case Damping(coefficient=coefficient):
                forces.damping += coefficient
                return "damping"
            case QuadraticDamping(coefficient=coefficient):
                forces.drag += coefficient
                return "quadratic coefficient of damping"
            case FrictionLoss(level=level):
                forces.frictionloss += level
                return "frictionloss"
            case ConstantTorque(torque=torque):
                forces.bias -= torque
                return "bias of an actuator, with the opposite sign"
            case Spring(stiffness=stiffness, rest_position=rest_position):
                return forces.add_spring(stiffness, rest_position + forces.ref)
            case OneSidedSpring(stiffness=stiffness, position=position, side=side):
                forces.stops.append((side, position + forces.ref, stiffness))
                return f"a spring on a tendon, which acts beyond {short_number(position + forces.ref)}"
            case TorqueTransfer(source=source, share=share):
                shares = self[names[source]].torque_shares
                joint = names[element.joint]
                shares[joint] = shares.get(joint, 0.0) + share
                return f"a tendon that the motor of {names[source]} drives"
        raise TypeError(type(element).__name__)


def _is_supported(element: SimulatorElement) -> bool:
    """True for an element that MuJoCo has."""
    if isinstance(element, FrictionLoss):
        return element.level >= 0  # MuJoCo would take it for a force along the motion
    return isinstance(element, Damping | QuadraticDamping | ConstantTorque | Spring | OneSidedSpring | TorqueTransfer)
