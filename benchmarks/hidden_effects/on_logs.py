"""Effects that are added to the logs of a robot: torques along the logged motion, and changes of the positions.

`PARAMETERS` draws the parameters of an effect. `added_signals` computes what several effects together add to a log. The
torque is that of Pinocchio and of the formulas in `hidden_effects.effects`.

An effect that is linear in a coefficient gets a torque of 5 times the model's RMS error at its joint, times a random
factor of 0.7 to 1.4, but at most a quarter of the joint's RMS torque. The others have sizes that are usual for
machines.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
from numpy.typing import NDArray

from hidden_effects.effects import FRICTION_LEVELS, SMOOTH_TORQUES, saturated_torque
from hidden_effects.friction import advance_bristle

Array = NDArray[np.float64]
Parameters = dict[str, Any]
EffectKey = tuple[str, str | None]  # effect, and the joint or link that it acts on

RATE = 1000.0  # Hz, of the motions
_SIZE = 5.0  # ratio of an added torque to the model's error
_MAX_SHARE = 0.25  # ratio of an added torque to the joint's rms torque
_MAX_DEFLECTION = 0.05  # rad, of a soft joint
_VELOCITY_WIDTH = 0.01  # rad/s, in which friction changes its sign


@dataclass(frozen=True)
class Motion:
    """Smoothed motion and torque of a robot's n joints at N times.

    Attributes
    ----------
    t
        Time since the log's first sample, shape (N,) [s].
    q, v, a
        Position, velocity and acceleration, shape (n, N) [rad, rad/s, rad/s^2].
    tau
        Torque of the actuators, shape (n, N) [N m].
    is_diagnosed
        True for the log that is diagnosed, False for the one to validate.
    """

    t: Array
    q: Array
    v: Array
    a: Array
    tau: Array
    is_diagnosed: bool


@dataclass(frozen=True)
class HiddenEffect:
    """An effect that is added to a robot's logs.

    Attributes
    ----------
    effect
        Its id.
    joint
        Index of its joint; None: it acts on a link or on the whole robot.
    target
        Name of the joint or link; None: the whole robot.
    parameters
        Its parameters, with idtool's names where idtool has them.
    """

    effect: str
    joint: int | None
    target: str | None
    parameters: Parameters

    @property
    def key(self) -> EffectKey:
        """Effect and location."""
        return self.effect, self.target


@dataclass(frozen=True)
class Situation:
    """Robot, motion and joint for which the parameters of an effect are drawn.

    Attributes
    ----------
    model
        The robot's rigid bodies.
    motion
        Motion of the log that is diagnosed.
    joint
        Index of the joint, unless the effect has none.
    model_error
        RMS error of the identified model at each joint, shape (n,) [N m].
    payload_mass, push_force
        Typical mass of a payload [kg], and force of a push [N].
    rng
        Source of what is random.
    """

    model: pin.Model
    motion: Motion
    joint: int
    model_error: Array
    payload_mass: float
    push_force: float
    rng: np.random.Generator

    @property
    def q(self) -> Array:
        """Position of the joint, shape (N,) [rad]."""
        return self.motion.q[self.joint]

    @property
    def travel(self) -> float:
        """Travel of the joint [rad]."""
        return float(np.ptp(self.q))

    @property
    def tau(self) -> Array:
        """Torque of the joint, shape (N,) [N m]."""
        return self.motion.tau[self.joint]

    def random_sign(self) -> float:
        """1 or −1."""
        return float(self.rng.choice([-1.0, 1.0]))

    def coefficient(self, torque_per_unit: Array) -> float:
        """Random coefficient that gives a torque, shape (N,), the RMS of a hidden effect."""
        size = _SIZE * float(np.exp(self.rng.uniform(-0.35, 0.35))) * self.model_error[self.joint]
        size = min(size, _MAX_SHARE * rms(self.tau))
        return size / rms(torque_per_unit)


def rms(x: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(x))))


def direction(motion: Motion, joint: int) -> Array:
    """Direction of a joint's motion, shape (N,): −1 to 1, and 0 at rest."""
    return np.tanh(motion.v[joint] / _VELOCITY_WIDTH)


# Torques on the effect's own joint, shape (N,): functions of parameters, joint and motion.


def friction_torque(effect: str, p: Parameters, joint: int, motion: Motion) -> Array:
    """Dry friction with a level that varies."""
    return FRICTION_LEVELS[effect](p, joint, motion) * direction(motion, joint)


def smooth_torque(effect: str, p: Parameters, joint: int, motion: Motion) -> Array:
    """Torque that is a smooth function of state and time."""
    return np.asarray(SMOOTH_TORQUES[effect](p, joint, motion))


def presliding_torque(p: Parameters, joint: int, motion: Motion) -> Array:
    """Dahl's friction, in addition to the joint's own."""
    bristle = np.zeros_like(motion.t)
    z = 0.0
    for k, v in enumerate(motion.v[joint]):
        _, z = advance_bristle(z, v, p["displacement"], 1 / RATE)
        bristle[k] = z
    return p["amplitude"] * bristle


def rotor_torque(p: Parameters, joint: int, motion: Motion) -> Array:
    """Torque that accelerates a rotor."""
    return p["inertia"] * motion.a[joint]


def gain_torque(p: Parameters, joint: int, motion: Motion) -> Array:
    """Measured less true torque of a sensor with a wrong gain."""
    return (p["gain"] - 1) * motion.tau[joint]


def saturation_torque(p: Parameters, joint: int, motion: Motion) -> Array:
    """Measured less true torque of a sensor that saturates."""
    tau = motion.tau[joint]
    return saturated_torque(tau, p["level"], p["bend"]) - tau


def delay_torque(p: Parameters, joint: int, motion: Motion) -> Array:
    """Late less present torque."""
    tau = motion.tau[joint]
    return np.interp(motion.t - p["delay"], motion.t, tau) - tau


JOINT_TORQUES: dict[str, Callable[[Parameters, int, Motion], Array]] = {
    "stribeck_friction": partial(friction_torque, "stribeck_friction"),
    "load_dependent_friction": partial(friction_torque, "load_dependent_friction"),
    "quadratic_drag": partial(smooth_torque, "quadratic_drag"),
    "torque_ripple": partial(smooth_torque, "torque_ripple"),
    "parallel_spring": partial(smooth_torque, "parallel_spring"),
    "end_stop": partial(smooth_torque, "end_stop"),
    "transmission_coupling": partial(smooth_torque, "transmission_coupling"),
    "friction_drift": partial(smooth_torque, "friction_drift"),
    "presliding_hysteresis": presliding_torque,
    "rotor_inertia": rotor_torque,
    "torque_gain": gain_torque,
    "torque_saturation": saturation_torque,
    "time_delay": delay_torque,
}

# Torques on all joints, shape (n, N): functions of parameters, link, model and motion.


def inverse_dynamics(model: pin.Model, motion: Motion) -> Array:
    """Torque that rigid bodies need for a motion, shape (n, N)."""
    data = model.createData()
    states = zip(motion.q.T, motion.v.T, motion.a.T, strict=True)
    return np.stack([pin.rnea(model, data, q, v, a) for q, v, a in states], axis=1)


def tilt_torque(p: Parameters, link: str | None, model: pin.Model, motion: Motion) -> Array:
    """Change of the torque with the direction of gravity."""
    tilted = model.copy()
    tilted.gravity.linear = np.array(p["gravity"])
    return inverse_dynamics(tilted, motion) - inverse_dynamics(model, motion)


def payload_torque(p: Parameters, link: str | None, model: pin.Model, motion: Motion) -> Array:
    """Torque that a body on a link needs."""
    loaded = model.copy()
    frame = loaded.frames[loaded.getFrameId(link)]
    xx, xy, yy, xz, yz, zz = p["inertia"]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    body = pin.Inertia(p["mass"], np.array(p["com"]), inertia)
    loaded.appendBodyToJoint(frame.parentJoint, body, frame.placement)
    return inverse_dynamics(loaded, motion) - inverse_dynamics(model, motion)


def contact_torque(p: Parameters, link: str | None, model: pin.Model, motion: Motion) -> Array:
    """Torque against a force that pushes the link's centre of mass in the log that is diagnosed."""
    torque = np.zeros_like(motion.tau)
    if not motion.is_diagnosed:
        return torque
    data = model.createData()
    frame_index = model.getFrameId(link)
    frame = model.frames[frame_index]
    center = frame.placement.actInv(model.inertias[frame.parentJoint].lever)
    force = np.array(p["force"])
    for begin, end in p["windows"]:
        share = np.clip(np.minimum(motion.t - begin, end - motion.t) / p["rise_time"], 0, 1)
        for k in np.flatnonzero(share):
            J = pin.computeFrameJacobian(model, data, motion.q[:, k], frame_index, pin.LOCAL_WORLD_ALIGNED)
            pin.updateFramePlacement(model, data, frame_index)
            arm = data.oMf[frame_index].rotation @ center
            torque[:, k] -= share[k] * J.T @ np.concatenate([force, np.cross(arm, force)])
    return torque


WHOLE_TORQUES: dict[str, Callable[[Parameters, str | None, pin.Model, Motion], Array]] = {
    "gravity_tilt": tilt_torque,
    "payload": payload_torque,
    "external_contact": contact_torque,
}

# Changes of the measured position of the effect's own joint, shape (N,).


def offset_position(p: Parameters, joint: int, motion: Motion) -> Array:
    """Measured less true position of an encoder with an offset."""
    return np.full_like(motion.t, -p["offset"])


def elastic_deflection(p: Parameters, joint: int, motion: Motion) -> Array:
    """Position of the motor, which is measured, less that of the link."""
    return motion.tau[joint] / p["stiffness"]


POSITIONS: dict[str, Callable[[Parameters, int, Motion], Array]] = {
    "encoder_offset": offset_position,
    "joint_elasticity": elastic_deflection,
}

EFFECTS = (*JOINT_TORQUES, *WHOLE_TORQUES, *POSITIONS)
SENSOR_EFFECTS = ("torque_gain", "torque_saturation", "time_delay")  # they act on the torque of all others

# Parameters


def scaled(s: Situation, effect: str, coefficient: str, **others: Any) -> Parameters:
    """Parameters of an effect that is linear in a coefficient."""
    torque_per_unit = JOINT_TORQUES[effect]({coefficient: 1.0, **others}, s.joint, s.motion)
    return {coefficient: s.coefficient(torque_per_unit), **others}


def stribeck_parameters(s: Situation) -> Parameters:
    """Stribeck friction that the slow part of the motion shows."""
    speed = np.abs(s.motion.v[s.joint])
    moving = speed[speed > _VELOCITY_WIDTH]
    velocity = max(float(np.quantile(moving, 0.25)), 2 * _VELOCITY_WIDTH)
    return scaled(s, "stribeck_friction", "stribeck", velocity=velocity)


def ripple_parameters(s: Situation) -> Parameters:
    """Ripple with three to six periods over the travel."""
    periods = float(np.ceil(s.rng.uniform(3, 6) * 2 * np.pi / s.travel))
    return scaled(s, "torque_ripple", "amplitude", periods=periods, phase=float(s.rng.uniform(-3, 3)))


def spring_parameters(s: Situation) -> Parameters:
    """Spring that rests near the middle of the travel."""
    rest_position = float(np.mean(s.q) + s.rng.uniform(-0.3, 0.3) * s.travel)
    return scaled(s, "parallel_spring", "stiffness", rest_position=rest_position)


def stop_parameters(s: Situation) -> Parameters:
    """Stop at one end of the travel, wherever the joint's limits are."""
    side = s.random_sign()
    position = float(np.quantile(s.q, 0.85 if side > 0 else 0.15))
    return scaled(s, "end_stop", "stiffness", position=position, side=side)


def coupling_parameters(s: Situation) -> Parameters:
    """Coupling from a neighbour in the kinematic tree."""
    own = s.joint + 1  # in Pinocchio's numbering, in which 0 is the base
    parent = s.model.parents[own]
    neighbours = [j for j in range(1, s.model.njoints) if s.model.parents[j] == own]
    neighbours += [parent] if parent else []
    source = int(s.rng.choice(neighbours))
    parameters = scaled(s, "transmission_coupling", "coefficient", source_index=source - 1)
    sign = s.random_sign()
    return {**parameters, "coefficient": sign * parameters["coefficient"], "source": s.model.names[source]}


def drift_parameters(s: Situation) -> Parameters:
    """Viscous friction that rises in the first third of the log."""
    return scaled(s, "friction_drift", "viscous", time_constant=0.3 * float(s.motion.t[-1]))


def gain_parameters(s: Situation) -> Parameters:
    """Gain above or below 1."""
    return {"gain": 1 + s.random_sign() * s.coefficient(s.tau)}


def saturation_parameters(s: Situation) -> Parameters:
    """Sensor that lacks 15 % of the torque at its peak."""
    peak = float(np.abs(s.tau).max())
    level = 0.4 * peak
    missing = 0.15 * peak
    return {"level": level, "bend": 2 * missing / (peak - level - missing) ** 2}


def elasticity_parameters(s: Situation) -> Parameters:
    """Joint whose link swings at 5 to 8 Hz while the motor is locked, but does not deflect by more than 0.05 rad."""
    posture = np.median(s.motion.q, axis=1)
    inertia = float(pin.crba(s.model, s.model.createData(), posture)[s.joint, s.joint])
    stiffness = (2 * np.pi * s.rng.uniform(5, 8)) ** 2 * inertia
    return {"stiffness": max(stiffness, float(np.abs(s.tau).max()) / _MAX_DEFLECTION)}


def tilt_parameters(s: Situation) -> Parameters:
    """Base that is 2 to 5 degrees off."""
    angle = np.deg2rad(s.rng.uniform(2, 5))
    heading = s.rng.uniform(-np.pi, np.pi)
    horizontal = np.sin(angle) * np.array([np.cos(heading), np.sin(heading)])
    return {"gravity": [*(9.81 * horizontal).tolist(), float(-9.81 * np.cos(angle))]}


def payload_parameters(s: Situation) -> Parameters:
    """Ball of 5 cm radius near the link's origin."""
    mass = s.payload_mass * float(s.rng.uniform(0.7, 1.4))
    moment = 0.4 * mass * 0.05**2
    return {
        "mass": mass,
        "com": s.rng.uniform(-0.05, 0.05, 3).tolist(),
        "inertia": [moment, 0.0, moment, 0.0, 0.0, moment],
    }


def contact_parameters(s: Situation) -> Parameters:
    """Three pushes of about a second with the same force."""
    force = s.rng.normal(size=3)
    force *= s.push_force / np.linalg.norm(force)
    begins = float(s.motion.t[-1]) * (np.array([0.12, 0.4, 0.75]) + s.rng.uniform(0, 0.05, 3))
    ends = begins + s.rng.uniform(0.6, 1.2, 3)
    windows = np.round(np.transpose([begins, ends]), 3).tolist()
    return {"windows": windows, "force": force.tolist(), "rise_time": float(s.rng.uniform(0.02, 0.15))}


PARAMETERS: dict[str, Callable[[Situation], Parameters]] = {
    "stribeck_friction": stribeck_parameters,
    "load_dependent_friction": lambda s: scaled(s, "load_dependent_friction", "coefficient"),
    "quadratic_drag": lambda s: scaled(s, "quadratic_drag", "drag"),
    "torque_ripple": ripple_parameters,
    "parallel_spring": spring_parameters,
    "end_stop": stop_parameters,
    "transmission_coupling": coupling_parameters,
    "friction_drift": drift_parameters,
    "presliding_hysteresis": lambda s: scaled(s, "presliding_hysteresis", "amplitude", displacement=0.02 * s.travel),
    "rotor_inertia": lambda s: scaled(s, "rotor_inertia", "inertia"),
    "torque_gain": gain_parameters,
    "torque_saturation": saturation_parameters,
    "time_delay": lambda s: {"delay": float(s.rng.uniform(0.004, 0.010))},
    "gravity_tilt": tilt_parameters,
    "payload": payload_parameters,
    "external_contact": contact_parameters,
    "encoder_offset": lambda s: {"offset": s.random_sign() * float(s.rng.uniform(0.04, 0.1))},
    "joint_elasticity": elasticity_parameters,
}


def added_signals(hidden: Sequence[HiddenEffect], model: pin.Model, motion: Motion) -> tuple[Array, Array]:
    """Torque and position that effects together add to the logged ones, shape (n, N) each."""
    torque = np.zeros_like(motion.tau)
    position = np.zeros_like(motion.q)
    for one in sorted(hidden, key=lambda one: one.effect in SENSOR_EFFECTS):
        present = replace(motion, tau=motion.tau + torque)
        if one.effect in WHOLE_TORQUES:
            torque += WHOLE_TORQUES[one.effect](one.parameters, one.target, model, present)
        elif one.effect in JOINT_TORQUES:
            torque[one.joint] += JOINT_TORQUES[one.effect](one.parameters, one.joint, present)
        else:
            position[one.joint] += POSITIONS[one.effect](one.parameters, one.joint, present)
    return torque, position
