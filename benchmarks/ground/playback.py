"""Playback of a designed trajectory on a robot that stands: what its feet do, and what is recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ground.logs import Recording, record_motion
from ground.motions import Motion, played
from ground.plant import Physics
from ground.robot import Array, Robot

_KP, _KD = 120.0, 3.0  # N m/rad, N m s/rad, of the quadruped's joint controllers while it stands
_PRESSED = 5.0  # N, from which the ratio of two measured forces is more than noise


@dataclass(frozen=True)
class FeetAtWorst:
    """What the feet did.

    Attributes
    ----------
    friction
        Largest ratio of the force along the ground to that across it; noise of the force sensors included.
    open_share
        Largest share of the time in which a foot is off the ground.
    """

    friction: float
    open_share: float


def play(
    robot: Robot, commands: Mapping[str, Array], friction_coefficient: float = 0.8, seed: int = 0
) -> tuple[Recording, FeetAtWorst]:
    """Recording of a robot that follows commands, by column, standing on balls; RuntimeError if it falls."""
    reference = played(commands, robot.joints)
    t = commands["t"]
    q_first, _ = reference(t[0])
    poses = robot.poses(q_first)
    heights = []
    for foot in robot.feet:
        R, p = poses[foot.link]
        heights.append((p + R @ foot.position)[2] - foot.radius)
    n = len(robot.joints)
    course = Motion(lambda time: reference(t[0] + time), np.full(n, _KP), np.full(n, _KD), -min(heights))
    physics = Physics(friction_coefficient=friction_coefficient)
    recording = record_motion(robot, course, float(t[-1] - t[0]), seed, physics)
    friction, open_share = [], []
    for foot in robot.feet:
        force = np.stack([recording.columns[f"force_{foot.name}_{axis}"] for axis in "xyz"])
        is_pressed = force[2] > _PRESSED
        friction.append((np.hypot(force[0], force[1]) / force[2])[is_pressed].max())
        open_share.append(float(np.mean(recording.columns[f"contact_{foot.name}"] == 0)))
    return recording, FeetAtWorst(max(friction), max(open_share))
