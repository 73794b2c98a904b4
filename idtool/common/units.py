"""Units of joints: of their torque, "N·m" or "N", and of their position."""

from __future__ import annotations

from collections.abc import Mapping

POSITION_UNITS = {"N·m": "rad", "N": "m"}  # of a joint, by that of its torque


def position_units(torque_units: Mapping[str, str]) -> dict[str, str]:
    """Unit of each joint's position, by that of its torque."""
    return {joint: POSITION_UNITS[unit] for joint, unit in torque_units.items()}


def units_text(units: Mapping[str, str]) -> str:
    """Units of several joints as text, each once."""
    return " or ".join(dict.fromkeys(units.values()))


def common_unit(units: Mapping[str, str]) -> str:
    """The unit of a value over all joints with these units."""
    kinds = list(dict.fromkeys(units.values()))
    if len(kinds) == 1:
        return kinds[0]
    return f"mixed {' and '.join(kinds)}"
