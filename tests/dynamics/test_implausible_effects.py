"""Effects that no robot has: refused just beyond the limit that the documentation states, not just within it."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from paths import CHECKOUT

from idtool.dynamics.effects import NamedEffect, effect_types
from idtool.dynamics.effects.joint_effect import JointEffect

PEAK, TRAVEL, SPEED = 20.0, 1.5, 2.0  # N·m, rad, rad/s rms
DEADBAND, DT = 0.04, 0.005  # rad/s, s: the noise of the position is their product
LINK, ROTOR = 3.0, 0.5  # kg

PAGE = (CHECKOUT / "docs" / "pages" / "howto" / "diagnosis.md").read_text()


def body(mass: float) -> SimpleNamespace:
    return SimpleNamespace(pi=np.array([mass, *np.zeros(9)]))


# Of the second of two joints; those of the first would let everything pass, or nothing.
SUMMARY: Any = SimpleNamespace(
    model=SimpleNamespace(names=("first", "second"), bodies=(body(LINK), body(ROTOR))),
    peak_torque=np.array([1e9, PEAK]),
    q_min=np.array([0.0, -TRAVEL]),
    q_max=np.array([1e9, 0.0]),
    q_range=np.array([1e9, TRAVEL]),
    velocity_deadband=np.array([0.0, DEADBAND]),
    rms_velocity=np.array([1e9, SPEED]),
    dt=DT,
    has_effect=lambda effect, owner: False,
)

# By effect: other parameters, the parameter with a limit, the limit, whether what is above it is refused, the sentence,
# and the rule on the page.
FRICTION = "is larger than the largest torque of the joint, 20"
FRICTION_RULE = "dry friction larger than the largest torque of the joint"
LIMITS: dict[str, list[tuple[dict[str, Any], str, float, bool, str, str]]] = {
    "coulomb_friction": [({}, "coulomb", PEAK, True, FRICTION, FRICTION_RULE)],
    "stribeck_friction": [({"velocity": 0.1}, "stribeck", PEAK, True, FRICTION, FRICTION_RULE)],
    "presliding_hysteresis": [({"displacement": 0.1}, "amplitude", PEAK, True, FRICTION, FRICTION_RULE)],
    "rounded_friction": [
        ({"velocity": 0.01, "lead": 0.0}, "coulomb", PEAK, True, FRICTION, FRICTION_RULE),
        ({"coulomb": 1.0, "lead": 0.01}, "velocity", 0.1 * SPEED, True, "its change of sign is too wide", ""),
    ],
    "joint_elasticity": [
        (
            {},
            "stiffness",
            PEAK / TRAVEL,
            False,
            "it would deflect by 1.5 at the largest torque, more than the joint travels",
            "a joint elasticity that deflects by more than the joint's travel",
        ),
        (
            {},
            "stiffness",
            PEAK / (DEADBAND * DT),
            True,
            "it would deflect by 0.0002 at the largest torque, less than the noise of the position",
            "by less than the noise of its position",
        ),
    ],
    "parallel_spring": [
        (
            {"stiffness": 1.0},
            "rest_position",
            19.5 * TRAVEL,
            True,
            "as it would be at rest at 29.3: an offset",
            "a spring whose torque hardly varies over the joint's travel",
        )
    ],
    "torque_ripple": [
        (
            {},
            "periods",
            2 * np.pi / TRAVEL,
            False,
            "it may be a spring, a stop or an offset",
            "a torque ripple with less than one period in the joint's travel",
        )
    ],
    "payload": [
        (
            {},
            "mass",
            LINK + ROTOR,
            True,
            "is more than that of all bodies of the model, 3.50 kg",
            "a payload heavier than all bodies of the model",
        )
    ],
}
CASES = [(effect, *limit) for effect, limits in LIMITS.items() for limit in limits]


def objection(effect: str, values: Mapping[str, Any]) -> str:
    kind = effect_types()[effect]
    return kind.implausibility(values, "second" if issubclass(kind, JointEffect) else None, SUMMARY)


@pytest.mark.parametrize(("effect", "others", "name", "limit", "above", "sentence", "rule"), CASES)
def test_a_limit_is_where_it_is_said_to_be(
    effect: str, others: dict[str, Any], name: str, limit: float, above: bool, sentence: str, rule: str
) -> None:
    within, beyond = (limit * (1 - 1e-6), limit * (1 + 1e-6))
    if not above:
        within, beyond = beyond, within
    assert objection(effect, {**others, name: within}) == ""
    assert objection(effect, {**others, name: beyond}).endswith(sentence)
    assert rule in PAGE.replace("\n", " ")


def test_all_effects_with_a_limit_are_here() -> None:
    limited = set()
    for id, kind in effect_types().items():
        own = kind.implausibility.__func__  # type: ignore[attr-defined]
        if own not in (NamedEffect.implausibility.__func__, JointEffect.implausibility.__func__):  # type: ignore[attr-defined]
            limited.add(id)
        if issubclass(kind, JointEffect) and kind.dry_friction.__func__ is not JointEffect.dry_friction.__func__:  # type: ignore[attr-defined]
            limited.add(id)
    assert limited == set(LIMITS)


def test_without_a_lead_no_change_of_sign_is_too_wide() -> None:
    assert objection("rounded_friction", {"coulomb": 1.0, "velocity": 100 * SPEED, "lead": 0.0}) == ""
