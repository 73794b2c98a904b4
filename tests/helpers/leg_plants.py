"""The leg of sample_logs in MuJoCo, its rotors behind rigid or elastic gears.

Letters: q [rad], v [rad/s], a [rad/s^2] of the joints abad, hip and knee; tau [N m] at the joint output; each (N, 3).
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco  # type: ignore[import-untyped]
import numpy as np
from leg_motions import RATE, Motion
from leg_truth import CONFIG, GEAR_RATIO, JOINTS, PAPER, URDF, Truth
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from two_mass import STEPS, Body, Friction, build

Array = NDArray[np.float64]

# How fast each rotor spins in all about its axis, its carrier's share included: the knee's motor turns with the thigh.
_SPINS = {"abad_rotor": {"abad": GEAR_RATIO}, "hip_rotor": {"hip": GEAR_RATIO}}
_SPINS["knee_rotor"] = {"hip": 1.0, "knee": GEAR_RATIO}

_STEPS = 4  # of the simulation with rigid gears, a sample
_HARD = 0.9999  # the hardest constraint that MuJoCo knows
_ALMOST_NONE = 1e-8  # share of its spin inertia that a rotor's body keeps, since MuJoCo wants one


@dataclass(frozen=True)
class Plant:
    """A compiled model and how it is driven: ``links`` index the joints, the torques go to ``driven`` by ``to_driven``.

    ``started`` takes joint velocities or positions to all coordinates.
    """

    model: mujoco.MjModel
    links: NDArray[np.int64]
    driven: NDArray[np.int64]
    to_driven: Array
    started: Array
    steps: int


def inverse_dynamics(truth: Truth, motion: Motion) -> Array:
    """Torque (N, 3) that MuJoCo's inverse dynamics asks for with rigid gears, without friction."""
    plant = rigid(Truth(truth.bodies, {name: Friction(0.0, 0.0) for name in JOINTS}))
    data, tau = mujoco.MjData(plant.model), np.zeros_like(motion.q)
    for k, (q, v, a) in enumerate(zip(*motion, strict=True)):
        data.qpos[plant.links], data.qvel[plant.links], data.qacc[plant.links] = q, v, a
        mujoco.mj_inverse(plant.model, data)
        tau[k] = data.qfrc_inverse[plant.links]
    return tau


def rigid(truth: Truth) -> Plant:
    """Rotors as masses on their stators' links, their spin as an armature on a tendon: exact for balanced rotors here.

    The spin is a constant times the joints' velocities, so that it has no gyroscopic torque on any joint.
    """
    spec = mujoco.MjSpec.from_file(str(URDF))
    spec.compiler.fusestatic = False
    spec.option.timestep = 1 / (RATE * _STEPS)
    spec.option.integrator, spec.option.tolerance = mujoco.mjtIntegrator.mjINT_RK4, 1e-10
    # Without the latter, friction would be half as stiff.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT | mujoco.mjtDisableBit.mjDSBL_REFSAFE
    for name in CONFIG["bounding_ellipsoids"]:
        _set_inertia(spec.body(name), truth.bodies[name], truth.bodies[name].inertia)
    for name, rotor in CONFIG["rotors"].items():
        origin, axis, body = rotor["origin"], np.array(rotor["axis"], float), truth.bodies[name]
        turn = Rotation.from_euler("xyz", origin["rpy"]).as_quat(scalar_first=True)
        spin = float(axis @ body.inertia @ axis)
        carried = spec.body(rotor["parent"]).add_body(name=name, pos=origin["xyz"], quat=turn)
        _set_inertia(carried, body, body.inertia - (1 - _ALMOST_NONE) * spin * np.outer(axis, axis))
        tendon = spec.add_tendon(name=name, armature=spin)
        for joint, factor in _SPINS[name].items():
            tendon.wrap_joint(joint, factor)
    model = spec.compile()
    links = np.array([model.joint(name).dofadr[0] for name in JOINTS])
    model.dof_damping[links] = [truth.friction[name].viscous for name in JOINTS]
    model.dof_frictionloss[links] = [truth.friction[name].coulomb for name in JOINTS]
    model.dof_solref[:], model.dof_solimp[:, :2] = [spec.option.timestep, 1.0], _HARD
    return Plant(model, links, links, np.eye(3), np.eye(3)[links], _STEPS)


def elastic(truth: Truth) -> Plant:
    """Rotors of their own behind elastic gears, as in the sample logs."""
    robot = build(URDF, CONFIG, truth.bodies, truth.friction, PAPER.GEAR_STIFFNESS, PAPER.GEAR_DAMPING)
    started = np.zeros((robot.model.nv, 3))
    started[robot.links], started[robot.rotors] = np.eye(3), robot.coupling
    to_motors = np.linalg.inv(robot.coupling.T)
    return Plant(robot.model, robot.links, robot.rotors, to_motors, started, STEPS)


def _set_inertia(target: mujoco.MjsBody, body: Body, inertia: Array) -> None:
    target.explicitinertial, target.mass, target.ipos = True, body.mass, body.com
    target.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
