"""Unknown keys: the key that was meant, the section it belongs to, and an example that can be used as it is."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
import yaml

from idtool.robot.config import Config, parse_config
from idtool.robot.config.example import EXAMPLE

Refusal = Callable[[str | bytes], str]

ROTOR = "rotors: {hip_rotor: {joint: hip, gear_ratio: 9, inertia: 0.0001}}"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("kp: 25", "kp belongs under controller: controller: {kp: 25}"),
        ("kp: {hip: 25}", "kp belongs under controller: controller: {kp: {hip: 25}}"),
        ("kp: soft", "kp belongs under controller: controller: {kp: 25}"),  # their own value would be no use
        ("mass: {thigh: 1}", "mass belongs under known: known: {mass: {thigh: 1}}"),
        ("gear_ratio: 9", f"gear_ratio belongs under rotors: {ROTOR}"),
        ("kind: floating", "kind belongs under regularization, filter, base or contacts: regularization: {kind: eu"),
        ("controller: {cutoff_hz: 30}", "controller: cutoff_hz belongs under filter: filter: {cutoff_hz: 30}"),
        ("filter: {seed: 1}", "filter: seed belongs at the top level: seed: 1"),
        ("log: {tau: {hip: 3}}", "log: tau belongs under log.scale: log: {scale: {tau: {hip: 3}}}"),
        (
            "rotors: {r: {joint: hip, gear_ratio: 9, mass: 1}}",
            "rotors.r: mass belongs under rotors.<name>.inertial: rotors: {knee_rotor: {inertial: {mass: 0.1}}}",
        ),
        (
            "effects: [{effect: torque_offset, joint: hip, offset: 3}]",
            "effects.0: offset belongs under parameters: "
            "effects: [{effect: torque_offset, joint: hip, parameters: {offset: 3}}]",
        ),
        (
            "ellipsoid: {thigh: [{semi_axes: [1, 1, 1]}]}",
            "unknown key 'ellipsoid'; did you mean 'bounding_ellipsoids'? "
            "Write bounding_ellipsoids: {thigh: [{semi_axes: [1, 1, 1]}]}",
        ),
        ("jonts: [hip]", "unknown key 'jonts'; did you mean 'joints'? Write joints: [hip]"),
        ("joint: hip", "unknown key 'joint'; did you mean 'joints'? Write joints: [hip, knee]"),
        ("cutof: 30", "unknown key 'cutof'; did you mean 'cutoff_hz' under filter? Write filter: {cutoff_hz: 30}"),
        ("rotor_inertia: 0.05", "unknown key 'rotor_inertia'; did you mean 'armature'? Write armature: 0.05"),
        (
            "damping: 0.1",
            "unknown key 'damping'; did you mean 'viscous' under friction? Write friction: {viscous: 0.1}",
        ),
        ("rotors: {joint: hip, gear_ratio: 9}", f"rotors.joint: belongs under a name of your choice: {ROTOR}"),
        (
            "controller: {hip: {kp: 25}}",
            "controller: unknown key 'hip'; available: kp, kd, delay; for example controller: {kp: 25}",
        ),
        ("xyzzy: 3", "unknown key 'xyzzy'; available: joints, locked_joints, "),
    ],
)
def test_the_answer_to_an_unknown_key(refusal: Refusal, text: str, expected: str) -> None:
    assert refusal(text).startswith(expected)


@pytest.mark.parametrize("value", ["[" * 90 + "]" * 90, "2020-01-01", f"'{'long ' * 100}'", '"\\u2028\\e[2J"'])
def test_values_that_are_no_use_are_left_out(refusal: Refusal, value: str) -> None:
    refusal(f"kp: {value}")


def keys(data: object) -> Iterator[str]:
    """Keys of plain data at every depth."""
    if isinstance(data, dict):
        yield from data
        for value in data.values():
            yield from keys(value)
    elif isinstance(data, list):
        for value in data:
            yield from keys(value)


def test_the_example_is_a_configuration_with_every_key() -> None:
    assert parse_config(yaml.safe_load(EXAMPLE), "example").model_fields_set == set(Config.model_fields)


@pytest.mark.parametrize("key", list(Config.model_fields))
def test_every_section_has_an_example_that_can_be_used(refusal: Refusal, key: str) -> None:
    message = refusal(f"{key}x: no value that fits")
    assert f"did you mean '{key}'? Write {key}: " in message
    example = yaml.safe_load(message.partition(" Write ")[2])
    assert parse_config(example, "example").model_fields_set == {key}


def test_every_key_has_an_example() -> None:
    named: set[str] = set()

    def collect(part: object) -> None:
        if isinstance(part, dict):
            named.update(part["properties"] if isinstance(part.get("properties"), dict) else ())
            for value in part.values():
                collect(value)
        elif isinstance(part, list):
            for value in part:
                collect(value)

    collect(Config.model_json_schema())
    assert len(named) > 80
    assert named - set(keys(yaml.safe_load(EXAMPLE))) == set()
