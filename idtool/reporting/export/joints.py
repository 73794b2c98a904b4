"""What MuJoCo has for the torque on a joint: attributes of the joint, springs in tendons, and what its motor drives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from idtool.reporting.export.base import Part
from idtool.reporting.export.identified import Term


@dataclass
class JointForces:
    """What acts on one joint, in MuJoCo's words.

    Its torque is ctrl + bias − damping v − drag v abs(v) − frictionloss sign(v) − stiffness (q − springref), SI; its
    links are as they are drawn where q = ref.

    Attributes
    ----------
    stops
        Side, position and stiffness of springs that act beyond a position.
    leaks
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
    leaks: dict[str, float] = field(default_factory=dict)

    def attributes(self) -> dict[str, str]:
        """Those of the joint's tag that are not zero."""
        names = ("damping", "frictionloss", "armature", "stiffness", "springref", "ref")
        found = {name: repr(float(getattr(self, name))) for name in names if getattr(self, name)}
        return found | ({"damping": f"{float(self.damping)!r} {float(self.drag)!r}"} if self.drag else {})


class Forces(dict[str, JointForces]):
    """What acts on the joints, by name.

    Parameters
    ----------
    joints
        The joints' names, in the model's order.
    """

    def __init__(self, joints: Sequence[str]) -> None:
        super().__init__({name: JointForces() for name in joints})

    def carry(self, term: Term) -> Part | None:
        """Add a term; None where MuJoCo has nothing like it."""
        carrier = _CARRIERS.get(term.effect)
        detail = carrier(self, term) if carrier else None
        return term.part(detail) if detail else None


def _viscous(forces: Forces, term: Term) -> str:
    forces[term.joint].damping += term.coefficient
    return "damping"


def _drag(forces: Forces, term: Term) -> str:
    forces[term.joint].drag += term.coefficient
    return "the quadratic part of damping"


def _coulomb(forces: Forces, term: Term) -> str | None:
    if term.coefficient < 0:  # MuJoCo would take it for a force along the motion
        return None
    forces[term.joint].frictionloss += term.coefficient
    return "frictionloss"


def _offset(forces: Forces, term: Term) -> str:
    forces[term.joint].bias -= term.coefficient
    return "bias of an actuator, the other way round"


def _spring(forces: Forces, term: Term) -> str:
    joint = forces[term.joint]
    joint.stiffness, joint.springref = term.coefficient, term.shape["rest_position"] + joint.ref
    return f"stiffness, springref {joint.springref:.4g}"


def _stop(forces: Forces, term: Term) -> str:
    joint = forces[term.joint]
    position = term.shape["position"] + joint.ref
    joint.stops.append((term.shape["side"], position, term.coefficient))
    return f"a tendon's spring beyond {position:.4g}"


def _coupling(forces: Forces, term: Term) -> str:
    source = list(forces)[int(term.shape["source"])]
    forces[source].leaks[term.joint] = term.coefficient
    return f"the motor of {source} drives a tendon"


_CARRIERS: Mapping[str, Callable[[Forces, Term], str | None]] = {
    "viscous_friction": _viscous,
    "quadratic_drag": _drag,
    "coulomb_friction": _coulomb,
    "torque_offset": _offset,
    "parallel_spring": _spring,
    "end_stop": _stop,
    "transmission_coupling": _coupling,
}
