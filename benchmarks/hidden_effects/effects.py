"""What a model can lack, as physics: the contract's effects and some that are not in it, by the contract's parameters.

`act` turns hidden effects into what they change: the bodies and the friction (`Truth`), the forces (`Physics`), the
measuring (`Channels`). What the config must not have of them is `lacking`.

Signs: a law's torque resists, it is what the actuator has to give on top of that for the rigid bodies.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from hidden_effects.plant import Contact, Gear, Law, Now, Physics
from hidden_effects.robots import Body, Robot, Truth, rotor

Array = NDArray[np.float64]
Parameters = Mapping[str, Any]
Form = Callable[[Parameters, Now, int], Array]

MAGNITUDES = ("strong", "ordinary", "near")


@dataclass(frozen=True)
class Hidden:
    """An effect on a joint, a link, or neither; without parameters, they are drawn for the magnitude."""

    effect: str
    joint: str | None = None
    link: str | None = None
    magnitude: str = "strong"
    parameters: Parameters = field(default_factory=dict)

    @property
    def place(self) -> str:
        """Joint or link, or ``all``."""
        return self.joint or self.link or "all"


@dataclass
class Channels:
    """How true torque and position are measured: by joint number; ``late`` and ``offset`` (n,) [s, rad]."""

    late: Array
    offset: Array
    sensors: list[tuple[int, Callable[[Array], Array]]] = field(default_factory=list)


def _drift(p: Parameters, now: Now) -> Array:
    return np.asarray(1 - np.exp(-np.asarray(now.t) / p["time_constant"]))


def _dead_zone(p: Parameters, now: Now, j: int) -> Array:
    away = now.q[j] - p["position"]
    beyond = away - np.clip(away, -p["width"], p["width"])
    return np.asarray(p["size"] * beyond * (1 + 0.8 * np.sin(2 * np.pi * p["frequency"] * np.asarray(now.t))))


# Torque that is a smooth function of the state, and of time.
SMOOTH: dict[str, Form] = {
    "quadratic_drag": lambda p, now, j: p["drag"] * now.v[j] * np.abs(now.v[j]),
    "torque_offset": lambda p, now, j: p["offset"] + 0 * now.v[j],
    "torque_ripple": lambda p, now, j: p["amplitude"] * np.sin(p["periods"] * now.q[j] + p["phase"]),
    "parallel_spring": lambda p, now, j: p["stiffness"] * (now.q[j] - p["rest_position"]),
    "end_stop": lambda p, now, j: p["stiffness"] * p["side"] * np.maximum(p["side"] * (now.q[j] - p["position"]), 0.0),
    "transmission_coupling": lambda p, now, j: -p["coefficient"] * now.tau[p["row"]],
    "friction_drift": lambda p, now, j: p["viscous"] * now.v[j] * _drift(p, now),
    "dead_zone": _dead_zone,
    "vibration": lambda p, now, j: p["size"] * np.sin(2 * np.pi * p["frequency"] * np.asarray(now.t) + p["phase"]),
    "viscosity_by_position": lambda p, now, j: p["size"] * np.sin(now.q[j] - p["position"]) * now.v[j],
    "wandering": lambda p, now, j: p["size"] * p["course"](now.t),
    "steps": lambda p, now, j: p["size"] * p["course"](now.t),
}

# Dry friction: its level.
DRY: dict[str, Form] = {
    "stribeck_friction": lambda p, now, j: p["stribeck"] * np.exp(-np.square(now.v[j] / p["velocity"])),
    "load_dependent_friction": lambda p, now, j: p["coefficient"] * np.abs(now.tau[j]),
    "friction_drift": lambda p, now, j: p["coulomb"] * _drift(p, now),
    "friction_by_position": lambda p, now, j: p["size"] * (1 + np.sin(p["periods"] * now.q[j] + p["phase"])) / 2,
}

# Not in the contract: each is an ``unknown`` with this ``form``.
UNKNOWN = ("dead_zone", "vibration", "viscosity_by_position", "wandering", "steps", "friction_by_position")


class Bristle:
    """Dahl's friction, its state solved exactly along each step; with a damping, LuGre's without Stribeck.

    Dahl, AIAA Journal 14 (1976); Canudas de Wit et al., IEEE Transactions on Automatic Control 40 (1995).
    """

    def __init__(self, p: Parameters, j: int) -> None:
        self._p, self._j, self._z = p, j, 0.0

    def __call__(self, now: Now) -> Array:
        """The torque, and one step on."""
        v, length = float(now.v[self._j]), self._p["displacement"]
        way = np.sign(v)
        rate = v / length * (1 - way * self._z)  # of z
        torque = self._p["amplitude"] * (self._z + self._p.get("damping", 0.0) * rate)
        self._z = way + (self._z - way) * np.exp(-abs(v) * now.dt / length)
        return np.asarray(torque)


def wandering(seed: int, seconds: float, frequency: float) -> Callable[[Array], Array]:
    """A smooth random course of unit size, about so many waves a second."""
    knots = np.arange(-1, seconds + 2, 1 / (2 * frequency))
    return CubicSpline(knots, np.random.default_rng(seed).normal(size=len(knots)))


def steps(seed: int, seconds: float, length: float) -> Callable[[Array], Array]:
    """A course of unit size that is constant for some length of time, and then another."""
    rng = np.random.default_rng(seed)
    edges = np.cumsum(rng.uniform(0.4, 1.6, round(seconds / length) + 9) * length)
    levels = rng.normal(size=len(edges) + 1)
    return lambda t: levels[np.searchsorted(edges, t)]


def law(form: Form, p: Parameters, j: int) -> Law:
    """A form on a joint."""
    return lambda now: form(p, now, j)


def lacking(hidden: tuple[Hidden, ...]) -> tuple[dict[str, dict[str, bool]], set[str]]:
    """The config's friction by joint, and the joints whose rotors it has not."""
    friction: dict[str, dict[str, bool]] = {}
    for one in hidden:
        if one.effect in ("viscous_friction", "coulomb_friction"):
            friction.setdefault(str(one.joint), {})[one.effect.removesuffix("_friction")] = False
    return friction, {str(one.joint) for one in hidden if one.effect == "rotor_inertia"}


def act(robot: Robot, truth: Truth, hidden: tuple[Hidden, ...]) -> tuple[Truth, Physics, Channels]:
    """What hidden effects make of a robot."""
    n = len(robot.joints)
    physics, channels = Physics(), Channels(np.zeros(n), np.zeros(n))
    for one in hidden:
        j = None if one.joint is None else robot.index(one.joint)
        truth = _weighed(robot, truth, one, j)
        _forces(robot, physics, one, j)
        _measuring(channels, one, j)
    return truth, physics, channels


def _weighed(robot: Robot, truth: Truth, one: Hidden, j: int | None) -> Truth:
    """The truth with other friction or another rotor."""
    p, viscous, coulomb = one.parameters, truth.viscous.copy(), truth.coulomb.copy()
    if j is None:
        return truth
    if one.effect == "viscous_friction":
        viscous[j] = p["viscous"]
    if one.effect == "coulomb_friction":
        coulomb[j] = p["coulomb"]
    if one.effect == "presliding_hysteresis":
        coulomb[j] = 0.0
    rotors = dict(truth.rotors)
    if one.effect == "rotor_inertia":
        joint = robot.joints[j]
        rotors[joint.name] = rotor(replace(joint, reflected=p["inertia"]))
    return replace(truth, viscous=viscous, coulomb=coulomb, rotors=rotors)


def _forces(robot: Robot, physics: Physics, one: Hidden, j: int | None) -> None:
    p, form = one.parameters, one.parameters.get("form", one.effect)
    if one.effect == "gravity_tilt":
        physics.gravity = tuple(p["gravity"])
    elif one.effect == "payload":
        xx, xy, yy, xz, yz, zz = p["inertia"]
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        physics.payloads.append((str(one.link), Body(p["mass"], np.array(p["com"]), inertia)))
    elif one.effect == "external_contact":
        physics.contacts.append(Contact(str(one.link), p["windows"], np.array(p["wrench"])))
    if j is None:
        return
    if form == "transmission_coupling":
        p = {**p, "row": robot.index(p["source"])}
    if form == "end_stop":
        p = {**p, "side": side(robot, j, p["position"])}
    if form in ("wandering", "steps"):
        course = wandering if form == "wandering" else steps
        p = {**p, "course": course(p["seed"], p["seconds"], p["scale"])}
    if form == "presliding_hysteresis":
        physics.smooth.append((j, Bristle(p, j)))
    if form in ("backlash", "joint_elasticity"):
        physics.gears[j] = Gear(p["stiffness"], p["damping"], p.get("width", 0.0), p.get("motor_friction", 0.0))
    if form in SMOOTH:
        physics.smooth.append((j, law(SMOOTH[form], p, j)))
    if form in DRY:
        physics.dry.append((j, law(DRY[form], p, j)))


def side(robot: Robot, j: int, position: float) -> float:
    """1 for a stop that acts above the position, −1 for one below: that of the nearer limit."""
    joint = robot.joints[j]
    return 1.0 if position >= (joint.lower + joint.upper) / 2 else -1.0


def _measuring(channels: Channels, one: Hidden, j: int | None) -> None:
    p = one.parameters
    if one.effect == "time_delay":
        channels.late[slice(None) if j is None else j] += p["delay"]
    if j is None:
        return
    if one.effect == "encoder_offset":
        channels.offset[j] += p["offset"]
    if one.effect == "torque_gain":
        channels.sensors.append((j, lambda tau: p["gain"] * tau))
    if one.effect == "torque_saturation":
        channels.sensors.append((j, lambda tau: saturated(tau, p["level"], p["bend"])))


def saturated(tau: Array, level: float, bend: float) -> Array:
    """Measured torque: with x and y the true and measured excess over the level, x = y + bend y^2 / 2."""
    x = np.maximum(np.abs(tau) - level, 0.0)
    y = (np.sqrt(1 + 2 * bend * x) - 1) / bend if bend > 0 else x - bend * x**2 / 2
    return np.asarray(np.sign(tau) * (np.minimum(np.abs(tau), level) + y))
