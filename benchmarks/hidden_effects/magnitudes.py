"""Sizes of hidden effects: `draw_parameters` gives an effect its parameters for a magnitude, along a commanded motion.

An effect that is linear in one coefficient is scaled so that its torque along the command is a share of the joint's rms
torque: 12 % ``strong``, 4 % ``ordinary``, 1 % ``near`` the limit of what can be identified, times a random factor of
0.8 to 1.25. If changed inertial parameters, viscous and Coulomb friction can reproduce more than 60 % of that torque
(rms), it is made larger, up to three times. The other effects have sizes that are usual for machines.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
from numpy.typing import NDArray

from hidden_effects.effects import (
    FRICTION_LEVELS,
    MAGNITUDES,
    MOTOR_CURVES,
    PUSH_FORMS,
    SMOOTH_TORQUES,
    HiddenEffect,
    Parameters,
    end_stop_side,
)
from hidden_effects.motion import Motion, nominal_torque
from hidden_effects.plant import JointState, inverse_dynamics
from hidden_effects.robots import Robot, Truth, rotor, urdf_text

Array = NDArray[np.float64]

_TORQUE_SHARES = {"strong": 0.12, "ordinary": 0.04, "near": 0.01}
_MIN_UNEXPLAINED = 0.4  # share that other bodies and friction leave of an effect; below, the effect is made larger
_MAX_ENLARGEMENT = 3.0
_STRIDE = 20  # samples between those by which that share is computed
_PAYLOADS = {"planar2": 0.7, "leg3": 0.25, "arm6": 2.5}  # kg, strong
_FORCES = {"planar2": 12.0, "leg3": 7.0, "arm6": 25.0}  # N, strong
_RISE_TIMES = (0.05, 0.3)  # s, of a push
_BACKLASHES = {"planar2": 0.012, "leg3": 0.012, "arm6": 0.005}  # rad, strong, for a motor as heavy as its link


@dataclass(frozen=True)
class EffectSize:
    """Everything that the parameters of one hidden effect depend on.

    Attributes
    ----------
    robot, truth
        The robot.
    motion
        The commanded motion with its nominal torque.
    j
        Index of the effect's joint.
    magnitude
        One of `MAGNITUDES`.
    factor
        Random factor of the size.
    is_inertia_fixed
        True if the URDF's inertias are the true ones and known to be so. Otherwise most of an encoder offset looks like
        other inertias, and it is seen by its square only.
    explained
        Orthonormal basis of the torques that other bodies and friction explain; see `_explained_torques`.
    rng
        Source of what is random.
    """

    robot: Robot
    truth: Truth
    motion: JointState
    j: int
    magnitude: str
    factor: float
    is_inertia_fixed: bool
    explained: Array
    rng: np.random.Generator

    def by_magnitude(self, strong: float, ordinary: float, near: float) -> float:
        """The value for the magnitude, times the random factor."""
        return (strong, ordinary, near)[MAGNITUDES.index(self.magnitude)] * self.factor

    def random_sign(self) -> float:
        """1 or −1."""
        return float(self.rng.choice([-1.0, 1.0]))

    def coefficient(self, column: Array) -> float:
        """Coefficient with which a column has the magnitude's share of the joint's rms torque."""
        rms_torque = _rms(self.motion.tau[self.j])
        return self.factor * _TORQUE_SHARES[self.magnitude] * rms_torque / _rms(column)

    def visible_coefficient(self, column: Array, factor: float = 1.0) -> float:
        """`coefficient` times a factor, larger if other bodies and friction explain most of the column."""
        column = np.broadcast_to(column, self.motion.t.shape)
        torques = np.zeros((len(self.motion.q), len(column[::_STRIDE])))
        torques[self.j] = column[::_STRIDE] / _rms(column)
        unexplained = torques.ravel() - self.explained @ (self.explained.T @ torques.ravel())
        share = np.linalg.norm(unexplained) / np.linalg.norm(torques)
        factor *= min(max(_MIN_UNEXPLAINED / share, 1.0), _MAX_ENLARGEMENT)
        return factor * self.coefficient(column)

    def smooth_coefficient(self, effect: str, unit: dict[str, Any], factor: float = 1.0) -> float:
        """`visible_coefficient` of a smooth torque; ``unit``: its parameters with a coefficient of one."""
        column = SMOOTH_TORQUES[effect](unit, self.j, self.motion) + 0 * self.motion.t
        return self.visible_coefficient(column, factor)

    def friction_coefficient(self, effect: str, unit: dict[str, Any]) -> float:
        """`visible_coefficient` of dry friction; ``unit``: its parameters with a coefficient of one."""
        level = FRICTION_LEVELS[effect](unit, self.j, self.motion)
        return self.visible_coefficient(level * np.sign(self.motion.v[self.j]))


def _explained_torques(robot: Robot, motion: JointState) -> Array:
    """Orthonormal basis of the torques that links, rotors, viscous and Coulomb friction explain, at some samples."""
    model = pin.buildModelFromXML(urdf_text(robot))
    data = model.createData()
    n = len(robot.joints)
    rows = np.zeros((n, len(motion.t[::_STRIDE]), 13 * n))
    for k, state in enumerate(zip(motion.q.T[::_STRIDE], motion.v.T[::_STRIDE], motion.a.T[::_STRIDE], strict=True)):
        rows[:, k, : 10 * n] = pin.computeJointTorqueRegressor(model, data, *state)
    for j in range(n):
        columns = (motion.v[j], np.sign(motion.v[j]), motion.a[j])
        for k, column in enumerate(columns):
            rows[j, :, 10 * n + 3 * j + k] = column[::_STRIDE]
    U, size, _ = np.linalg.svd(rows.reshape(-1, 13 * n), full_matrices=False)
    return np.asarray(U[:, size > 1e-9 * size[0]])


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def _viscous_friction(size: EffectSize) -> Parameters:
    return {"viscous": size.coefficient(size.motion.v[size.j])}


def _coulomb_friction(size: EffectSize) -> Parameters:
    return {"coulomb": size.coefficient(np.sign(size.motion.v[size.j]))}


def _stribeck_friction(size: EffectSize) -> Parameters:
    return {
        "stribeck": size.truth.coulomb[size.j] * size.by_magnitude(0.8, 0.4, 0.1),
        "velocity": float(np.exp(size.rng.uniform(np.log(0.06), np.log(0.3)))),
    }


def _load_dependent_friction(size: EffectSize) -> Parameters:
    return {"coefficient": size.friction_coefficient("load_dependent_friction", {"coefficient": 1.0})}


def _quadratic_drag(size: EffectSize) -> Parameters:
    return {"drag": size.smooth_coefficient("quadratic_drag", {"drag": 1.0}, 1.5)}


def _presliding_hysteresis(size: EffectSize) -> Parameters:
    return {
        "amplitude": float(size.truth.coulomb[size.j]),
        "displacement": size.by_magnitude(0.06, 0.02, 0.004),
        "damping": float(size.rng.choice([0.0, 0.02])),
    }


def _torque_offset(size: EffectSize) -> Parameters:
    return {"offset": size.random_sign() * size.smooth_coefficient("torque_offset", {"offset": 1.0})}


def _torque_gain(size: EffectSize) -> Parameters:
    return {"gain": float(1 + size.random_sign() * size.by_magnitude(0.15, 0.05, 0.01))}


def _torque_saturation(size: EffectSize) -> Parameters:
    peak = float(np.abs(size.motion.tau[size.j]).max())
    level = 0.4 * peak
    missing = size.by_magnitude(0.16, 0.07, 0.02) * peak  # of the measured torque, at the peak
    excess = peak - level
    return {"level": level, "bend": 2 * missing / (excess - missing) ** 2}


def _motor_saturation(size: EffectSize, form: str) -> Parameters:
    peak = float(np.abs(size.motion.tau[size.j]).max())
    command = {"command_limit": 1.5 * peak}
    if form == "motor_clip":
        missing = size.by_magnitude(0.2, 0.1, 0.04) * peak  # at the peak
        return {"level": peak - missing, **command}
    span = size.by_magnitude(0.2, 0.1, 0.04) * peak
    return {"level": peak - 1.6 * span, "span": span, **command}


def _torque_ripple(size: EffectSize) -> Parameters:
    travel = np.ptp(size.motion.q[size.j])
    periods = float(size.rng.choice([n for n in (7, 12, 28, 50) if n * travel > 4 * np.pi]))
    unit = {"amplitude": 1.0, "periods": periods, "phase": float(size.rng.uniform(-np.pi, np.pi))}
    return {**unit, "amplitude": size.smooth_coefficient("torque_ripple", unit, 0.7)}


def _parallel_spring(size: EffectSize) -> Parameters:
    middle = float(np.mean(size.motion.q[size.j]))
    rest_position = middle + size.rng.uniform(-0.3, 0.3)
    unit = {"stiffness": 1.0, "rest_position": middle}
    return {"stiffness": size.smooth_coefficient("parallel_spring", unit, 1.2), "rest_position": rest_position}


def _end_stop(size: EffectSize) -> Parameters:
    position = float(np.quantile(size.motion.q[size.j], size.rng.choice([0.12, 0.88])))
    unit = {"stiffness": 1.0, "position": position, "side": end_stop_side(size.robot, size.j, position)}
    return {"stiffness": size.smooth_coefficient("end_stop", unit), "position": position}


def _rotor_inertia(size: EffectSize) -> Parameters:
    return {"inertia": size.coefficient(size.motion.a[size.j])}


def _transmission_coupling(size: EffectSize) -> Parameters:
    neighbours = [name for name in size.robot.names if abs(size.robot.index(name) - size.j) == 1]
    source = str(size.rng.choice(neighbours))
    coefficient = size.visible_coefficient(size.motion.tau[size.robot.index(source)])
    return {"source": source, "coefficient": size.random_sign() * coefficient}


def _friction_drift(size: EffectSize) -> Parameters:
    share = -min(size.by_magnitude(0.7, 0.35, 0.08), 0.85)
    time_constant = float(size.motion.t[-1]) * size.rng.uniform(0.2, 0.4)
    return {
        "viscous": float(share * size.truth.viscous[size.j]),
        "coulomb": float(share * size.truth.coulomb[size.j]),
        "time_constant": time_constant,
    }


def _motor_and_link_inertia(size: EffectSize) -> tuple[float, float]:
    """Inertia of a joint's motor, and of all that it moves in the middle of the motion [kg m^2]."""
    robot, n = size.robot, len(size.robot.joints)
    motor = robot.joints[size.j].reflected_inertia
    q = np.median(size.motion.q, axis=1)[:, None]
    rotors = {joint.name: rotor(joint) for joint in robot.joints}
    acceleration = np.eye(n)[:, [size.j]]
    accelerated = inverse_dynamics(robot, robot.links, rotors, q, 0 * q, acceleration)[size.j, 0]
    at_rest = inverse_dynamics(robot, robot.links, rotors, q, 0 * q, 0 * acceleration)[size.j, 0]
    return motor, float(accelerated - at_rest - motor)


def _transmission(size: EffectSize, stiffness: float, damping_ratio: float) -> dict[str, float]:
    """Parameters of a transmission; with probability 1/2, a share of the friction is on the motor side."""
    share = size.rng.uniform(0.1, 0.9)
    motor_inertia, _ = _motor_and_link_inertia(size)
    damping = 2 * damping_ratio * np.sqrt(stiffness * motor_inertia)
    return {
        "stiffness": stiffness,
        "damping": float(damping),
        "motor_friction": float(size.rng.choice([0.0, share])),
    }


def _joint_elasticity(size: EffectSize) -> Parameters:
    _, link_inertia = _motor_and_link_inertia(size)
    locked_motor_frequency = size.by_magnitude(11.0, 20.0, 45.0)  # Hz, of the link
    return _transmission(size, (2 * np.pi * locked_motor_frequency) ** 2 * link_inertia, 0.05)


def _backlash(size: EffectSize) -> Parameters:
    motor, link = _motor_and_link_inertia(size)
    width = _BACKLASHES[size.robot.name] * motor / link * size.by_magnitude(1.0, 0.33, 0.08)
    stiffness = (2 * np.pi * 150) ** 2 * motor * link / (motor + link)
    return {"width": width, **_transmission(size, stiffness, 0.3)}


def _encoder_offset(size: EffectSize) -> Parameters:
    sign = size.random_sign()
    if size.is_inertia_fixed:
        return {"offset": sign * size.by_magnitude(0.12, 0.04, 0.008)}
    return {"offset": sign * size.by_magnitude(0.25, 0.12, 0.04)}


def _time_delay(size: EffectSize) -> Parameters:
    return {"delay": size.by_magnitude(0.010, 0.004, 0.0008)}


def _gravity_tilt(size: EffectSize) -> Parameters:
    angle = np.deg2rad(size.by_magnitude(6.0, 2.0, 0.25))
    direction = size.rng.uniform(-np.pi, np.pi)
    if size.robot.name == "planar2":
        direction = float(size.rng.choice([0.0, np.pi]))  # a tilt out of its plane has no effect
    horizontal = np.sin(angle) * np.array([np.cos(direction), np.sin(direction)])
    return {"gravity": [*(9.81 * horizontal).tolist(), float(-9.81 * np.cos(angle))]}


def _payload(size: EffectSize) -> Parameters:
    mass = _PAYLOADS[size.robot.name] * size.by_magnitude(1.0, 0.3, 0.03)
    semi_axes = size.rng.uniform(0.03, 0.08, 3)  # of a homogeneous ellipsoid
    xx, yy, zz = mass / 5 * np.square(semi_axes)  # its second moments
    com = 0.1 * size.rng.uniform(-1, 1, 3) + size.robot.links[size.robot.joints[-1].child].com
    return {"mass": mass, "com": com.tolist(), "inertia": [yy + zz, 0.0, xx + zz, 0.0, 0.0, xx + yy]}


def _external_contact(size: EffectSize) -> Parameters:
    magnitude = _FORCES[size.robot.name] * size.by_magnitude(1.0, 0.35, 0.08)
    seconds = float(size.motion.t[-1])
    force, moment = size.rng.normal(size=(2, 3))
    if size.robot.name == "planar2":
        force[1] = moment[0] = moment[2] = 0.0
    force = magnitude * force / np.linalg.norm(force)
    moment = 0.05 * magnitude * moment / np.linalg.norm(moment)
    starts = seconds * (np.array([0.1, 0.45, 0.78]) + size.rng.uniform(0, 0.08, 3))
    lengths = seconds * size.rng.uniform(0.05, 0.1, 3)
    return {
        "windows": np.round(np.transpose([starts, starts + lengths]), 3).tolist(),
        "wrench": [*force.tolist(), *moment.tolist()],
    }


def _push(size: EffectSize, form: str, link: str) -> Parameters:
    """A force along a constant direction at a point of a link: three long pushes, or six short ones."""
    magnitude = _FORCES[size.robot.name] * size.by_magnitude(1.5, 0.5, 0.1)
    seconds = float(size.motion.t[-1])
    direction = size.rng.normal(size=3)
    if size.robot.name == "planar2":
        direction[1] = 0.0
    force = magnitude * direction / np.linalg.norm(direction)
    rise_time = float(size.rng.uniform(*_RISE_TIMES))
    if form == "half_sine_push":
        starts = seconds * (np.array([0.08, 0.25, 0.42, 0.59, 0.76, 0.9]) + size.rng.uniform(0, 0.05, 6))
        lengths = np.full(6, 2 * rise_time)
    else:
        starts = seconds * (np.array([0.1, 0.45, 0.78]) + size.rng.uniform(0, 0.08, 3))
        lengths = seconds * size.rng.uniform(0.05, 0.1, 3)
    return {
        "windows": np.round(np.transpose([starts, starts + lengths]), 3).tolist(),
        "wrench": [*force.tolist(), 0.0, 0.0, 0.0],
        "point": (size.robot.links[link].com + size.rng.uniform(-0.05, 0.05, 3)).tolist(),
        "rise_time": rise_time,
    }


def _unknown(size: EffectSize, form: str) -> Parameters:
    """Parameters of an effect that idtool does not have; numbers are drawn for all forms, whichever is asked for."""
    rng, q = size.rng, size.motion.q[size.j]
    seconds, middle = float(size.motion.t[-1]), float(np.mean(q))
    unit: dict[str, Any] = {
        "dead_zone": {"position": middle, "width": 0.3 * np.std(q), "frequency": rng.uniform(0.15, 0.4)},
        "vibration": {"frequency": rng.uniform(2.8, 6.0), "phase": rng.uniform(0, 6.0)},
        "viscosity_by_position": {"position": middle},
        "wandering": {"seed": int(rng.integers(1000)), "seconds": seconds, "scale": rng.uniform(0.3, 0.8)},
        "steps": {"seed": int(rng.integers(1000)), "seconds": seconds, "scale": rng.uniform(0.4, 1.0)},
        "friction_by_position": {"periods": rng.uniform(3.0, 6.0), "phase": rng.uniform(0, 6.0)},
    }[form]
    unit = {name: float(x) if isinstance(x, np.floating) else x for name, x in unit.items()}
    unit["size"] = 1.0
    if form == "friction_by_position":
        coefficient = size.friction_coefficient(form, unit)
    elif form in ("wandering", "steps"):
        coefficient = size.coefficient(np.ones(1))  # these signals have unit size
    else:
        coefficient = size.smooth_coefficient(form, unit)
    return {"form": form, **unit, "size": coefficient}


_PARAMETERS: dict[str, Callable[[EffectSize], Parameters]] = {
    "viscous_friction": _viscous_friction,
    "coulomb_friction": _coulomb_friction,
    "stribeck_friction": _stribeck_friction,
    "load_dependent_friction": _load_dependent_friction,
    "quadratic_drag": _quadratic_drag,
    "presliding_hysteresis": _presliding_hysteresis,
    "torque_offset": _torque_offset,
    "torque_gain": _torque_gain,
    "torque_saturation": _torque_saturation,
    "torque_ripple": _torque_ripple,
    "parallel_spring": _parallel_spring,
    "end_stop": _end_stop,
    "rotor_inertia": _rotor_inertia,
    "backlash": _backlash,
    "joint_elasticity": _joint_elasticity,
    "transmission_coupling": _transmission_coupling,
    "encoder_offset": _encoder_offset,
    "time_delay": _time_delay,
    "gravity_tilt": _gravity_tilt,
    "payload": _payload,
    "external_contact": _external_contact,
    "friction_drift": _friction_drift,
}

EFFECTS = tuple(_PARAMETERS)


def draw_parameters(
    robot: Robot,
    truth: Truth,
    hidden: tuple[HiddenEffect, ...],
    motion: Motion,
    seed: int,
    is_inertia_fixed: bool,
) -> tuple[HiddenEffect, ...]:
    """Draw the parameters of hidden effects; parameters that are given are kept."""
    command = JointState(motion.t, motion.q, motion.v, motion.a, nominal_torque(robot, motion))
    explained = _explained_torques(robot, command)
    effects = []
    for k, effect in enumerate(hidden):
        rng = np.random.default_rng([seed, 14, k])
        j = 0 if effect.joint is None else robot.index(effect.joint)
        factor = float(np.exp(rng.uniform(-0.22, 0.22)))
        size = EffectSize(robot, truth, command, j, effect.magnitude, factor, is_inertia_fixed, explained, rng)
        form = effect.parameters.get("form")
        if form in MOTOR_CURVES:
            parameters = _motor_saturation(size, form)
        elif form in PUSH_FORMS:
            parameters = _push(size, form, str(effect.link))
        elif effect.effect == "unknown":
            parameters = _unknown(size, str(form))
        else:
            parameters = _PARAMETERS[effect.effect](size)
        effects.append(replace(effect, parameters={**parameters, **effect.parameters}))
    return tuple(effects)
