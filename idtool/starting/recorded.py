"""What the logs tell: which joints can be identified, which stand still, how fast they move, what torque there is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from idtool.config import Config
from idtool.exceptions import LogError
from idtool.inspection import Inspection, inspect_log
from idtool.inspection.findings import BAND
from idtool.logs import Log, read_log
from idtool.logs.choices import state_topics
from idtool.model import build_model
from idtool.names import some
from idtool.robot import Joint, Robot
from idtool.signals import default_cutoff

Progress = Callable[[str, float], None]

_LEAST_BAND = 5.0  # Hz: below it, friction at reversals is blurred into everything else


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
    paths
        The logs.
    joints
        Joints that can be identified, in the URDF's order.
    locked
        The URDF's other actuated joints.
    commanded
        Those of ``joints`` that some log has a position command of, but no torque.
    topic, topics
        The topic that is read, where there are several; and those that there are.
    rates_hz
        Of each log.
    motion_hz
        Below this lies what moves the joints: the widest band of a joint's velocity, the median over the logs.
    cutoff_hz
        The filter's cut-off by that.
    warnings
        What a user should know.
    """

    paths: tuple[Path, ...]
    joints: tuple[str, ...]
    locked: dict[str, Locked]
    commanded: tuple[str, ...]
    topic: str | None
    topics: tuple[str, ...]
    rates_hz: tuple[float, ...]
    motion_hz: float
    cutoff_hz: float
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class _Seen:
    """What is kept of a log."""

    inspection: Inspection
    middle: dict[str, float]  # median position


def recorded(robot: Robot, paths: Sequence[Path], given: Config, progress: Progress) -> Recorded:
    """Read and inspect the logs.

    Parameters
    ----------
    robot, paths
        From the URDF; the logs.
    given
        What is known of how to read them, and which joints are wanted.
    progress
        Told the stage and how far it has come.

    Raises
    ------
    IdtoolError
        If a log cannot be read, or has no joint of the robot that moves and has a torque or a command.
    """
    topic, topics = _topic(robot, paths, given)
    seen: list[_Seen] = []
    for path in paths:
        progress(f"inspecting {path.name}", len(seen) / len(paths))
        seen.append(_look(_read(path, given, topic), robot))
    joints, locked = _divided(robot, given, seen)
    if not joints:
        why = some([f"{name} {lock.why}" for name, lock in locked.items()])
        raise LogError(paths[0], f"no joint of the robot can be identified: {why}")
    motion = float(np.median([_motion(one, joints) for one in seen]))
    return Recorded(
        paths=tuple(paths),
        joints=tuple(joints),
        locked=locked,
        commanded=tuple(name for name in joints if not all("tau" in _signals(one, name) for one in seen)),
        topic=topic if topics else None,
        topics=topics,
        rates_hz=tuple(one.inspection.rate_hz for one in seen),
        motion_hz=motion,
        cutoff_hz=_cutoff(motion, min(default_cutoff(one.inspection.dt) for one in seen)),
        warnings=tuple(_problems(seen, joints)),
    )


def _read(path: Path, given: Config, topic: str | None) -> Log:
    options = given.log
    return read_log(path, topic=topic, columns=options.columns, scale=dict(options.scale))


def _topic(robot: Robot, paths: Sequence[Path], given: Config) -> tuple[str | None, tuple[str, ...]]:
    """The topic with most of the robot's joints, then most signals, in all logs; and the topics to choose from."""
    if given.log.topic is not None:
        return given.log.topic, ()
    topics = {path: state_topics(path) for path in paths if path.exists()}
    several = next((path for path, names in topics.items() if len(names) > 1), None)
    if several is None:
        return None, ()
    shared = [name for name in topics[several] if all(name in names for names in topics.values() if names)]

    def worth(name: str) -> tuple[int, int]:
        log = _read(several, given, name)
        known = [joint for joint in log.joints if joint in robot.joints]
        return len(known), sum(log.has(signal, joint) for joint in known for signal in log.signals)

    if not shared:
        raise LogError(several, f"has none of its topics in common with the other logs: {some(topics[several])}")
    return max(shared, key=worth), tuple(shared)


def _look(log: Log, robot: Robot) -> _Seen:
    q = log.signals["q"]
    middle = {name: float(np.nanmedian(q[:, i])) for i, name in enumerate(log.joints) if log.has("q", name)}
    return _Seen(inspect_log(log), {name: x for name, x in middle.items() if name in robot.joints})


def _signals(seen: _Seen, joint: str) -> set[str]:
    return set(seen.inspection.joints[joint].signals)


def _divided(robot: Robot, given: Config, seen: Sequence[_Seen]) -> tuple[list[str], dict[str, Locked]]:
    """Joints to identify, and those that are held still."""
    logged = [name for name in seen[0].inspection.joints if all(name in one.inspection.joints for one in seen)]
    wanted = build_model(robot, given, logged).names  # refuses logs of another robot
    joints, locked = [], {}
    for joint in robot.joints.values():
        if joint.kind == "fixed" or joint.mimic is not None:
            continue
        why = _unfit(joint.name, seen) if joint.name in logged else "not in every log"
        if why is None and joint.name not in wanted:
            why = "left out of joints"
        if why is None:
            joints.append(joint.name)
        else:
            locked[joint.name] = Locked(_resting(joint, seen), why)
    return joints, locked


def _unfit(joint: str, seen: Sequence[_Seen]) -> str | None:
    """Why a joint cannot be identified; None where it can."""
    if not all("q" in _signals(one, joint) for one in seen):
        return "has no position in some log"
    if not any(one.inspection.joints[joint].moves for one in seen):
        return "does not move"
    if not all({"tau", "qcmd"} & _signals(one, joint) for one in seen):
        return "has neither torque nor position command in some log"
    return None


def _resting(joint: Joint, seen: Sequence[_Seen]) -> float:
    """Where a joint is held: where the logs have it, else at zero or the limit next to it [rad or m]."""
    logged = [one.middle[joint.name] for one in seen if joint.name in one.middle]
    if logged:
        return round(float(np.median(logged)), 4)
    return float(min(max(0.0, joint.lower), max(joint.upper, joint.lower)))


def _motion(seen: _Seen, joints: Sequence[str]) -> float:
    """Frequency below which the joints' velocities lie [Hz]."""
    bands = (seen.inspection.joints[name].band_hz for name in joints)
    return max((band for band in bands if band is not None), default=0.0)


def _cutoff(motion: float, most: float) -> float:
    """The filter's cut-off for a motion below a frequency, to two digits [Hz]."""
    return float(f"{min(max(BAND * motion, _LEAST_BAND), most):.2g}")


def _problems(seen: Sequence[_Seen], joints: Sequence[str]) -> list[str]:
    """Problems that an inspection finds in what is used, those of one kind together."""
    found: Counter[tuple[str, str]] = Counter()
    which: dict[tuple[str, str], list[str]] = {}
    for one in seen:
        for finding in one.inspection.findings:
            if finding.severity == "problem" and finding.joint in (None, *joints):
                key = Path(one.inspection.path).name, finding.meaning
                found[key] += 1
                which.setdefault(key, []).append(f"{finding.joint}: {finding.what}" if finding.joint else finding.what)
    said = [w for one in seen for w in one.inspection.warnings]
    return said + [f"{name}: {some(which[name, meaning])}: {meaning}" for name, meaning in found]
