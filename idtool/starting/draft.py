"""`Draft`: all that the sections of a first configuration are written from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from idtool.config import Config
from idtool.robot import Robot
from idtool.starting.bounds import Bounds
from idtool.starting.recorded import Recorded
from idtool.starting.trials import Found


@dataclass(frozen=True)
class Draft:
    """What is known so far.

    Attributes
    ----------
    robot
        From the URDF.
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
        return self.recorded.joints if self.config.joints is None else self.config.joints

    @property
    def locked(self) -> dict[str, float]:
        """Where the others are held [rad or m], as given or as found."""
        found = {name: lock.position for name, lock in self.recorded.locked.items() if name not in self.joints}
        return found | self.config.locked_joints

    @property
    def ungained(self) -> tuple[str, ...]:
        """Joints that have neither torque nor gains to compute it with."""
        gains = self.config.controller.kp if self.config.controller else {}
        return tuple(name for name in self.recorded.commanded if name not in gains)

    def unit(self, joint: str, what: str) -> str:
        """A unit that a prismatic joint has another one of."""
        prismatic = self.robot.joints[joint].kind == "prismatic"
        return {"angle": ("rad", "m"), "torque": ("N·m", "N"), "inertia": ("kg·m²", "kg")}[what][prismatic]
