"""What the logs tell: which joints can be identified, which stand still, how fast they move, what torque there is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from idtool.common.exceptions import LogError
from idtool.common.names import join_names, printable
from idtool.common.notice import Notice
from idtool.data.inspection.channel_findings import BAND
from idtool.data.logs import Log
from idtool.data.signals import default_cutoff
from idtool.estimation.dataset.experiment import Progress
from idtool.robot.config import Config
from idtool.robot.model import build_model
from idtool.robot.urdf.reading import Joint, Robot
from idtool.setup.loaded_log import LoadedLog, find_topic, see
from idtool.setup.log_notices import log_notices

_LEAST_BAND = 5.0  # Hz: below it, friction at reversals is blurred into everything else
# Torque that is computed from a command holds kp times the noise of q, which at ω looks like an inertia of kp / ω².
_BAND_OF_COMMANDED = 2.0


@dataclass(frozen=True)
class Locked:
    """A joint that is held still: where [rad or m], and why."""

    position: float
    why: str


@dataclass(frozen=True)
class Recorded:
    """What the logs tell.

    Attributes
    ----------
    logs
        As many of their samples as trials look at.
    able
        Joints that can be identified, in the URDF's order.
    joints
        Those that are: as given, else the same.
    moving
        Those of ``joints`` that move.
    locked
        The URDF's other actuated joints.
    untold
        Joints that move and have neither torque nor position command, each with the first log that lacks both.
    commanded
        Those of ``joints`` that some log has a position command of, but no torque.
    topic, topics
        The topic that is read, where there are several; and those that there are.
    rates_hz
        Of each log.
    motion_hz
        Below this lies what moves the joints: the widest band of a joint's velocity, the median over the logs.
    bands
        How many times that the filter's cut-off is.
    cutoff_hz
        The cut-off.
    notices
        What a user should know.
    """

    logs: tuple[Log, ...]
    able: tuple[str, ...]
    joints: tuple[str, ...]
    moving: tuple[str, ...]
    locked: dict[str, Locked]
    untold: dict[str, str]
    commanded: tuple[str, ...]
    topic: str | None
    topics: tuple[str, ...]
    rates_hz: tuple[float, ...]
    motion_hz: float
    bands: float
    cutoff_hz: float
    notices: tuple[Notice, ...]


def recorded(robot: Robot, paths: Sequence[Path], given: Config, progress: Progress) -> Recorded:
    """Read and inspect the logs.

    Parameters
    ----------
    robot, paths
        From the URDF; the logs.
    given
        What is known of how to read them, which joints are wanted and which are held still.
    progress
        Told the stage and how far it has come.

    Raises
    ------
    IdtoolError
        If a log cannot be read, or has no joint of the robot that moves and has a torque or a command.
    """
    topic, topics = find_topic(robot, paths, given)
    seen = see(robot, paths, given, topic, progress)
    unfit = _unfit(robot, given, seen)
    able = tuple(name for name, why in unfit.items() if why is None)
    joints = able if given.joints is None else given.joints
    untold = {name: lacking[0] for name in unfit if (lacking := _lacking_torque(name, seen))}
    if not set(able) & set(joints):
        raise LogError(paths[0], _why_none(unfit, untold, seen))
    locked = {
        name: Locked(_resting(robot.joints[name], seen), why or "left out of joints")
        for name, why in unfit.items()
        if name not in joints
    }
    moving = tuple(name for name in joints if _moves(name, seen))
    motion = float(np.median([_motion(one, moving) for one in seen]))
    commanded = tuple(name for name in joints if any(_is_commanded(name, one) for one in seen))
    bands = _BAND_OF_COMMANDED if commanded else BAND
    return Recorded(
        logs=tuple(one.log for one in seen),
        able=able,
        joints=joints,
        moving=moving,
        locked=locked,
        untold=untold,
        commanded=commanded,
        topic=topic if topics else None,
        topics=topics,
        rates_hz=tuple(one.inspection.rate_hz for one in seen),
        motion_hz=motion,
        bands=bands,
        cutoff_hz=_cutoff(bands * motion, min(default_cutoff(one.inspection.dt) for one in seen)),
        notices=log_notices(robot, seen, joints, tuple(locked)),
    )


def _unfit(robot: Robot, given: Config, seen: Sequence[LoadedLog]) -> dict[str, str | None]:
    """Why an actuated joint cannot be identified, by joint; None where it can."""
    logged = [name for name in seen[0].inspection.joints if all(name in one.inspection.joints for one in seen)]
    # refuses logs of another robot, and a joint that is not there
    build_model(robot, given.model_copy(update={"locked_joints": {}}), logged)
    held = given.locked_joints if given.joints is None else ()
    found: dict[str, str | None] = {}
    for joint in robot.joints.values():
        if joint.kind == "fixed" or joint.mimic is not None:
            continue
        if joint.name not in logged:
            found[joint.name] = "not in every log"
        else:
            found[joint.name] = "given as held still" if joint.name in held else _why_not(joint.name, seen)
    return found


def _why_not(joint: str, seen: Sequence[LoadedLog]) -> str | None:
    """Why a joint that is in every log cannot be identified; None where it can."""
    if not all("q" in one.signals(joint) for one in seen):
        return "has no position in some log"
    if not _moves(joint, seen):
        return "does not move"
    lacking = _lacking_torque(joint, seen)
    return f"has neither torque nor position command in {join_names(lacking)}" if lacking else None


def _moves(joint: str, seen: Sequence[LoadedLog]) -> bool:
    return any(one.moves(joint) for one in seen)


def _lacking_torque(joint: str, seen: Sequence[LoadedLog]) -> list[str]:
    """The logs in which a joint that moves has neither torque nor position command."""
    if not _moves(joint, seen):
        return []
    within = [one for one in seen if joint in one.inspection.joints]
    return [one.log.path.name for one in within if not {"tau", "qcmd"} & one.signals(joint)]


def _is_commanded(joint: str, seen: LoadedLog) -> bool:
    return "qcmd" in seen.signals(joint) and "tau" not in seen.signals(joint)


def _why_none(unfit: Mapping[str, str | None], untold: Mapping[str, str], seen: Sequence[LoadedLog]) -> str:
    """That no joint can be identified, and what would help."""
    reasons = {name: why or "left out of joints" for name, why in unfit.items()}
    said = "; ".join(f"{why}: {join_names(_keys(reasons, why))}" for why in dict.fromkeys(reasons.values()))
    if untold:
        first = printable(next(iter(untold)))
        said += f"; name the torque's column in log.columns, as tau_{first}, and N·m per its unit in log.scale"
        said += "".join(f"; {notice.text}" for one in seen for notice in one.inspection.reading)
    return f"no joint of the robot can be identified: {said}"


def _keys(reasons: Mapping[str, str], reason: str) -> list[str]:
    return [name for name, why in reasons.items() if why == reason]


def _resting(joint: Joint, seen: Sequence[LoadedLog]) -> float:
    """Where a joint is held: where the logs have it, else at zero or the limit next to it [rad or m]."""
    logged = [one.middle[joint.name] for one in seen if joint.name in one.middle]
    if logged:
        return round(float(np.median(logged)), 4)
    return float(min(max(0.0, joint.lower), max(joint.upper, joint.lower)))


def _motion(seen: LoadedLog, joints: Sequence[str]) -> float:
    """Frequency below which the joints' velocities lie [Hz]."""
    bands = (seen.inspection.joints[name].band_hz for name in joints)
    return max((band for band in bands if band is not None), default=0.0)


def _cutoff(wanted: float, most: float) -> float:
    """The cut-off nearest to one that is wanted, to two digits [Hz]."""
    return float(f"{min(max(wanted, _LEAST_BAND), most):.2g}")
