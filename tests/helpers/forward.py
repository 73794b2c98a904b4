"""Mechanisms for tests of forward dynamics, and how to run them.

Shapes: nv joints, W rollouts, N samples. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import yaml
from commands import SAMPLES
from numpy.typing import NDArray
from robots import actuated

from idtool.dynamics.effects import build_effects
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.regressor import LinearModel
from idtool.dynamics.simulation.forces import InputTorqueFunction
from idtool.dynamics.simulation.rollouts import Rollouts
from idtool.robot.config import parse_config
from idtool.robot.model import build_model
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]

LEG = (SAMPLES / "leg.urdf").read_text()
LEG_JOINTS = ("abad", "hip", "knee")
LEG_ROTORS = yaml.safe_load((SAMPLES / "leg.yaml").read_text())["rotors"]
# How fast the rotors spin about their axes, the carrier's share included: the hip's axis is the knee motor's.
LEG_SPINS = {"abad_rotor": {"abad": 10.604}, "hip_rotor": {"hip": 10.604}, "knee_rotor": {"hip": 1.0, "knee": 10.604}}
NO_FRICTION = {"viscous": False, "coulomb": False}


def mechanism(robot: Robot, config: Mapping[str, Any], names: Sequence[str] | None = None) -> Mechanism:
    """The mechanism of a robot with a configuration, with prior coefficients."""
    parsed = parse_config(dict(config), "")
    model = build_model(robot, parsed, names or actuated(robot))
    linear = LinearModel(model.names, build_effects(model, parsed))
    return linear.mechanism(model, linear.prior)


def friction(names: Sequence[str], viscous: Sequence[float], coulomb: Sequence[float]) -> dict[str, Any]:
    """The configuration's `friction`."""
    return {
        name: {"viscous": float(b), "coulomb": float(c)} for name, b, c in zip(names, viscous, coulomb, strict=True)
    }


def run_rollouts(
    mechanism: Mechanism, q: Array, v: Array, input_torque: InputTorqueFunction, samples: Array, **options: float
) -> tuple[Array, Array]:
    """Positions and velocities of rollouts from states (nv, W), or (nv,) of one, at common times; (nv, W, N) each."""
    q, v = (np.asarray(x, float).reshape(len(x), -1) for x in (q, v))
    rollouts = Rollouts(mechanism, np.full(q.shape[1], samples[0]), q, v, input_torque, **options)
    states = [(rollouts.q.copy(), rollouts.v.copy())]
    for sample in samples[1:]:
        rollouts.advance(np.full(q.shape[1], sample))
        states.append((rollouts.q.copy(), rollouts.v.copy()))
    both = np.array(states)
    return np.moveaxis(both[:, 0], 0, -1), np.moveaxis(both[:, 1], 0, -1)


def zero_torque(t: Array, q: Array, v: Array, rollout_ids: NDArray[np.intp]) -> Array:
    """Zero torque at all times."""
    return np.zeros_like(q)


def torque_of_time(torque: Callable[[Array], Array]) -> InputTorqueFunction:
    """Input torque that is a function of time only, shape (nv, N) at times (N,)."""
    return lambda t, q, v, rollout_ids: torque(t)


def torque_of_one_state(input_torque: InputTorqueFunction) -> Callable[[float, Array, Array], Array]:
    """An input torque for a single state, shape (nv,)."""
    return lambda t, q, v: input_torque(np.array([t]), q[:, None], v[:, None], np.zeros(1, dtype=np.intp))[:, 0]


def sliders(*masses: float, slope: float = 0.0, carried: bool = False) -> str:
    """Masses on rails along x, independent or each on the one before; the rails fall by a slope [rad]."""
    parts = ['<robot name="sliders"><link name="m0"/>']
    for i, mass in enumerate(masses, start=1):
        tilt = slope if i == 1 or not carried else 0.0
        parts.append(
            f'<link name="m{i}"><inertial><mass value="{mass}"/>'
            '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="x{i}" type="prismatic"><parent link="m{i - 1 if carried else 0}"/><child link="m{i}"/>'
            f'<origin rpy="0 {tilt} 0"/><axis xyz="1 0 0"/>'
            '<limit lower="-100" upper="100" effort="100" velocity="100"/></joint>'
        )
    return "".join([*parts, "</robot>"])


def hinge(inertia: float, mass: float = 0.0, length: float = 0.0) -> str:
    """A pendulum on joint x1 about y, a mass at its end below the hinge beside the inertia about it."""
    return (
        f'<robot name="hinge"><link name="m0"/><link name="m1"><inertial><origin xyz="0 0 {-length}"/>'
        f'<mass value="{mass or 1e-3}"/><inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" '
        'iyz="0"/></inertial></link><joint name="x1" type="revolute"><parent link="m0"/><child link="m1"/>'
        '<axis xyz="0 1 0"/><limit lower="-100" upper="100" effort="100" velocity="100"/></joint></robot>'
    )
