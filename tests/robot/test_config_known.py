"""Keys of the configuration that say what is demanded or known of the bodies, and slips that would pass unseen."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from idtool.robot.config import Config

Read = Callable[[str | bytes], Config]
Refusal = Callable[[str | bytes], str]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        # Regularization.
        ("regularization: {kind: ridge}", "regularization.kind: input should be 'none', 'euclidean', 'entropic' or"),
        ("regularization: {units: mm}", "regularization.units: input should be 'relative' or 'si'"),
        (
            "regularization: {kind: entropic, units: si}",
            "regularization: units: si is only for kind: euclidean; entropic does not depend on units",
        ),
        (
            "regularization: {kind: pullback, units: si}",
            "regularization: units: si is only for kind: euclidean",
        ),
        # What is known otherwise.
        ("known: {mass: {thigh: -0.6}}", "known.mass.thigh.value: input should be greater than 0"),
        ("known: {mass: {thigh: 0}}", "known.mass.thigh.value: input should be greater than 0"),
        ("known: {mass: {thigh: heavy}}", "known.mass.thigh.value: input should be a valid number"),
        ("known: {mass: {thigh: {valu: 1}}}", "known.mass.thigh: unknown key 'valu'; did you mean 'value'?"),
        (
            "known: {mass: {thigh: {value: 1, standard_error: 0}}}",
            "known.mass.thigh.standard_error: input should be greater than 0",
        ),
        ("known: {mass: 2.3}", "known.mass: input should be a mapping of keys to values"),
        ("known: {mas: {thigh: 1}}", "known: unknown key 'mas'; did you mean 'mass'?"),
        ("known: {total_mass: .nan}", "known.total_mass.value: input should be"),
        ("known: {total_mass: {standard_error: 0.1}}", "known.total_mass.value: field required"),
        ("known_com: {thigh: [0, 0]}", "known_com.thigh.2: field required"),
        # Copies.
        ("mirror: {body: a, of: b}", "mirror: input should be a list"),
        ("mirror: [{body: a, of: a}]", "mirror.0: a cannot be a copy of itself; name another"),
        ("mirror: [{joint: a, of: a}]", "mirror.0: a cannot be a copy of itself; name another"),
        ("mirror: [{body: a, of: b, plane: zx}]", "mirror.0.plane: input should be 'xy', 'xz' or 'yz'"),
        ("mirror: [{joint: a, of: b, plane: xz}]", "mirror.0: plane is only for bodies, not for joints"),
        ("mirror: [{of: b}]", "mirror.0: give `of`, and either `body` or `joint`"),
        ("mirror: [{body: a, joint: a, of: b}]", "mirror.0: give `of`, and either `body` or `joint`"),
        ("mirror: [{body: a}]", "mirror.0.of: field required"),
        # Bounding shapes.
        (
            "bounding_shapes: {a: [{kind: cone, radius: 1}]}",
            "bounding_shapes.a.0: needs a kind that is one of box, cylinder, capsule, hull, not cone",
        ),
        (
            "bounding_shapes: {a: [{size: [1, 1, 1]}]}",
            "bounding_shapes.a.0: needs a kind that is one of box, cylinder, capsule, hull",
        ),
        ("bounding_shapes: {a: [{kind: box}]}", "bounding_shapes.a.0.size: field required"),
        (
            "bounding_shapes: {a: [{kind: box, size: [1, 1, 0]}]}",
            "bounding_shapes.a.0.size.2: input should be greater than 0",
        ),
        (
            "bounding_shapes: {a: [{kind: cylinder, radius: 1, height: 2}]}",
            "bounding_shapes.a.0: unknown key 'height'; did you mean 'length'?",
        ),
        (
            "bounding_shapes: {a: [{kind: capsule, radius: 1e-9, length: 1}]}",
            "bounding_shapes.a.0.radius: input should be at least 1e-06 m",
        ),
        ("bounding_shapes: {a: [box]}", "bounding_shapes.a.0: input should be a mapping of keys to values"),
        ("bounding_shapes: {a: [{kind: [box]}]}", "bounding_shapes.a.0: needs a kind"),
        ("bounding_shapes: {a: {kind: box, size: [1, 1, 1]}}", "bounding_shapes.a: input should be a list"),
        # Slips that would pass for something else.
        ("log: {scale: {tau: {hip: 0}}}", "log.scale.tau.hip: a scale of 0 removes the signal"),
        ("log: {scale: {q: {hip: -0.0}}}", "log.scale.q.hip: a scale of 0 removes the signal"),
        ("joints: [hip, knee, hip]", "joints: hip is listed twice; list each joint once"),
        ("friction: {viscous: -0.1}", "friction.viscous: friction of -0.1 would drive the joint; give 0 or more"),
        ("friction: {hip: {coulomb: {value: -2}}}", "friction.hip.coulomb: friction of -2 would drive the joint"),
    ],
)
def test_a_key_of_what_is_known_or_demanded_that_does_not_fit(refusal: Refusal, text: str, expected: str) -> None:
    assert refusal(text).startswith(expected)


def test_an_offset_may_point_either_way_and_a_signal_may_be_turned_round(read: Read) -> None:
    config = read("{friction: {offset: -0.3, viscous: 0, coulomb: 0.0}, log: {scale: {q: {hip: -1}}}}")
    assert config.friction_of("hip").offset.value == -0.3  # type: ignore[union-attr]
    assert config.log.scale.q == {"hip": -1.0}
