"""Effects that a model can lack, as physics: those of idtool, with its parameters, and some that idtool does not know.

`apply_effects` turns hidden effects into what they change: bodies and friction (`Truth`), forces (`AddedPhysics`) and
sensors (`SensorErrors`). `config_omissions` lists what the configuration must leave out because of them.

Signs: a torque here resists; it is what the actuator has to give in addition to the torque of the rigid bodies.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from hidden_effects.friction import advance_bristle
from hidden_effects.plant import AddedPhysics, Contact, JointState, Transmission
from hidden_effects.robots import Body, Robot, Truth, rotor

Array = NDArray[np.float64]
Parameters = Mapping[str, Any]
TorqueForm = Callable[[Parameters, int, JointState], Array]  # parameters, joint index, state

MAGNITUDES = ("strong", "ordinary", "near")


@dataclass(frozen=True)
class HiddenEffect:
    """An effect on a joint, a link, or the whole robot; without parameters, they are drawn for the magnitude."""

    effect: str
    joint: str | None = None
    link: str | None = None
    magnitude: str = "strong"
    parameters: Parameters = field(default_factory=dict)

    @property
    def location(self) -> str:
        """Joint or link, or ``all``."""
        return self.joint or self.link or "all"


@dataclass
class SensorErrors:
    """Errors of the sensors.

    Attributes
    ----------
    torque_delay
        By which the torque is recorded late, shape (n,) [s].
    position_offset
        True less measured position, shape (n,) [rad].
    torque_maps
        Joint indices, and functions from the true to the measured torque.
    """

    torque_delay: Array
    position_offset: Array
    torque_maps: list[tuple[int, Callable[[Array], Array]]] = field(default_factory=list)


def _completed_drift(p: Parameters, state: JointState) -> Array:
    """Share of a drift that has taken place."""
    return np.asarray(1 - np.exp(-np.asarray(state.t) / p["time_constant"]))


def _dead_zone(p: Parameters, j: int, state: JointState) -> Array:
    """Spring outside of a dead zone, whose stiffness varies with time."""
    distance = state.q[j] - p["position"]
    beyond = distance - np.clip(distance, -p["width"], p["width"])
    return np.asarray(p["size"] * beyond * (1 + 0.8 * np.sin(2 * np.pi * p["frequency"] * np.asarray(state.t))))


def _end_stop(p: Parameters, j: int, state: JointState) -> Array:
    penetration = np.maximum(p["side"] * (state.q[j] - p["position"]), 0.0)
    return np.asarray(p["stiffness"] * p["side"] * penetration)


def _vibration(p: Parameters, j: int, state: JointState) -> Array:
    return np.asarray(p["size"] * np.sin(2 * np.pi * p["frequency"] * np.asarray(state.t) + p["phase"]))


def _friction_by_position(p: Parameters, j: int, state: JointState) -> Array:
    return np.asarray(p["size"] * (1 + np.sin(p["periods"] * state.q[j] + p["phase"])) / 2)


# Torques that are smooth functions of state and time.
SMOOTH_TORQUES: dict[str, TorqueForm] = {
    "quadratic_drag": lambda p, j, state: p["drag"] * state.v[j] * np.abs(state.v[j]),
    "torque_offset": lambda p, j, state: p["offset"] + 0 * state.v[j],
    "torque_ripple": lambda p, j, state: p["amplitude"] * np.sin(p["periods"] * state.q[j] + p["phase"]),
    "parallel_spring": lambda p, j, state: p["stiffness"] * (state.q[j] - p["rest_position"]),
    "end_stop": _end_stop,
    "transmission_coupling": lambda p, j, state: -p["coefficient"] * state.tau[p["source_index"]],
    "friction_drift": lambda p, j, state: p["viscous"] * state.v[j] * _completed_drift(p, state),
    "dead_zone": _dead_zone,
    "vibration": _vibration,
    "viscosity_by_position": lambda p, j, state: p["size"] * np.sin(state.q[j] - p["position"]) * state.v[j],
    "wandering": lambda p, j, state: p["size"] * p["signal"](state.t),
    "steps": lambda p, j, state: p["size"] * p["signal"](state.t),
}

# Levels of dry friction.
FRICTION_LEVELS: dict[str, TorqueForm] = {
    "stribeck_friction": lambda p, j, state: p["stribeck"] * np.exp(-np.square(state.v[j] / p["velocity"])),
    "load_dependent_friction": lambda p, j, state: p["coefficient"] * np.abs(state.tau[j]),
    "friction_drift": lambda p, j, state: p["coulomb"] * _completed_drift(p, state),
    "friction_by_position": _friction_by_position,
}


def _clipped(p: Parameters, commanded: float) -> float:
    return float(np.clip(commanded, -p["level"], p["level"]))


def _bent(p: Parameters, commanded: float) -> float:
    """True torque of a motor that saturates smoothly: ``span`` is the most that it can give above the level."""
    excess = abs(commanded) - p["level"]
    if excess <= 0:
        return commanded
    return float(np.sign(commanded) * (p["level"] + p["span"] * np.tanh(excess / p["span"])))


# Motors that give less than their command, which is logged; forms of the effect ``torque_saturation``.
MOTOR_CURVES: dict[str, Callable[[Parameters, float], float]] = {"motor_clip": _clipped, "motor_tanh": _bent}


def with_stronger_motors(hidden: tuple[HiddenEffect, ...], factor: float) -> tuple[HiddenEffect, ...]:
    """Hidden effects with motors that saturate at torques larger by a factor."""
    effects = []
    for effect in hidden:
        if effect.parameters.get("form") in MOTOR_CURVES:
            larger = {name: factor * effect.parameters[name] for name in ("level", "span") if name in effect.parameters}
            effects.append(replace(effect, parameters={**effect.parameters, **larger}))
        else:
            effects.append(effect)
    return tuple(effects)


# Pushes on a link, off its frame's origin; forms of the effect ``external_contact``.
PUSH_FORMS = ("trapezoid_push", "half_sine_push")

# Effects that idtool does not have: each is an ``unknown`` with this ``form``.
UNKNOWN_FORMS = ("dead_zone", "vibration", "viscosity_by_position", "wandering", "steps", "friction_by_position")


class PreslidingFriction:
    """Dahl's friction, with its state integrated exactly along each step; with damping, LuGre's without Stribeck.

    Dahl, AIAA Journal 14 (1976); Canudas de Wit et al., IEEE Transactions on Automatic Control 40 (1995).
    """

    def __init__(self, p: Parameters, j: int) -> None:
        self._p, self._j = p, j
        self._z = 0.0

    def __call__(self, state: JointState) -> Array:
        """Torque [N m]; advances the friction's own state by one step."""
        v = float(state.v[self._j])
        z_rate, z = advance_bristle(self._z, v, self._p["displacement"], state.dt)
        torque = self._p["amplitude"] * (self._z + self._p.get("damping", 0.0) * z_rate)
        self._z = z
        return np.asarray(torque)


def smooth_random_signal(seed: int, seconds: float, frequency: float) -> Callable[[Array], Array]:
    """Smooth random signal of unit size with about ``frequency`` waves a second."""
    knots = np.arange(-1, seconds + 2, 1 / (2 * frequency))
    return CubicSpline(knots, np.random.default_rng(seed).normal(size=len(knots)))


def random_steps(seed: int, seconds: float, length: float) -> Callable[[Array], Array]:
    """Random signal of unit size that is constant for about ``length`` seconds at a time."""
    rng = np.random.default_rng(seed)
    edges = np.cumsum(rng.uniform(0.4, 1.6, round(seconds / length) + 9) * length)
    levels = rng.normal(size=len(edges) + 1)
    return lambda t: levels[np.searchsorted(edges, t)]


def config_omissions(hidden: tuple[HiddenEffect, ...]) -> tuple[dict[str, dict[str, bool]], set[str]]:
    """Friction terms to switch off in the configuration, by joint, and joints whose rotors it must not have."""
    friction: dict[str, dict[str, bool]] = {}
    without_rotor = set()
    for effect in hidden:
        joint = str(effect.joint)
        if effect.effect in ("viscous_friction", "coulomb_friction"):
            friction.setdefault(joint, {})[effect.effect.removesuffix("_friction")] = False
        if effect.effect == "rotor_inertia":
            without_rotor.add(joint)
    return friction, without_rotor


def apply_effects(
    robot: Robot, truth: Truth, hidden: tuple[HiddenEffect, ...]
) -> tuple[Truth, AddedPhysics, SensorErrors]:
    """Apply hidden effects to the true bodies and friction, the forces, and the sensors."""
    n = len(robot.joints)
    physics = AddedPhysics()
    errors = SensorErrors(np.zeros(n), np.zeros(n))
    for effect in hidden:
        j = None if effect.joint is None else robot.index(effect.joint)
        if j is not None:
            truth = _changed_truth(robot, truth, effect, j)
        _add_forces(robot, physics, effect, j)
        _add_sensor_errors(errors, effect, j)
    return truth, physics, errors


def _changed_truth(robot: Robot, truth: Truth, effect: HiddenEffect, j: int) -> Truth:
    """The truth with other friction or another rotor."""
    p = effect.parameters
    viscous, coulomb, rotors = truth.viscous.copy(), truth.coulomb.copy(), dict(truth.rotors)
    if effect.effect == "viscous_friction":
        viscous[j] = p["viscous"]
    elif effect.effect == "coulomb_friction":
        coulomb[j] = p["coulomb"]
    elif effect.effect == "presliding_hysteresis":
        coulomb[j] = 0.0
    elif effect.effect == "rotor_inertia":
        joint = robot.joints[j]
        rotors[joint.name] = rotor(replace(joint, reflected_inertia=p["inertia"]))
    return replace(truth, viscous=viscous, coulomb=coulomb, rotors=rotors)


def _add_forces(robot: Robot, physics: AddedPhysics, effect: HiddenEffect, j: int | None) -> None:
    p = effect.parameters
    if effect.effect == "gravity_tilt":
        physics.gravity = tuple(p["gravity"])
    elif effect.effect == "payload":
        xx, xy, yy, xz, yz, zz = p["inertia"]
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        physics.payloads.append((str(effect.link), Body(p["mass"], np.array(p["com"]), inertia)))
    elif effect.effect == "external_contact":
        contact = Contact(str(effect.link), p["windows"], np.array(p["wrench"]))
        if p.get("form") in PUSH_FORMS:
            is_half_sine = p["form"] == "half_sine_push"
            contact = replace(contact, rise_time=p["rise_time"], point=p["point"], is_half_sine=is_half_sine)
        physics.contacts.append(contact)
    elif j is not None:
        _add_joint_forces(robot, physics, p.get("form", effect.effect), p, j)


def _add_joint_forces(robot: Robot, physics: AddedPhysics, form: str, p: Parameters, j: int) -> None:
    if form == "transmission_coupling":
        p = {**p, "source_index": robot.index(p["source"])}
    elif form == "end_stop":
        p = {**p, "side": end_stop_side(robot, j, p["position"])}
    elif form == "wandering":
        p = {**p, "signal": smooth_random_signal(p["seed"], p["seconds"], p["scale"])}
    elif form == "steps":
        p = {**p, "signal": random_steps(p["seed"], p["seconds"], p["scale"])}
    elif form == "presliding_hysteresis":
        physics.smooth_torques.append((j, PreslidingFriction(p, j)))
    elif form in MOTOR_CURVES:
        physics.motor_curves.append((j, partial(MOTOR_CURVES[form], p)))
        if "command_limit" in p:
            physics.command_limits[j] = p["command_limit"]
    elif form in ("backlash", "joint_elasticity"):
        transmission = Transmission(p["stiffness"], p["damping"], p.get("width", 0.0), p.get("motor_friction", 0.0))
        physics.transmissions[j] = transmission
    if form in SMOOTH_TORQUES:
        physics.smooth_torques.append((j, partial(SMOOTH_TORQUES[form], p, j)))
    if form in FRICTION_LEVELS:
        physics.friction_levels.append((j, partial(FRICTION_LEVELS[form], p, j)))


def end_stop_side(robot: Robot, j: int, position: float) -> float:
    """1 for a stop that acts above the position, −1 for one below: the side of the nearer limit."""
    joint = robot.joints[j]
    return 1.0 if position >= (joint.lower + joint.upper) / 2 else -1.0


def _add_sensor_errors(errors: SensorErrors, effect: HiddenEffect, j: int | None) -> None:
    p = effect.parameters
    if effect.effect == "time_delay":
        errors.torque_delay[slice(None) if j is None else j] += p["delay"]
    if j is None:
        return
    if effect.effect == "encoder_offset":
        errors.position_offset[j] += p["offset"]
    elif effect.effect == "torque_gain":
        errors.torque_maps.append((j, lambda tau: p["gain"] * tau))
    elif effect.effect == "torque_saturation" and p.get("form") not in MOTOR_CURVES:
        errors.torque_maps.append((j, lambda tau: saturated_torque(tau, p["level"], p["bend"])))


def saturated_torque(tau: Array, level: float, bend: float) -> Array:
    """Measured torque: with x and y the true and measured excess over the level, x = y + bend y^2 / 2."""
    x = np.maximum(np.abs(tau) - level, 0.0)
    y = (np.sqrt(1 + 2 * bend * x) - 1) / bend if bend > 0 else x - bend * x**2 / 2
    return np.asarray(np.sign(tau) * (np.minimum(np.abs(tau), level) + y))
