"""`Draft`: everything that the sections of a first configuration are written from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from idtool.common.dataclass import dataclass
from idtool.dynamics.effects import effect_types
from idtool.robot.config import Config
from idtool.robot.urdf.reading import Robot
from idtool.setup.base_sections import BaseSections
from idtool.setup.bounds import Bounds
from idtool.setup.log_summary import LogSummary
from idtool.setup.trials import TrialResults

_UNITS = {  # of a turning joint, and of a sliding one
    "torque": ("N·m", "N"),
    "stiffness": ("N·m/rad", "N/m"),
    "inertia": ("kg·m²", "kg"),
    "damping": ("N·m·s/rad", "N·s/m"),
}


@dataclass(frozen=True)
class Draft:
    """Everything that the sections are written from.

    Attributes
    ----------
    robot
        The robot.
    paths
        The logs.
    log_summary
        Summary of the logs.
    given, source
        A configuration to start from, as plain data, and its file.
    config
        The same, validated.
    bounds
        Bounding ellipsoids.
    ratios, rotors
        Gear ratio and URDF link of the rotor, by joint.
    standing_links
        Masses of the links that stand still, which are not in the model, by link [kg].
    base
        Sections on a floating base, its contacts and wrench sensors.
    trial_results
        Results of the trials; None if there were none.
    no_trials_reason
        Why there were no trials.
    """

    robot: Robot
    paths: tuple[Path, ...]
    log_summary: LogSummary
    given: Mapping[str, Any]
    source: Path | None
    config: Config
    bounds: Bounds
    ratios: Mapping[str, float]
    rotors: Mapping[str, str]
    standing_links: Mapping[str, float]
    base: BaseSections
    trial_results: TrialResults | None = None
    no_trials_reason: str = ""

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints that are identified."""
        return self.log_summary.joints

    @property
    def locked(self) -> dict[str, float]:
        """Positions of the locked joints [rad or m], given or from the logs."""
        return {name: lock.position for name, lock in self.log_summary.locked.items()} | self.config.locked_joints

    @property
    def has_floating_base(self) -> bool:
        """True if the base floats, as given or as proposed."""
        proposed = self.base.values().get("base", {})
        return "floating" in (proposed.get("kind"), self.config.base.kind)

    @property
    def uses_pose(self) -> bool:
        """True if the motion of the base follows from its pose, as given or as proposed."""
        return "pose" in self.base.values().get("base", {}) or self.config.base.uses_pose

    @property
    def without_rotor(self) -> tuple[str, ...]:
        """Identified joints without a reflected inertia, whether of a given rotor or found by trial."""
        with_rotor: set[str | None] = {joint for rotor in self.config.rotors.values() for joint in rotor.ratios}
        with_rotor |= {entry.joint for entry in self.config.effects if effect_types()[entry.effect].is_rotor_inertia}
        if self.trial_results is not None:
            values = self.trial_results.values
            with_rotor |= {joint for effect, joint in values if effect_types()[effect].is_rotor_inertia}
        return tuple(joint for joint in self.joints if joint not in with_rotor)

    @property
    def origin(self) -> str:
        """Name of the source of the given values."""
        return self.source.name if self.source else "the configuration"

    @property
    def without_gains(self) -> tuple[str, ...]:
        """Joints with neither torque nor gains to compute it."""
        controller = self.config.controller
        commanded = self.log_summary.commanded
        return tuple(name for name in commanded if controller is None or controller.kp_of(name) is None)

    @property
    def with_fitted_gains(self) -> tuple[str, ...]:
        """Joints without torque whose gains are to be fitted."""
        controller = self.config.controller
        if controller is None:
            return self.without_gains if self.can_fit_gains else ()
        commanded = self.log_summary.commanded
        gains = [(controller.kp_of(name) or 0.0) + controller.kd_of(name) for name in commanded]
        return tuple(name for name, gain in zip(commanded, gains, strict=True) if math.isnan(gain))

    @property
    def can_fit_gains(self) -> bool:
        """True if both gains can be fitted: it takes velocity commands, and a robot without contacts."""
        is_free = not self.base.values() and self.config.base.kind == "fixed"
        return is_free and set(self.log_summary.velocity_commanded) == set(self.log_summary.commanded)

    def unit(self, what: str, joints: Sequence[str]) -> str:
        """The unit of a quantity of some joints; both units if some joints are revolute and others prismatic."""
        sliding = (self.robot.joints[name].kind == "prismatic" for name in joints)
        return " or ".join(dict.fromkeys(_UNITS[what][slides] for slides in sorted(sliding)))
