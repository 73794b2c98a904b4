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
