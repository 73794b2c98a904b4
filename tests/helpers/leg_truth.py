"""True bodies and friction of the leg of sample_logs: from truth.yaml, from its URDF, or drawn at random.

Importing this file puts sample_logs first on the path, whose scripts it uses.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import mujoco  # type: ignore[import-untyped]
import numpy as np
import yaml
from numpy.typing import NDArray
from paths import SAMPLES

sys.path.insert(0, str(SAMPLES))

import leg
from make import draw_bodies
from two_mass import Body, Friction, prior_links

Array = NDArray[np.float64]

PAPER = leg  # the experiment of the sample logs: its motion, sensors and gears

URDF = SAMPLES / "leg.urdf"
CONFIG: dict[str, Any] = yaml.safe_load((SAMPLES / "leg.yaml").read_text())
JOINTS: tuple[str, ...] = tuple(CONFIG["joints"])
GEAR_RATIO = 10.604


class _Experiment(Protocol):
    """The part of an idtool Experiment that `true_theta` needs."""

    @property
    def equation(self) -> Any: ...


@dataclass(frozen=True)
class Truth:
    """True bodies and friction of the leg.

    Attributes
    ----------
    bodies
        Mass, centre and inertia of every link and rotor, each in its own frame; rotors are balanced.
    friction
        Viscous and Coulomb coefficient of every joint.
    stribeck
        Excess of the breakaway friction over Coulomb friction, by joint [N m].
    stribeck_velocity
        Speed over which this excess decays [rad/s].
    """

    bodies: Mapping[str, Body]
    friction: Mapping[str, Friction]
    stribeck: Mapping[str, float] = field(default_factory=dict)
    stribeck_velocity: float = 0.3

    def parameters(self, body: str) -> Array:
        """m, m c and the inertia about the frame's origin as xx, xy, yy, xz, yz, zz; shape (10,)."""
        m, c, at_com = self.bodies[body].mass, self.bodies[body].com, self.bodies[body].inertia
        inertia = at_com + m * (c @ c * np.eye(3) - np.outer(c, c))
        return np.array([m, *(m * c), *inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])


def _read_truth() -> Truth:
    written = yaml.safe_load((SAMPLES / "truth.yaml").read_text())["leg"]
    bodies = {name: Body.from_config(body) for name, body in written["bodies"].items()}
    return Truth(bodies, {name: Friction(**friction) for name, friction in written["friction"].items()})


TRUTH = _read_truth()


def prior_truth() -> Truth:
    """The leg of the URDF and the configuration."""
    bodies = prior_links(URDF, list(CONFIG["bounding_ellipsoids"]))
    bodies |= {name: Body.from_config(rotor["inertial"]) for name, rotor in CONFIG["rotors"].items()}
    spec = mujoco.MjSpec.from_file(str(URDF))
    joints = {name: spec.joint(name) for name in JOINTS}
    damping = {name: float(np.ravel(joint.damping)[0]) for name, joint in joints.items()}
    return Truth(bodies, {name: Friction(damping[name], float(joints[name].frictionloss)) for name in JOINTS})


def draw_truth(seed: int) -> Truth:
    """Another leg: every body 10 to 30 % from the prior and realizable in its ellipsoid; friction as `TRUTH`'s.

    Seed 1 gives the bodies of `TRUTH`.
    """
    return Truth(draw_bodies(URDF, CONFIG, np.random.default_rng(seed)), TRUTH.friction)


def true_theta(experiment: _Experiment, truth: Truth = TRUTH) -> Array:
    """The true value of every coefficient of an experiment's torque equation, shape (p,).

    Parameters
    ----------
    experiment
        An idtool Experiment with the leg and the rotors of leg.yaml.
    truth
        The true leg.

    Raises
    ------
    KeyError
        If a coefficient belongs to an effect that the leg does not have.
    """
    names = ("m", "mc_x", "mc_y", "mc_z", "I_xx", "I_xy", "I_yy", "I_xz", "I_yz", "I_zz")
    values = {(body, name): x for body in truth.bodies for name, x in zip(names, truth.parameters(body), strict=True)}
    for joint, friction in truth.friction.items():
        values |= {(joint, "viscous"): friction.viscous, (joint, "coulomb"): friction.coulomb, (joint, "offset"): 0.0}
    return np.array([values[c.owner, c.name] for c in experiment.equation.coefficients])
