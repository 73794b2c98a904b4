"""`LoadedLog`: what is kept of a log, which is read once: its inspection, and as many samples as trials look at.

Where a file holds several topics, the robot's own is found.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from idtool.common.exceptions import LogError
from idtool.common.names import join_names
from idtool.data.inspection import Inspection, inspect_log
from idtool.data.inspection.records import Joint
from idtool.data.logs import Log, read_log
from idtool.data.logs.state_topics import state_topics
from idtool.estimation.dataset.experiment import Progress
from idtool.robot.config import Config
from idtool.robot.urdf.reading import Robot

MOST = 200_000  # samples of a log that trials look at: more tell them nothing new


@dataclass(frozen=True)
class LoadedLog:
    """What is kept of a log.

    Attributes
    ----------
    log
        Of a long one its first samples; torque that was not filled in is left out.
    inspection
        Of the whole log.
    middle
        Median position by joint [rad or m].
    unfilled
        Joints with a torque that never changes while they move: drivers without a sensor publish zeros.
    """

    log: Log
    inspection: Inspection
    middle: dict[str, float]
    unfilled: tuple[str, ...]

    def signals(self, joint: str) -> set[str]:
        """The signals that a joint has."""
        return set(self.inspection.joints[joint].signals) - ({"tau"} if joint in self.unfilled else set())

    def moves(self, joint: str) -> bool:
        """Whether the log has the joint and it moves."""
        return joint in self.inspection.joints and self.inspection.joints[joint].moves


def see(robot: Robot, paths: Sequence[Path], given: Config, topic: str | None, progress: Progress) -> list[LoadedLog]:
    """Read and inspect the logs.

    Parameters
    ----------
    robot, paths
        From the URDF; the logs.
    given
        How to read them. A joint that it names under ``joints`` and that nothing commands may have no torque at all.
    topic
        The topic to read.
    progress
        Told the stage and how far it has come.

    Raises
    ------
    LogError
        If a log cannot be read.
    """
    seen: list[LoadedLog] = []
    for path in paths:
        progress(f"inspecting {path.name}", len(seen) / len(paths))
        seen.append(_look(_read(path, given, topic), robot, given.joints or ()))
    return seen


def _read(path: Path, given: Config, topic: str | None) -> Log:
    options = given.log
    return read_log(path, topic=topic, columns=options.columns, scale=dict(options.scale))


def _look(log: Log, robot: Robot, passive: Collection[str]) -> LoadedLog:
    q = log.signals["q"]
    middle = {name: float(np.nanmedian(q[:, i])) for i, name in enumerate(log.joints) if log.has("q", name)}
    inspection = inspect_log(log)
    unfilled = tuple(
        name
        for name, joint in inspection.joints.items()
        if _is_unfilled(joint) and ("qcmd" in joint.signals or name not in passive)
    )
    kept = _without_torque(shortened(log), unfilled)
    return LoadedLog(kept, inspection, {name: x for name, x in middle.items() if name in robot.joints}, unfilled)


def _is_unfilled(joint: Joint) -> bool:
    return joint.moves and "tau" in joint.signals and joint.signals["tau"].constant


def shortened(log: Log) -> Log:
    """The log, of a long one its first samples; it keeps no hold of the others."""
    kept, left = [], MOST
    for segment in log.segments:
        if left > 1:
            kept.append(slice(segment.start, min(segment.stop, segment.start + left)))
            left -= segment.stop - segment.start
    last = kept[-1].stop
    if last == log.segments[-1].stop:
        return log
    signals = {name: x[:last].copy() for name, x in log.signals.items()}
    return replace(log, t=log.t[:last].copy(), signals=signals, segments=tuple(kept))


def _without_torque(log: Log, joints: Sequence[str]) -> Log:
    """The log as if nothing stood in the torque of some joints."""
    if not joints:
        return log
    tau = log.signals["tau"].copy()
    tau[:, [log.joints.index(name) for name in joints]] = np.nan
    return replace(log, signals={**log.signals, "tau": tau})


def find_topic(robot: Robot, paths: Sequence[Path], given: Config) -> tuple[str | None, tuple[str, ...]]:
    """The topic with most of the robot's joints, then most signals, in all logs; and the topics to choose from.

    Raises
    ------
    LogError
        If the logs have no topic in common.
    """
    if given.log.topic is not None:
        return given.log.topic, ()
    topics = {path: state_topics(path) for path in paths if path.exists()}
    several = next((path for path, names in topics.items() if len(names) > 1), None)
    if several is None:
        return None, ()
    shared = [name for name in topics[several] if all(name in names for names in topics.values() if names)]
    if not shared:
        raise LogError(several, f"has none of its topics in common with the other logs: {join_names(topics[several])}")

    def worth(name: str) -> tuple[int, int]:
        try:
            log = _read(several, given, name)
        except LogError:  # commands of joints have the type of their states, but no position
            return -1, 0
        known = [joint for joint in log.joints if joint in robot.joints]
        return len(known), sum(log.has(signal, joint) for joint in known for signal in log.signals)

    return max(shared, key=worth), tuple(shared)
