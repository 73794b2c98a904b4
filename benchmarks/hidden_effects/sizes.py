"""How large hidden effects are: `drawn` gives an effect its parameters for a magnitude, along a commanded motion.

Most are given so that their torque along the command has a share of the joint's rms torque: 12 % ``strong``, 4 %
``ordinary``, 1 % ``near`` what can be seen, times a random factor of 0.8 to 1.25. Of which other bodies and friction
explain more than 60 % is given larger, up to three times. Some are given by what a machine has.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
from numpy.typing import NDArray

from hidden_effects.effects import DRY, MAGNITUDES, SMOOTH, Hidden, Parameters, side
from hidden_effects.motion import Motion, nominal_torque
from hidden_effects.plant import Now, needed
from hidden_effects.robots import Robot, Truth, rotor, urdf_text

Array = NDArray[np.float64]

_SHARES = {"strong": 0.12, "ordinary": 0.04, "near": 0.01}
_SEEN, _MOST = 0.4, 3.0  # share that bodies and friction must leave; else so much more of it, at most
_EVERY = 20  # samples between those by which that is judged
_PAYLOADS = {"planar2": 0.7, "leg3": 0.25, "arm6": 2.5}  # kg, strong
_FORCES = {"planar2": 12.0, "leg3": 7.0, "arm6": 25.0}  # N, strong
_PLAYS = {"planar2": 0.012, "leg3": 0.012, "arm6": 0.005}  # rad, strong, for a motor as heavy as its link


@dataclass(frozen=True)
class Draw:
    """What an effect's size depends on; ``now`` the commanded motion with its nominal torque, ``j`` the joint.

    ``fixed``: the URDF's inertias are the true ones, and taken as such. Otherwise an encoder's offset is felt by its
    square: most of it looks like other inertias. ``base``: see `_base`.
    """

    robot: Robot
    truth: Truth
    now: Now
    j: int
    magnitude: str
    factor: float
    fixed: bool
    base: Array
    rng: np.random.Generator

    def of(self, *values: float) -> float:
        """The value for the magnitude, of three, times the random factor."""
        return values[MAGNITUDES.index(self.magnitude)] * self.factor

    @property
    def sign(self) -> float:
        """Either."""
        return float(self.rng.choice([-1.0, 1.0]))

    @property
    def torque(self) -> float:
        """The joint's rms torque [N m]."""
        return _rms(self.now.tau[self.j])

    def share(self, column: Array) -> float:
        """The coefficient of a column that makes it the magnitude's share of the joint's torque."""
        return self.factor * _SHARES[self.magnitude] * self.torque / _rms(column)

    def filling(self, column: Array, more: float = 1.0) -> float:
        """The same, or more where others explain most of it."""
        column = np.broadcast_to(column, self.now.t.shape)
        few = np.zeros((len(self.now.q), len(column[::_EVERY])))
        few[self.j] = column[::_EVERY] / _rms(column)
        left = few.ravel() - self.base @ (self.base.T @ few.ravel())
        seen = np.linalg.norm(left) / np.linalg.norm(few)
        more *= min(max(_SEEN / seen, 1.0), _MOST)
        return more * self.share(column)

    def smooth(self, effect: str, unit: dict[str, Any], more: float = 1.0) -> float:
        """The same of a smooth law with a coefficient of one."""
        return self.filling(SMOOTH[effect](unit, self.now, self.j) + 0 * self.now.t, more)

    def dry(self, effect: str, unit: dict[str, Any], more: float = 1.0) -> float:
        """The same of dry friction."""
        return self.filling(DRY[effect](unit, self.now, self.j) * np.sign(self.now.v[self.j]), more)


def _base(robot: Robot, now: Now) -> Array:
    """An orthonormal base of all torque that links, rotors, viscous and Coulomb friction can explain, (n few, r)."""
    model = pin.buildModelFromXML(urdf_text(robot))
    data, n = model.createData(), len(robot.joints)
    rows = np.zeros((n, len(now.t[::_EVERY]), 13 * n))
    for k, motion in enumerate(zip(now.q.T[::_EVERY], now.v.T[::_EVERY], now.a.T[::_EVERY], strict=True)):
        rows[:, k, : 10 * n] = pin.computeJointTorqueRegressor(model, data, *motion)
    for j in range(n):
        for k, x in enumerate((now.v[j], np.sign(now.v[j]), now.a[j])):
            rows[j, :, 10 * n + 3 * j + k] = x[::_EVERY]
    U, size, _ = np.linalg.svd(rows.reshape(-1, 13 * n), full_matrices=False)
    return np.asarray(U[:, size > 1e-9 * size[0]])


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def _ripple(d: Draw) -> Parameters:
    travel = np.ptp(d.now.q[d.j])
    periods = float(d.rng.choice([n for n in (7, 12, 28, 50) if n * travel > 4 * np.pi]))
    unit = {"amplitude": 1.0, "periods": periods, "phase": float(d.rng.uniform(-np.pi, np.pi))}
    return {**unit, "amplitude": d.smooth("torque_ripple", unit, 0.7)}


def _spring(d: Draw) -> Parameters:
    unit = {"stiffness": 1.0, "rest_position": float(np.mean(d.now.q[d.j]))}
    rest = unit["rest_position"] + d.rng.uniform(-0.3, 0.3)
    return {"stiffness": d.smooth("parallel_spring", unit, 1.2), "rest_position": rest}


def _stop(d: Draw) -> Parameters:
    position = float(np.quantile(d.now.q[d.j], d.rng.choice([0.12, 0.88])))
    unit = {"stiffness": 1.0, "position": position, "side": side(d.robot, d.j, position)}
    return {"stiffness": d.smooth("end_stop", unit), "position": position}


def _coupling(d: Draw) -> Parameters:
    others = [name for name in d.robot.names if name != d.robot.names[d.j]]
    near = [name for name in others if abs(d.robot.index(name) - d.j) == 1]
    source = str(d.rng.choice(near))
    c = d.filling(d.now.tau[d.robot.index(source)])
    return {"source": source, "coefficient": d.sign * c}


def _saturation(d: Draw) -> Parameters:
    peak = float(np.abs(d.now.tau[d.j]).max())
    level, lost = 0.4 * peak, d.of(0.16, 0.07, 0.02) * peak
    x = peak - level
    return {"level": level, "bend": 2 * lost / (x - lost) ** 2}


def _drift(d: Draw) -> Parameters:
    share = -min(d.of(0.7, 0.35, 0.08), 0.85)
    time = float(d.now.t[-1]) * d.rng.uniform(0.2, 0.4)
    return {
        "viscous": float(share * d.truth.viscous[d.j]),
        "coulomb": float(share * d.truth.coulomb[d.j]),
        "time_constant": time,
    }


def _sides(d: Draw) -> tuple[float, float]:
    """Inertia of a joint's motor, and of all that it moves beside it in the middle of the motion [kg m^2]."""
    n, motor = len(d.robot.joints), d.robot.joints[d.j].reflected
    q = np.median(d.now.q, axis=1)[:, None]
    rotors = {one.name: rotor(one) for one in d.robot.joints}
    pushed, still = (needed(d.robot, d.robot.links, rotors, q, 0 * q, a * np.eye(n)[:, [d.j]])[d.j, 0] for a in (1, 0))
    return motor, float(pushed - still - motor)


def _gear(d: Draw, stiffness: float, ratio: float) -> dict[str, float]:
    """Damping so much of critical for the motor; in every other gear, half of the friction on the motor's side."""
    damping = 2 * ratio * np.sqrt(stiffness * _sides(d)[0])
    return {"stiffness": stiffness, "damping": float(damping), "motor_friction": float(d.rng.choice([0.0, 0.5]))}


def _elasticity(d: Draw) -> Parameters:
    return _gear(d, (2 * np.pi * d.of(11.0, 20.0, 45.0)) ** 2 * _sides(d)[1], 0.05)


def _backlash(d: Draw) -> Parameters:
    motor, link = _sides(d)
    gear = _gear(d, (2 * np.pi * 150) ** 2 * motor * link / (motor + link), 0.3)
    return {"width": _PLAYS[d.robot.name] * motor / link * d.of(1.0, 0.33, 0.08), **gear}


def _tilt(d: Draw) -> Parameters:
    angle, way = np.deg2rad(d.of(6.0, 2.0, 0.25)), d.rng.uniform(-np.pi, np.pi)
    if d.robot.name == "planar2":
        way = float(d.rng.choice([0.0, np.pi]))  # what tilts it out of its plane is not felt
    across = np.sin(angle) * np.array([np.cos(way), np.sin(way)])
    return {"gravity": [*(9.81 * across).tolist(), float(-9.81 * np.cos(angle))]}


def _payload(d: Draw) -> Parameters:
    mass, size = _PAYLOADS[d.robot.name] * d.of(1.0, 0.3, 0.03), d.rng.uniform(0.03, 0.08, 3)
    a, b, c = mass / 5 * np.square(size)  # an ellipsoid with these semi-axes
    com = 0.1 * d.rng.uniform(-1, 1, 3) + d.robot.links[d.robot.joints[-1].child].com
    return {"mass": mass, "com": com.tolist(), "inertia": [b + c, 0.0, a + c, 0.0, 0.0, a + b]}


def _contact(d: Draw) -> Parameters:
    size, seconds = _FORCES[d.robot.name] * d.of(1.0, 0.35, 0.08), float(d.now.t[-1])
    force, moment = d.rng.normal(size=(2, 3))
    if d.robot.name == "planar2":
        force[1] = moment[0] = moment[2] = 0.0
    force, moment = size * force / np.linalg.norm(force), 0.05 * size * moment / np.linalg.norm(moment)
    starts = seconds * (np.array([0.1, 0.45, 0.78]) + d.rng.uniform(0, 0.08, 3))
    lengths = seconds * d.rng.uniform(0.05, 0.1, 3)
    return {
        "windows": np.round(np.transpose([starts, starts + lengths]), 3).tolist(),
        "wrench": [*force.tolist(), *moment.tolist()],
    }


def _unknown(d: Draw, form: str) -> Parameters:
    seconds, middle = float(d.now.t[-1]), float(np.mean(d.now.q[d.j]))
    unit: dict[str, Any] = {
        "dead_zone": {"position": middle, "width": 0.3 * np.std(d.now.q[d.j]), "frequency": d.rng.uniform(0.15, 0.4)},
        "vibration": {"frequency": d.rng.uniform(2.8, 6.0), "phase": d.rng.uniform(0, 6.0)},
        "viscosity_by_position": {"position": middle},
        "wandering": {"seed": int(d.rng.integers(1000)), "seconds": seconds, "scale": d.rng.uniform(0.3, 0.8)},
        "steps": {"seed": int(d.rng.integers(1000)), "seconds": seconds, "scale": d.rng.uniform(0.4, 1.0)},
        "friction_by_position": {"periods": d.rng.uniform(3.0, 6.0), "phase": d.rng.uniform(0, 6.0)},
    }[form]
    unit = {name: float(x) if isinstance(x, np.floating) else x for name, x in unit.items()} | {"size": 1.0}
    if form == "friction_by_position":
        return {"form": form, **unit, "size": d.dry(form, unit)}
    return {"form": form, **unit, "size": _unknown_size(d, form, unit)}


def _unknown_size(d: Draw, form: str, unit: dict[str, Any]) -> float:
    if form in ("wandering", "steps"):  # of unit size already
        return d.share(np.ones(1))
    return d.smooth(form, unit)


_DRAWN: dict[str, Callable[[Draw], Parameters]] = {
    "viscous_friction": lambda d: {"viscous": d.share(d.now.v[d.j])},
    "coulomb_friction": lambda d: {"coulomb": d.share(np.sign(d.now.v[d.j]))},
    "stribeck_friction": lambda d: {
        "stribeck": d.truth.coulomb[d.j] * d.of(0.8, 0.4, 0.1),
        "velocity": float(np.exp(d.rng.uniform(np.log(0.06), np.log(0.3)))),
    },
    "load_dependent_friction": lambda d: {"coefficient": d.dry("load_dependent_friction", {"coefficient": 1.0})},
    "quadratic_drag": lambda d: {"drag": d.smooth("quadratic_drag", {"drag": 1.0}, 1.5)},
    "presliding_hysteresis": lambda d: {
        "amplitude": float(d.truth.coulomb[d.j]),
        "displacement": d.of(0.06, 0.02, 0.004),
        "damping": float(d.rng.choice([0.0, 0.02])),
    },
    "torque_offset": lambda d: {"offset": d.sign * d.smooth("torque_offset", {"offset": 1.0})},
    "torque_gain": lambda d: {"gain": float(1 + d.sign * d.of(0.15, 0.05, 0.01))},
    "torque_saturation": _saturation,
    "torque_ripple": _ripple,
    "parallel_spring": _spring,
    "end_stop": _stop,
    "rotor_inertia": lambda d: {"inertia": d.share(d.now.a[d.j])},
    "backlash": _backlash,
    "joint_elasticity": _elasticity,
    "transmission_coupling": _coupling,
    "encoder_offset": lambda d: {"offset": d.sign * d.of(*((0.12, 0.04, 0.008) if d.fixed else (0.25, 0.12, 0.04)))},
    "time_delay": lambda d: {"delay": d.of(0.010, 0.004, 0.0008)},
    "gravity_tilt": _tilt,
    "payload": _payload,
    "external_contact": _contact,
    "friction_drift": _drift,
}

EFFECTS = tuple(_DRAWN)


def drawn(
    robot: Robot, truth: Truth, hidden: tuple[Hidden, ...], motion: Motion, seed: int, fixed: bool
) -> tuple[Hidden, ...]:
    """Hidden effects with their parameters; those that have some keep them."""
    now = Now(motion.t, motion.q, motion.v, motion.a, nominal_torque(robot, motion))
    base, out = _base(robot, now), []
    for k, one in enumerate(hidden):
        rng = np.random.default_rng([seed, 14, k])
        j = 0 if one.joint is None else robot.index(one.joint)
        factor = float(np.exp(rng.uniform(-0.22, 0.22)))
        draw = Draw(robot, truth, now, j, one.magnitude, factor, fixed, base, rng)
        given = _unknown(draw, one.parameters["form"]) if one.effect == "unknown" else _DRAWN[one.effect](draw)
        out.append(replace(one, parameters={**given, **one.parameters}))
    return tuple(out)
