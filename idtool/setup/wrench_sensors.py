"""The section ``wrench_sensors`` of a first configuration: sensors of force and moment at fixed joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from idtool.common.names import join_names
from idtool.robot.model import WRENCH_SIZE
from idtool.robot.urdf.reading import Robot, UrdfJoint
from idtool.setup.name_matching import SENSOR_WORDS, match, words
from idtool.setup.records import ConfigSection, TodoItem


def wrench_sensor_joints(robot: Robot, wrenches: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Fixed joint of each sensor of force and moment that is not a contact, by its name in the logs.

    Parameters
    ----------
    robot
        The robot.
    wrenches
        Channels of each sensor by its name; those of a force alone do not count.
    """
    carrying = {joint.parent for joint in robot.joints.values()}
    loaded = [joint for joint in robot.joints.values() if joint.kind == "fixed" and _has_load(robot, joint)]
    between = [joint.name for joint in loaded if joint.child in carrying]
    at_ends = [joint.name for joint in loaded if joint.child not in carrying]
    complete = [name for name, channels in wrenches.items() if len(channels) == WRENCH_SIZE]
    sensors: dict[str, str] = {}
    for name in complete:
        joint = _named_sensor(name, [*between, *at_ends]) or match(name, between)
        if name in robot.links and joint != name:
            continue  # it is a contact
        if joint is None and match(name, list(robot.links)) is None:
            joint = match(name, at_ends) or _only_sensor([*between, *at_ends], complete)
        if joint is not None and joint not in sensors.values():
            sensors[name] = joint
    return sensors


def _named_sensor(name: str, joints: Sequence[str]) -> str | None:
    """The joint of that name, or the joint named as a sensor that the name of a sensor means; None without one."""
    if name in joints:
        return name
    sensor_words = set(SENSOR_WORDS)
    if not words(name) & sensor_words:
        return None
    return match(name, [joint for joint in joints if words(joint) & sensor_words])


def _has_load(robot: Robot, joint: UrdfJoint) -> bool:
    """True if a joint carries mass."""
    links = [joint.child]
    for link in links:  # which grows on the way
        links += [other.child for other in robot.joints.values() if other.parent == link]
    return any(pi[0] > 0 for link in links if (pi := robot.links[link]) is not None)


def _only_sensor(joints: Sequence[str], logged: Sequence[str]) -> str | None:
    """The only joint named as a sensor, for the only sensor that was logged; None if there are others."""
    named = [joint for joint in joints if words(joint) & set(SENSOR_WORDS)]
    return named[0] if len(named) == len(logged) == 1 else None


def wrench_sensors_section(sensors: Mapping[str, str]) -> ConfigSection:
    """The section, without the signs: joint of each sensor by its name in the logs."""
    comment = (
        "Sensors of force and moment at fixed joints (names in logs and URDF). offset: the reading without load, which "
        "idtool fit determines for each log."
    )
    entries = []
    for name, joint in sensors.items():
        channel = {} if name == joint else {"channel": name}
        entries.append({"joint": joint, **channel, "sign": 1, "offset": "fit"})
    return ConfigSection("wrench_sensors", (comment,), entries)


def with_signs(section: ConfigSection, signs: Mapping[str, int]) -> tuple[ConfigSection, tuple[TodoItem, ...]]:
    """The section with the signs as the logs tell them, and what they do not tell.

    Parameters
    ----------
    section
        From `wrench_sensors_section`.
    signs
        By joint, from `sensor_signs`.
    """
    entries = [{**entry, "sign": signs.get(entry["joint"], 1)} for entry in section.value]
    unknown = [entry["joint"] for entry in entries if entry["joint"] not in signs]
    comment = "sign: 1 if a hanging load reads a force upward, else -1 (logs and the URDF's masses)."
    todo: tuple[TodoItem, ...] = ()
    if unknown:
        comment += f" The logs do not tell that of {join_names(unknown)}: check it."
        todo = (TodoItem("wrench_sensors.sign", f"1 or -1, for {join_names(unknown)}"),)
    return replace(section, comments=(*section.comments, comment), value=entries), todo
