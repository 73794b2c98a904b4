"""Units of joints, by that of their torque, "N·m" or "N"; and standard gravity."""

from __future__ import annotations

from collections.abc import Mapping

STANDARD_GRAVITY = 9.81  # m/s²
POSITION_UNITS = {"N·m": "rad", "N": "m"}
INERTIA_UNITS = {"N·m": "kg·m²", "N": "kg"}  # of an inertia reflected at a joint


def position_units(torque_units: Mapping[str, str]) -> dict[str, str]:
    """Unit of each joint's position, by that of its torque."""
    return {joint: POSITION_UNITS[unit] for joint, unit in torque_units.items()}


def friction_units(torque_unit: str) -> tuple[str, str]:
    """Units of viscous and of dry friction at a joint."""
    return f"{torque_unit}·s/{POSITION_UNITS[torque_unit]}", torque_unit


def units_text(units: Mapping[str, str]) -> str:
    """Units of several joints as text, each once."""
    return " or ".join(dict.fromkeys(units.values()))


def common_unit(units: Mapping[str, str]) -> str:
    """The unit of a value over all joints with these units."""
    kinds = list(dict.fromkeys(units.values()))
    if len(kinds) == 1:
        return kinds[0]
    return f"mixed {' and '.join(kinds)}"
