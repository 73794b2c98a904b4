"""Which cases there are: `cases` lists those of a kind, by robot, magnitude and seed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hidden_effects.effects import MAGNITUDES, UNKNOWN, Hidden
from hidden_effects.logs import Sensors
from hidden_effects.robots import ROBOTS, Robot
from hidden_effects.sizes import EFFECTS

FIXED = ("gravity_tilt", "payload", "torque_gain")  # looked for with the URDF's inertia taken as true
ALIKE = ("viscous_friction", "load_dependent_friction", "parallel_spring", "stribeck_friction", "torque_ripple")
ALIKE += ("presliding_hysteresis", "torque_offset", "quadratic_drag", "joint_elasticity")  # hidden on several joints

_MORE = {2: 6, 3: 4}  # how many pairs and triples a robot and seed have
# On one joint, one of these takes the other's place.
_APART = (
    {"coulomb_friction", "presliding_hysteresis", "friction_drift"},
    {"viscous_friction", "friction_drift"},
    {"stribeck_friction", "presliding_hysteresis"},
    {"backlash", "joint_elasticity"},
    {"torque_gain", "torque_saturation"},
)


@dataclass(frozen=True)
class Case:
    """A log to be made. ``inertia``: as the option of ``idtool diagnose``; ``fixed`` has the URDF's true."""

    name: str
    robot: str
    hidden: tuple[Hidden, ...]
    seed: int = 0
    inertia: str = "refit"
    seconds: float = 30.0
    sensors: Sensors = field(default_factory=Sensors)


def places(robot: Robot, effect: str) -> tuple[str, ...]:
    """Joints where an effect can be told from rigid bodies; links of a payload or contact; ``all``: the whole robot.

    A rotor's inertia is its link's on a first joint and on one that is perpendicular to the joint before; an encoder
    offset turns the link on a last joint, and the base on the first; on the leg's hip, it is felt by its square only.
    """
    names = robot.names
    if effect in ("payload", "external_contact"):
        return (robot.joints[-1].child,)
    if effect == "gravity_tilt":
        return ("all",)
    if effect == "rotor_inertia":
        return {"planar2": ("elbow",), "leg3": ("knee",), "arm6": ("j3", "j4")}[robot.name]
    if effect == "encoder_offset":
        return {"planar2": ("elbow",), "leg3": ("hip",), "arm6": ("j2", "j3")}[robot.name]
    if effect == "time_delay":
        return (*names[1:3], "all")
    return names[:4]


def sensors_of(seed: int) -> Sensors:
    """Every third log has no velocity, every other third a drive that lags more and stamps that jitter."""
    return (Sensors(), Sensors(velocity=False), Sensors(lag=1.6e-3, jitter=0.015))[seed % 3]


def numbers(text: str) -> list[int]:
    """Numbers such as ``0,3-5``."""
    spans = [part.split("-") for part in text.split(",")]
    return [k for span in spans for k in range(int(span[0]), int(span[-1]) + 1)]


def cases(
    kind: str,
    robots: Iterable[str] = tuple(ROBOTS),
    magnitudes: Iterable[str] = MAGNITUDES,
    seeds: Iterable[int] = (0, 1, 2),
    seconds: float = 30.0,
) -> list[Case]:
    """All cases of a kind of `KINDS`. Pairs and triples mix the magnitudes, those near the limit left out."""
    sizes = tuple(magnitudes)
    found = [case for name in robots for seed in seeds for case in KINDS[kind](ROBOTS[name], sizes, seed)]
    return [replace(case, seconds=seconds) for case in found]


def _single(robot: Robot, sizes: Sequence[str], seed: int) -> list[Case]:
    found = []
    for k, effect in enumerate(EFFECTS):
        where = places(robot, effect)
        place = where[(k + seed) % len(where)]
        found += [_case(robot, [_hidden(robot, effect, place, size)], seed) for size in sizes]
    return found


def _clean(robot: Robot, sizes: Sequence[str], seed: int) -> list[Case]:
    return [_case(robot, [], seed)]


def _unknown(robot: Robot, sizes: Sequence[str], seed: int) -> list[Case]:
    joints = robot.names[:4]
    return [
        _case(robot, [_hidden(robot, "unknown", joints[(k + seed) % len(joints)], size, form)], seed)
        for k, form in enumerate(UNKNOWN)
        for size in sizes
    ]


def _several(robot: Robot, sizes: Sequence[str], seed: int) -> list[Case]:
    chosen = np.random.default_rng([seed, 16]).permutation(ALIKE)[:4]
    return [
        _case(robot, [_hidden(robot, str(effect), joint, size) for joint in robot.names[-3:]], seed)
        for effect in chosen
        for size in sizes
    ]


def _together(count: int) -> Callable[[Robot, Sequence[str], int], list[Case]]:
    def listed(robot: Robot, sizes: Sequence[str], seed: int) -> list[Case]:
        rng = np.random.default_rng([seed, 15, count, len(robot.joints)])
        plain = [size for size in sizes if size != "near"] or list(sizes)
        found: dict[frozenset[tuple[str, str]], Case] = {}
        while len(found) < _MORE[count]:
            effects = rng.choice([effect for effect in EFFECTS if effect != "external_contact"], count, replace=False)
            on = [str(rng.choice(places(robot, effect))) for effect in effects]
            if _fit_together(effects.tolist(), on):
                those = zip(effects, on, rng.choice(plain, count), strict=True)
                hidden = [_hidden(robot, str(effect), place, str(size)) for effect, place, size in those]
                found[frozenset(zip(effects.tolist(), on, strict=True))] = _case(robot, hidden, seed)
        return list(found.values())

    return listed


def _fit_together(effects: Sequence[str], on: Sequence[str]) -> bool:
    """Whether none takes another's place, and no two are alike for the joint or the whole robot."""
    for k, (one, place) in enumerate(zip(effects, on, strict=True)):
        for other, there in zip(effects[:k], on[:k], strict=True):
            if place == there and any({one, other} <= apart for apart in _APART):
                return False
    return not {"gravity_tilt", "encoder_offset"} <= set(effects)


KINDS: dict[str, Callable[[Robot, Sequence[str], int], list[Case]]] = {
    "single": _single,
    "pairs": _together(2),
    "triples": _together(3),
    "several": _several,
    "clean": _clean,
    "unknown": _unknown,
}


def _hidden(robot: Robot, effect: str, place: str, magnitude: str, form: str | None = None) -> Hidden:
    parameters = {"form": form} if form else {}
    if place == "all":
        return Hidden(effect, magnitude=magnitude, parameters=parameters)
    if place in robot.names:
        return Hidden(effect, joint=place, magnitude=magnitude, parameters=parameters)
    return Hidden(effect, link=place, magnitude=magnitude, parameters=parameters)


def _case(robot: Robot, hidden: Sequence[Hidden], seed: int) -> Case:
    those = [f"{one.parameters.get('form', one.effect)}.{one.place}" for one in hidden] or ["clean"]
    sizes = dict.fromkeys(one.magnitude for one in hidden)
    name = "_".join(filter(None, (robot.name, "+".join(those), "+".join(sizes), f"s{seed}")))
    unseen = robot.name != "arm6" and any(one.effect == "encoder_offset" for one in hidden)
    fixed = unseen or any(one.effect in FIXED for one in hidden)
    return Case(name, robot.name, tuple(hidden), seed, "fixed" if fixed else "refit", sensors=sensors_of(seed))
