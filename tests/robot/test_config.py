"""Configurations: an example with every key, and keys and values that are refused."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import yaml

from idtool.robot.config import Config, parse_config

Read = Callable[[str | bytes], Config]
Refusal = Callable[[str | bytes], str]

EXAMPLE = """\
joints: [abad, hip, knee]
locked_joints: {tail: 0.0}
gravity: [0, 0, -9.81]
log:
  topic: /joint_states
  columns: {t: time}
  scale: {tau: {hip: 0.118}}
velocity: auto
bounding_ellipsoids:
  thigh:
    - {center: [0, 0, -0.17], semi_axes: [0.08, 0.08, 0.25], rpy: [0, 0, 0]}
bounding_shapes:
  shank:
    - {kind: box, center: [0, 0, -0.1], size: [0.05, 0.05, 0.3], rpy: [0, 0, 0]}
    - {kind: cylinder, radius: 0.03, length: 0.2}
    - {kind: capsule, radius: 0.03, length: 0.2}
    - {kind: hull, file: shank.stl}
known_com: {abad_link: [0, 0.04, 0]}
rotors:
  hip_rotor:
    joint: hip
    gear_ratio: 10.604
    parent: abad_link
    origin: {xyz: [0, 0.045, 0], rpy: [0, 0, 0]}
    axis: [0, 1, 0]
    inertial: {mass: 0.5, com: [0, 0, 0], inertia: [1.0e-3, 0, 2.0e-3, 0, 0, 3.0e-3]}
    bounding_ellipsoid: {center: [0, 0, 0], semi_axes: [0.05, 0.05, 0.05]}
friction: {viscous: true, coulomb: true, offset: false}
constraints: ellipsoid
regularization: {kind: euclidean, weight: 1.0e-6, units: relative}
filter: {kind: butterworth, cutoff_hz: 40, order: 4}
known: {mass: {thigh: 0.634, shank: {value: 0.18, standard_error: 0.005}}, total_mass: 2.31}
mirror:
  - {body: FR_thigh, of: FL_thigh, plane: xz}
  - {joint: FR_hip, of: FL_hip}
effects:
  - {effect: torque_offset, joint: hip, parameters: {offset: 0.1}}
solver: {name: clarabel}
controller: {kp: {hip: 20.0}, kd: {hip: 1.0}, delay: 0.005}
simulation: {window: 1.0}
seed: 0
"""


def test_an_example_with_every_key(read: Read) -> None:
    config = read(EXAMPLE)
    assert config.joints == ("abad", "hip", "knee")
    assert config.locked_joints == {"tail": 0.0}
    assert config.gravity == (0.0, 0.0, -9.81)
    assert config.log.topic == "/joint_states"
    assert config.log.columns == {"t": "time"}
    assert config.log.scale.tau == {"hip": 0.118}
    (bound,) = config.bounding_ellipsoids["thigh"]
    assert bound.to_ellipsoid().center == (0.0, 0.0, -0.17)
    assert bound.to_ellipsoid().semi_axes == (0.08, 0.08, 0.25)
    rotor = config.rotors["hip_rotor"]
    assert rotor.ratios == {"hip": 10.604}
    assert rotor.parent == "abad_link"
    assert rotor.axis == (0.0, 1.0, 0.0)
    assert rotor.origin is not None
    assert rotor.inertial is not None
    assert rotor.bounding_ellipsoid is not None
    assert rotor.origin.xyz == (0.0, 0.045, 0.0)
    assert rotor.inertial.inertia == (1e-3, 0.0, 2e-3, 0.0, 0.0, 3e-3)
    assert rotor.bounding_ellipsoid.semi_axes == (0.05, 0.05, 0.05)
    assert config.constraints == "ellipsoid"
    assert (config.regularization.kind, config.regularization.weight) == ("euclidean", 1e-6)
    assert config.regularization.units == "relative"
    assert [shape.kind for shape in config.bounding_shapes["shank"]] == ["box", "cylinder", "capsule", "hull"]
    assert config.known_com == {"abad_link": (0.0, 0.04, 0.0)}
    assert config.known.mass["thigh"].model_dump() == {"value": 0.634, "standard_error": None}
    assert config.known.mass["shank"].model_dump() == {"value": 0.18, "standard_error": 0.005}
    assert config.known.total_mass is not None
    assert config.known.total_mass.value == 2.31
    thigh, hip = config.mirror
    assert (thigh.body, thigh.joint, thigh.of, thigh.plane) == ("FR_thigh", None, "FL_thigh", "xz")
    assert (hip.body, hip.joint, hip.of, hip.plane) == (None, "FR_hip", "FL_hip", None)
    assert (config.filter.kind, config.filter.cutoff_hz, config.filter.order) == ("butterworth", 40.0, 4)
    assert config.effects[0].parameters == {"offset": 0.1}
    assert config.controller is not None
    assert (config.controller.kp, config.controller.kd, config.controller.delay) == ({"hip": 20.0}, {"hip": 1.0}, 0.005)
    assert (config.solver.name, config.simulation.window, config.seed, config.velocity) == ("clarabel", 1.0, 0, "auto")


def test_every_key_has_a_default(read: Read) -> None:
    assert read("").model_dump() == read("{}").model_dump() == Config().model_dump()
    for key, value in yaml.safe_load(EXAMPLE).items():
        assert read(yaml.safe_dump({key: value})).model_dump() == parse_config({key: value}, "here").model_dump()


@pytest.mark.parametrize("number", ["1e-6", "1.0e-6", "1.E-6", "0.000001", "+1e-06", "1E-6"])
def test_numbers_as_people_write_them(read: Read, number: str) -> None:
    """YAML takes 1e-6 for text."""
    assert read(f"regularization: {{weight: {number}}}").regularization.weight == 1e-6


def test_rollouts_that_never_restart(read: Read) -> None:
    assert read("simulation: {window: null}").simulation.window is None


def test_a_coupling_stands_for_joint_and_gear_ratio(read: Read) -> None:
    rotor = read("rotors: {belt: {coupling: {hip: 10.6, knee: -10.6}}}").rotors["belt"]
    assert rotor.ratios == {"hip": 10.6, "knee": -10.6}


def test_friction_for_all_joints_alike(read: Read) -> None:
    config = read("friction: {coulomb: false, offset: {value: 0.3, standard_error: 0.01}}")
    for joint in ("hip", "knee"):
        friction = config.friction_of(joint)
        assert friction.viscous is True
        assert friction.coulomb is False
        assert friction.offset.model_dump() == {"value": 0.3, "standard_error": 0.01}  # type: ignore[union-attr]


def test_friction_by_joint(read: Read) -> None:
    config = read(
        "friction: {hip: {viscous: {value: 0.4, standard_error: 0.02}, coulomb: 0.7}, knee: {viscous: false}}"
    )
    hip, knee = config.friction_of("hip"), config.friction_of("knee")
    assert hip.viscous.model_dump() == {"value": 0.4, "standard_error": 0.02}  # type: ignore[union-attr]
    assert hip.coulomb.model_dump() == {"value": 0.7, "standard_error": None}  # type: ignore[union-attr]
    assert (knee.viscous, knee.coulomb, knee.offset) == (False, True, False)
    assert config.friction_of("abad") == Config().friction_of("abad")  # not named: the default terms


def test_friction_with_values_for_all_joints_is_not_taken_for_joints(read: Read) -> None:
    config = read("friction: {viscous: {value: 0.4}, coulomb: {value: 0.7}}")
    assert config.friction_of("hip").coulomb.value == 0.7  # type: ignore[union-attr]


@pytest.mark.parametrize("key", ["seed", "filter"])
def test_a_configuration_cannot_be_changed(key: str) -> None:
    with pytest.raises(ValueError, match="frozen"):
        setattr(Config(), key, 1)


def paths(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where the example's own keys stand; names that the user chooses are left out."""
    chosen_by_user = {
        "locked_joints",
        "columns",
        "tau",
        "bounding_ellipsoids",
        "bounding_shapes",
        "known_com",
        "rotors",
    }
    chosen_by_user |= {"known_com", "mass", "parameters", "kp", "kd"}
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        if isinstance(key, str) and not (path and path[-1] in chosen_by_user):
            yield (*path, key)
        yield from paths(value, (*path, key))


@pytest.mark.parametrize("path", list(paths(yaml.safe_load(EXAMPLE))), ids=lambda path: ".".join(map(str, path)))
def test_a_slip_in_any_key_names_the_key_that_was_meant(refusal: Refusal, path: tuple[Any, ...]) -> None:
    data = copy.deepcopy(yaml.safe_load(EXAMPLE))
    holder = data
    for key in path[:-1]:
        holder = holder[key]
    slip = path[-1] + "x"
    holder[slip] = holder.pop(path[-1])
    message = refusal(yaml.safe_dump(data))
    where = ".".join(map(str, path[:-1]))
    assert message.startswith(where)
    if where == "log.scale":
        assert "'tau'" in message
    else:
        assert f"unknown key '{slip}'; did you mean '{path[-1]}'?" in message


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("friction: {viscos: true}", "friction: unknown key 'viscos'; did you mean 'viscous'?"),
        ("friction: {hip: {viscos: true}}", "friction.hip: unknown key 'viscos'; did you mean 'viscous'?"),
        ("friction: {hip: {viscous: {valu: 1}}}", "friction.hip.viscous: unknown key 'valu'; did you mean 'value'?"),
        ("friction: {hip: {viscous: [1]}}", "friction.hip.viscous.value: input should be a valid number"),
        ("friction: 3", "friction: input should be a mapping of keys to values"),
        ("log: {preset: unitree_go2}", "log.preset: unitree_go2 is not a preset; did you mean unitree_go?"),
        ("log: {field_joints: [hip, null, hip]}", "log.field_joints: hip is listed twice; list each joint once"),
        ("log: {fields: {v: 'm[{i}].v'}}", "log: fields has no position of the joints; add q, or set preset"),
        (
            "log: {fields: {q: 'm[{i}].q'}}",
            "log: fields needs the joints' names: list them in field_joints in the order of {i}, or add the path name",
        ),
        (
            "log: {fields: {q: 'm[{i}].q', name: 'm[{i}].name'}, field_joints: [hip]}",
            "log: the joints are named twice; remove field_joints, or name from fields",
        ),
        (
            "log: {fields: {q: 'm[0].q'}, field_joints: [hip]}",
            "log.fields: q: m[0].q needs one index {i}, which stands for the joint, as in motor_state[{i}].q",
        ),
        (
            "log: {preset: unitree_go, fields: {imu.gyro: 'imu[{i}].w'}}",
            "log.fields: imu.gyro: imu[{i}].w is not of a joint, so that {i} has no meaning; give the index",
        ),
        (
            "log: {preset: unitree_go, fields: {imu.gyro: imu state}}",
            "log.fields: imu.gyro: imu state is not a path such as motor_state[{i}].q or imu_state.gyroscope",
        ),
        (
            "log: {preset: unitree_go, fields: {imu.gyro: imu > 3}}",
            "log.fields: imu.gyro: only the field of a contact has a threshold",
        ),
        (
            "log: {preset: unitree_go, fields: {contact.foot: force > much}}",
            "log.fields: contact.foot: the threshold much is not a number",
        ),
        (
            "log: {preset: unitree_go, fields: {imu.orientation: a, imu.orientation_wxyz: b}}",
            "log.fields: has the orientation twice; keep imu.orientation (xyzw) or imu.orientation_wxyz",
        ),
        (
            "log: {preset: unitree_go, fields: {imu.gyr: a}}",
            "log.fields: imu.gyr: unknown field; give one of q, v, tau",
        ),
        ("log: {fields: {q: 3}}", "log.fields.q: input should be a valid string"),
        ("log:", "log: input should be a mapping of keys to values; write it as key: value"),
        ("joints: hip", "joints: input should be a list; write it in brackets, or each item after a dash"),
        ("gravity: [0, 0]", "gravity.2: field required"),
        ("gravity: [0, 0, .nan]", "gravity.2: input should be a finite number"),
        ("gravity: [0, 0, -.inf]", "gravity.2: input should be a finite number"),
        ("locked_joints: {tail: up}", "locked_joints.tail: input should be a valid number"),
        ("locked_joints: {1: 0.0}", "locked_joints.1: input should be a valid string"),
        ("regularization: {weight: -1}", "regularization.weight: input should be greater than or equal to 0"),
        ("regularization: {weight: 1e400}", "regularization.weight: input should be a finite number"),
        ("filter: {cutoff_hz: 0}", "filter.cutoff_hz: input should be greater than 0"),
        ("filter: {order: 9}", "filter.order: input should be less than or equal to 8"),
        ("bounding_ellipsoids: {thigh: {semi_axes: [1, 1, 1]}}", "bounding_ellipsoids.thigh: input should be a list"),
        (
            "bounding_ellipsoids: {thigh: [{semi_axes: [1, 1, 0]}]}",
            "bounding_ellipsoids.thigh.0.semi_axes.2: input should be greater than 0",
        ),
        ("velocity: guessed", "velocity: input should be 'measured', 'differentiated' or 'auto'"),
        (
            "constraints: tight",
            "constraints: input should be 'none', 'semi', 'full', 'known_com', 'com_ellipsoid', 'ellipsoid', 'shape'",
        ),
        ("solver: {name: mosek}", "solver.name: input should be 'clarabel', 'cvxpy', 'log_cholesky' or 'manifold'"),
        ("controller: {kd: {hip: 1}}", "controller.kp: field required"),
        ("seed: 0.5", "seed: input should be a valid integer"),
        ("effects: [{joint: hip}]", "effects.0.effect: field required"),
        ("rotors: {r: {joint: hip}}", "rotors.r: needs joint and gear_ratio, or coupling"),
        ("rotors: {r: {gear_ratio: 3}}", "rotors.r: needs joint and gear_ratio, or coupling"),
        ("rotors: {r: {coupling: {a: 1}, joint: b}}", "rotors.r: give either joint and gear_ratio, or coupling"),
        ("rotors: {r: {joint: hip, gear_ratio: 0}}", "rotors.r: a gear ratio of 0 is not possible"),
        ("rotors: {r: {coupling: {a: 1, b: 0}}}", "rotors.r: a gear ratio of 0 is not possible"),
        ("rotors: {r: {joint: hip, gear_ratio: 3, axis: [0, 0, 0]}}", "rotors.r: axis must not be zero"),
        (
            "rotors: {r: {joint: hip, gear_ratio: 3, inertial: {mass: -1, inertia: [1, 0, 1, 0, 0, 1]}}}",
            "rotors.r.inertial.mass: input should be greater than or equal to 0",
        ),
        ("[joints, rotors]", "is not a configuration"),
        ("just words", "is not a configuration"),
    ],
)
def test_a_value_that_does_not_fit_names_its_key(refusal: Refusal, text: str, expected: str) -> None:
    assert refusal(text).startswith(expected)


def test_bounds_turn_as_urdf_says(read: Read) -> None:
    (bound,) = read(
        "bounding_ellipsoids: {a: [{semi_axes: [1, 2, 3], rpy: [0, 0, 1.5707963267948966]}]}"
    ).bounding_ellipsoids["a"]
    np.testing.assert_allclose(bound.to_ellipsoid().Q_s, np.diag([4, 1, 9]), atol=1e-12)
