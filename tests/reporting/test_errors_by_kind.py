"""Errors of rows that belong together: all joints, and the components of a force or moment."""

from __future__ import annotations

import pytest

from idtool.reporting.fit_report import rms_by_kind
from idtool.reporting.sections.base import kind_units

FORCE = ("base_force_x", "base_force_y", "base_force_z")
KINDS = {"joints": ("hip", "knee"), "base_force": FORCE}


def test_only_a_whole_vector_has_a_length() -> None:
    errors = {"hip": 3.0, "knee": 4.0, **dict(zip(FORCE, (2.0, 3.0, 6.0), strict=True))}
    assert rms_by_kind(errors, KINDS) == pytest.approx({"joints": 12.5**0.5, "base_force": 7.0})
    lacking = {**errors, "knee": None, "base_force_y": None}
    assert rms_by_kind(lacking, KINDS) == {"joints": 3.0, "base_force": None}
    assert rms_by_kind({**lacking, "hip": None}, KINDS)["joints"] is None


def test_joint_may_have_the_name_of_a_force() -> None:
    """Which is no row of a sensor."""
    units = {"hip": "N·m", "grip_force_x": "N·m", **dict.fromkeys(FORCE, "N")}
    assert kind_units(["joints", "base_force"], units) == {"joints": "N·m", "base_force": "N"}
    sliding = {**units, "grip_force_x": "N"}
    assert kind_units(["joints", "base_force"], sliding)["joints"] == "mixed N·m and N"
