"""Cases of the benchmark: `list_cases` lists those of a kind, by robot, magnitude and seed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from hidden_effects.effects import MAGNITUDES, MOTOR_CURVES, PUSH_FORMS, UNKNOWN_FORMS, HiddenEffect
from hidden_effects.friction import FRICTION_KINDS
from hidden_effects.logs import NOISE_KINDS, Sensors
from hidden_effects.magnitudes import EFFECTS
from hidden_effects.robots import ROBOTS, Robot

# Effects that can only be identified if the URDF's inertia is known to be true.
NEED_FIXED_INERTIA = ("gravity_tilt", "payload", "torque_gain")
# Effects of the kind ``several``, hidden on several joints of a robot.
ON_SEVERAL_JOINTS = (
    "viscous_friction",
    "load_dependent_friction",
    "parallel_spring",
    "stribeck_friction",
    "torque_ripple",
    "presliding_hysteresis",
    "torque_offset",
    "quadratic_drag",
    "joint_elasticity",
)

# Kinds of friction and of noise on the torque that clean cases have by turns.
COMBINATIONS = tuple((friction, noise) for noise in NOISE_KINDS for friction in FRICTION_KINDS)
_USUAL_COMBINATION = ("sign", "white")
_VARIANT_LOGS = 2  # of a motor that saturates

_MIXTURES = {2: 6, 3: 4}  # number of pairs and of triples for each robot and seed
# Locations of the kind ``variants``: joints that carry much load, links that are pushed, and shoulders.
_LOADED_JOINTS = {"planar2": ("shoulder", "elbow"), "leg3": ("hip", "knee"), "arm6": ("j2", "j3")}
_PUSHED_LINKS = {"planar2": "lower", "leg3": "shank", "arm6": "forearm"}
_SHOULDERS = {"planar2": "shoulder", "arm6": "j2"}
# Sets of effects of which one joint has no more than one.
_EXCLUSIVE = (
    {"coulomb_friction", "presliding_hysteresis", "friction_drift"},
    {"viscous_friction", "friction_drift"},
    {"stribeck_friction", "presliding_hysteresis"},
    {"backlash", "joint_elasticity"},
    {"torque_gain", "torque_saturation"},
    {"torque_offset", "parallel_spring"},
)


FRICTION_HELP = "way of simulating dry friction; default: sign, in clean cases all by turns"
NOISE_HELP = "noise on the torque; default: white, in clean cases all by turns"


@dataclass(frozen=True)
class Case:
    """A robot with hidden effects, of which a log is to be made.

    Attributes
    ----------
    name
        Name, unique among all cases.
    robot
        Name of the robot.
    hidden
        The hidden effects.
    seed
        Seed of everything random.
    inertia
        As the option of ``idtool diagnose``: ``refit``; ``fixed`` if the true bodies are those of the URDF.
    seconds
        Duration of each log for the diagnosis [s].
    sensors
        The logs' sensors.
    friction
        Kind of the simulated dry friction, one of `FRICTION_KINDS`.
    logs
        Number of logs for the diagnosis. With more than one, there is one log more that is not for the diagnosis. Its
        motion is the first one, faster.
    """

    name: str
    robot: str
    hidden: tuple[HiddenEffect, ...]
    seed: int = 0
    inertia: str = "refit"
    seconds: float = 30.0
    sensors: Sensors = field(default_factory=Sensors)
    friction: str = "sign"
    logs: int = 1


def possible_locations(robot: Robot, effect: str) -> tuple[str, ...]:
    """Joints on which an effect can be told from rigid bodies, or links; ``all`` stands for the whole robot.

    A rotor's inertia is its link's on a first joint and on one that is perpendicular to the joint before. An encoder
    offset turns the link on a last joint, and the base on the first; on the leg's hip, only its square has an effect.
    Backlash shows when the load changes sides; on the leg's abad, it never does.
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
    if effect == "backlash" and robot.name == "leg3":
        return names[1:]
    if effect == "time_delay":
        return (*names[1:3], "all")
    return names[:4]


def sensors_for_seed(seed: int) -> Sensors:
    """Sensors by turns: the default ones, without velocity, and with a larger lag and jitter."""
    return (Sensors(), Sensors(has_velocity=False), Sensors(velocity_lag=1.6e-3, time_jitter=0.015))[seed % 3]


def parse_numbers(text: str) -> list[int]:
    """Integers of a text such as ``0,3-5``."""
    numbers = []
    for part in text.split(","):
        ends = [int(end) for end in part.split("-")]
        numbers += range(ends[0], ends[-1] + 1)
    return numbers


def list_cases(
    kind: str,
    robots: Iterable[str] = tuple(ROBOTS),
    magnitudes: Iterable[str] = MAGNITUDES,
    seeds: Iterable[int] = (0, 1, 2),
    seconds: float = 30.0,
    friction: str | None = None,
    noise: str | None = None,
) -> list[Case]:
    """All cases of a kind, one of `KINDS`.

    Pairs and triples mix the magnitudes, but leave out ``near``; variants leave it out too.

    Parameters
    ----------
    kind, robots, magnitudes, seeds, seconds
        The kind, and values for its cases.
    friction, noise
        Kinds of friction and of noise on the torque instead of the usual ones. The usual ones are ``sign`` and
        ``white``; clean cases have all combinations by turns.
    """
    magnitudes, seeds = tuple(magnitudes), tuple(seeds)
    cases = []
    for name in robots:
        for seed in seeds:
            usual = COMBINATIONS[seed % len(COMBINATIONS)] if kind == "clean" else _USUAL_COMBINATION
            combination = (friction or usual[0], noise or usual[1])
            is_in_name = kind == "clean" or combination != usual
            for case in KINDS[kind](ROBOTS[name], magnitudes, seed):
                timed_case = replace(case, seconds=seconds)
                cases.append(_simulated_with(timed_case, *combination) if is_in_name else timed_case)
    return cases


def _simulated_with(case: Case, friction: str, noise: str) -> Case:
    """A case with a kind of friction and of noise, and with their names in its own."""
    seed = f"_s{case.seed}"
    name = f"{case.name.removesuffix(seed)}_{friction}_{noise}{seed}"
    return replace(case, name=name, friction=friction, sensors=replace(case.sensors, noise=noise))


def _single(robot: Robot, magnitudes: Sequence[str], seed: int) -> list[Case]:
    """One case for each effect and magnitude."""
    cases = []
    for k, effect in enumerate(EFFECTS):
        locations = possible_locations(robot, effect)
        location = locations[(k + seed) % len(locations)]
        for magnitude in magnitudes:
            cases.append(_case(robot, [_hidden_effect(robot, effect, location, magnitude)], seed))
    return cases


def _clean(robot: Robot, magnitudes: Sequence[str], seed: int) -> list[Case]:
    """One case without hidden effects."""
    return [_case(robot, [], seed)]


def _unknown(robot: Robot, magnitudes: Sequence[str], seed: int) -> list[Case]:
    """One case for each magnitude of each effect that idtool does not have."""
    joints = robot.names[:4]
    cases = []
    for k, form in enumerate(UNKNOWN_FORMS):
        joint = joints[(k + seed) % len(joints)]
        for magnitude in magnitudes:
            cases.append(_case(robot, [_hidden_effect(robot, "unknown", joint, magnitude, form)], seed))
    return cases


def _several(robot: Robot, magnitudes: Sequence[str], seed: int) -> list[Case]:
    """Cases with one effect on several joints."""
    effects = np.random.default_rng([seed, 16]).permutation(ON_SEVERAL_JOINTS)[:4]
    cases = []
    for effect in effects:
        for magnitude in magnitudes:
            hidden = [_hidden_effect(robot, str(effect), joint, magnitude) for joint in robot.names[-3:]]
            cases.append(_case(robot, hidden, seed))
    return cases


def _combinations(robot: Robot, magnitudes: Sequence[str], seed: int, count: int) -> list[Case]:
    """Cases with ``count`` different effects at random locations."""
    rng = np.random.default_rng([seed, 15, count, len(robot.joints)])
    usual_magnitudes = [magnitude for magnitude in magnitudes if magnitude != "near"] or list(magnitudes)
    candidates = [effect for effect in EFFECTS if effect != "external_contact"]
    cases: dict[frozenset[tuple[str, str]], Case] = {}
    while len(cases) < _MIXTURES[count]:
        effects = [str(effect) for effect in rng.choice(candidates, count, replace=False)]
        locations = [str(rng.choice(possible_locations(robot, effect))) for effect in effects]
        if not _are_compatible(effects, locations):
            continue
        hidden = []
        for effect, location, magnitude in zip(effects, locations, rng.choice(usual_magnitudes, count), strict=True):
            hidden.append(_hidden_effect(robot, effect, location, str(magnitude)))
        cases[frozenset(zip(effects, locations, strict=True))] = _case(robot, hidden, seed)
    return list(cases.values())


def _variants(robot: Robot, magnitudes: Sequence[str], seed: int) -> list[Case]:
    """Cases of effects as they are in other simulators and on machines, not as idtool models them."""
    cases = []
    for magnitude in [magnitude for magnitude in magnitudes if magnitude != "near"] or magnitudes:
        loaded_joints = _LOADED_JOINTS[robot.name]
        joint = loaded_joints[seed % len(loaded_joints)]
        for form in MOTOR_CURVES:
            hidden = [_hidden_effect(robot, "torque_saturation", joint, magnitude, form)]
            cases.append(replace(_variant(robot, hidden, seed), logs=_VARIANT_LOGS))
        for form in PUSH_FORMS:
            hidden = [_hidden_effect(robot, "external_contact", _PUSHED_LINKS[robot.name], magnitude, form)]
            cases.append(_variant(robot, hidden, seed))
        k = seed % (min(len(robot.names), 4) - 1)
        neighbours = [
            _hidden_effect(robot, "transmission_coupling", robot.names[k], magnitude),
            _hidden_effect(robot, "presliding_hysteresis", robot.names[k + 1], magnitude),
        ]
        cases.append(_variant(robot, neighbours, seed))
        if robot.name == "leg3":
            cases.append(_variant(robot, [_hidden_effect(robot, "joint_elasticity", "hip", magnitude)], seed))
        if robot.name in _SHOULDERS:
            shoulder = _SHOULDERS[robot.name]
            hidden = [_hidden_effect(robot, "load_dependent_friction", shoulder, magnitude)]
            cases.append(_variant(robot, hidden, seed))
    return cases


def _variant(robot: Robot, hidden: Sequence[HiddenEffect], seed: int) -> Case:
    """A case with a name that differs from those of the other kinds."""
    case = _case(robot, hidden, seed)
    return replace(case, name=case.name.replace(robot.name, f"{robot.name}_variant", 1))


def _are_compatible(effects: Sequence[str], locations: Sequence[str]) -> bool:
    """True if no two effects exclude each other on one joint, or look alike on the whole robot."""
    for k, (effect, location) in enumerate(zip(effects, locations, strict=True)):
        for other, other_location in zip(effects[:k], locations[:k], strict=True):
            if location == other_location and any({effect, other} <= exclusive for exclusive in _EXCLUSIVE):
                return False
    return not {"gravity_tilt", "encoder_offset"} <= set(effects)


KINDS: dict[str, Callable[[Robot, Sequence[str], int], list[Case]]] = {
    "single": _single,
    "pairs": partial(_combinations, count=2),
    "triples": partial(_combinations, count=3),
    "several": _several,
    "clean": _clean,
    "unknown": _unknown,
    "variants": _variants,
}


def _hidden_effect(robot: Robot, effect: str, location: str, magnitude: str, form: str | None = None) -> HiddenEffect:
    parameters = {"form": form} if form else {}
    if location == "all":
        return HiddenEffect(effect, magnitude=magnitude, parameters=parameters)
    if location in robot.names:
        return HiddenEffect(effect, joint=location, magnitude=magnitude, parameters=parameters)
    return HiddenEffect(effect, link=location, magnitude=magnitude, parameters=parameters)


def _case(robot: Robot, hidden: Sequence[HiddenEffect], seed: int) -> Case:
    effects = [f"{effect.parameters.get('form', effect.effect)}.{effect.location}" for effect in hidden] or ["clean"]
    magnitudes = dict.fromkeys(effect.magnitude for effect in hidden)
    parts = (robot.name, "+".join(effects), "+".join(magnitudes), f"s{seed}")
    name = "_".join(part for part in parts if part)
    # On these robots an encoder offset can't be told from other inertias.
    needs_fixed = robot.name != "arm6" and any(effect.effect == "encoder_offset" for effect in hidden)
    is_fixed = needs_fixed or any(effect.effect in NEED_FIXED_INERTIA for effect in hidden)
    inertia = "fixed" if is_fixed else "refit"
    return Case(name, robot.name, tuple(hidden), seed, inertia, sensors=sensors_for_seed(seed))
