"""`Draft`: all that the sections of a first configuration are written from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from idtool.robot.config import Config
from idtool.robot.urdf.reading import Robot
from idtool.setup.bounds import Bounds
from idtool.setup.recorded import Recorded
from idtool.setup.trials import Found

_UNITS = {  # of a turning joint, and of a sliding one
    "torque": ("N·m", "N"),
    "stiffness": ("N·m/rad", "N/m"),
    "damping": ("N·m·s/rad", "N·s/m"),
}


@dataclass(frozen=True)
class Draft:
    """What is known so far.

    Attributes
    ----------
    robot
        From the URDF.
    paths
        The logs.
    recorded
        What the logs tell.
    given, source
        A configuration to start from, plain data, and its file; none: empty.
    config
        The same, checked.
    bounds
        Bounding ellipsoids.
    ratios, rotors
        Gear ratio and URDF link of the rotor, by joint.
    found
        What trials found; None: there were none, as ``untried`` says.
    untried
        Why there were no trials.
    """

    robot: Robot
    paths: tuple[Path, ...]
    recorded: Recorded
    given: Mapping[str, Any]
    source: Path | None
    config: Config
    bounds: Bounds
    ratios: Mapping[str, float]
    rotors: Mapping[str, str]
    found: Found | None = None
    untried: str = ""

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints that are identified."""
        return self.recorded.joints

    @property
    def locked(self) -> dict[str, float]:
        """Where the others are held [rad or m], as given or as found."""
        return {name: lock.position for name, lock in self.recorded.locked.items()} | self.config.locked_joints

    @property
    def origin(self) -> str:
        """What is given comes from there, in words."""
        return self.source.name if self.source else "the configuration"

    @property
    def ungained(self) -> tuple[str, ...]:
        """Joints that have neither torque nor gains to compute it with."""
        gains = self.config.controller.kp if self.config.controller else {}
        return tuple(name for name in self.recorded.commanded if name not in gains)

    def unit(self, what: str, joints: Sequence[str]) -> str:
        """The unit of something of some joints, or both where some turn and others slide."""
        sliding = (self.robot.joints[name].kind == "prismatic" for name in joints)
        return " or ".join(dict.fromkeys(_UNITS[what][slides] for slides in sorted(sliding)))
