"""The sections of a first configuration on a floating base: base, contacts, wrench sensors.

They follow from the channels of the logs, and from the names and the geometry of the URDF's links.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from typing import Any

from idtool.common.dataclass import dataclass
from idtool.common.names import join_names
from idtool.data.logs import JointLog
from idtool.robot.config import Config
from idtool.robot.model import WRENCH_SIZE, RobotModel, build_model
from idtool.robot.urdf.reading import Robot
from idtool.setup.feet import Touch, find_feet, leg_ends, touch_of
from idtool.setup.logged_sensors import LoggedSensors
from idtool.setup.name_matching import match, words
from idtool.setup.records import ConfigSection, TodoItem
from idtool.setup.rolling_radius import RollingRadius
from idtool.setup.wrench_sensors import with_signs, wrench_sensor_joints, wrench_sensors_section

_WORLD_WORDS = {"world", "map", "odom", "ground"}  # words of a root link that stands still
_SUPPORT_WORDS = {
    "rope",
    "crane",
    "hoist",
    "gantry",
    "harness",
    "tether",
    "cable",
    "string",
    "stand",
    "hook",
    "support",
}
_MARKER_WORDS = {"marker", "markers", "mocap", "vicon", "optitrack", "qualisys"}
_RADIUS_KEY = "contacts.radius"
_RADIUS_COMMENT = "radius of "  # begin of a comment on a radius that is not that of a sphere
_BASE_WORDS = {"base", "body", "trunk", "torso", "pelvis"}


@dataclass(frozen=True)
class BaseSections:
    """The sections ``base``, ``contacts`` and ``wrench_sensors``, as far as there is something to say.

    Attributes
    ----------
    sections
        The sections by key.
    todo
        Values that the user has to check.
    feet_without_radius
        Contacts of feet that may be balls, whose radius is not in the URDF.
    """

    sections: dict[str, ConfigSection] = field(default_factory=dict)
    todo: tuple[TodoItem, ...] = ()
    feet_without_radius: tuple[str, ...] = ()

    def values(self) -> dict[str, Any]:
        """Plain data of the sections."""
        return {key: section.value for key, section in self.sections.items()}

    @property
    def measured_contacts(self) -> list[str]:
        """Names of the proposed contacts whose force was measured."""
        entries = self.values().get("contacts", [])
        return [entry["name"] for entry in entries if "force" in entry]

    def with_radius(self, radius: RollingRadius | None) -> BaseSections:
        """A copy with the radius of feet by how they roll; None: it is not known."""
        if radius is None:
            return self
        feet = self.feet_without_radius
        section = self.sections["contacts"]
        value = round(radius.value, 4)
        entries = [{**entry, "radius": value} if entry["name"] in feet else entry for entry in section.value]
        comment = (
            f"{_RADIUS_COMMENT}{join_names(feet)}: {radius.text}, by how they roll while the robot stands (logs). Soft "
            "feet seem smaller; measure it if you can."
        )
        comments = [one for one in section.comments if not one.startswith(_RADIUS_COMMENT)]
        todo = [item for item in self.todo if item.key != _RADIUS_KEY]
        todo.append(TodoItem(_RADIUS_KEY, f"measure the radius of {join_names(feet)}, which the logs tell roughly"))
        section = replace(section, comments=(*comments, comment), value=entries)
        return BaseSections({**self.sections, "contacts": section}, tuple(todo))

    def with_frame(self, frame: str, is_certain: bool) -> BaseSections:
        """A copy with the axes of the measured forces, which the user has to check if they are not certain."""
        section = self.sections["contacts"]
        entries = [{**entry, "frame": frame} if "force" in entry else entry for entry in section.value]
        names = join_names(self.measured_contacts)
        comments, todo = section.comments, self.todo
        if is_certain:
            comments = (*comments, f"frame of {names}: the axes that explain the torque better (found by trial).")
        else:
            comments = (*comments, f"frame of {names}: world or link; the logs do not tell which.")
            todo = (*todo, TodoItem("contacts.frame", f"the axes of the force of {names}: world or link"))
        section = replace(section, comments=comments, value=entries)
        return replace(self, sections={**self.sections, "contacts": section}, todo=todo)

    def with_support(self, root: str, logs: Sequence[str]) -> BaseSections:
        """A copy with a contact for what holds the root in some logs while no other contact is closed."""
        section = self.sections["contacts"]
        names = [entry["name"] for entry in section.value]
        name = "support"
        while name in names:
            name += "_"
        comment = (
            f"{name}: what holds {root} in {join_names(logs)} while no contact is closed, such as a rope (logs). "
            "flag: auto: it is closed while no other contact is."
        )
        entry = {"name": name, "link": root, "kind": "surface", "flag": "auto"}
        section = replace(section, comments=(*section.comments, comment), value=[*section.value, entry])
        return replace(self, sections={**self.sections, "contacts": section})

    def with_signs(self, signs: Mapping[str, int]) -> BaseSections:
        """A copy with the signs of the wrench sensors by `sensor_signs`."""
        section, todo = with_signs(self.sections["wrench_sensors"], signs)
        return replace(self, sections={**self.sections, "wrench_sensors": section}, todo=(*self.todo, *todo))


def base_sections(
    robot: Robot,
    logs: Sequence[JointLog],
    config: Config,
    joints: Sequence[str],
    imu_topics: Sequence[str],
    pose_topics: Sequence[str] = (),
) -> BaseSections:
    """Propose the base, its contacts and the wrench sensors.

    Parameters
    ----------
    robot, logs
        The robot and its logs.
    config
        The given configuration; what it contains is not proposed.
    joints
        The joints that are identified.
    imu_topics
        The topics to choose the IMU from, the chosen one first; empty if there is one IMU at most.
    pose_topics
        Those to choose the pose from, likewise.
    """
    logged = LoggedSensors.of_logs(logs)
    proposer = _Proposer(robot, logged, config, tuple(joints), tuple(imu_topics), tuple(pose_topics))
    proposer.propose()
    return BaseSections(proposer.sections, tuple(proposer.todo), tuple(proposer.feet_without_radius))


@dataclass
class _Proposer:
    robot: Robot
    logged: LoggedSensors
    config: Config
    joints: tuple[str, ...]
    imu_topics: tuple[str, ...]
    pose_topics: tuple[str, ...]
    sections: dict[str, ConfigSection] = field(default_factory=dict)
    todo: list[TodoItem] = field(default_factory=list)
    feet_without_radius: list[str] = field(default_factory=list)
    unused_forces: list[str] = field(default_factory=list)

    def propose(self) -> None:
        floating = self.config.base.model_copy(update={"kind": "floating"})
        settings = self.config.model_copy(update={"base": floating, "joints": self.joints})
        self.model: RobotModel = build_model(self.robot, settings, self.joints)
        self.feet = find_feet(self.robot, self.model)
        is_given = "wrench_sensors" in self.config.model_fields_set
        self.sensors = {} if is_given else wrench_sensor_joints(self.robot, self.logged.wrenches)
        contacts, unmatched = self._logged_contacts()
        if self.sensors:
            self.sections["wrench_sensors"] = wrench_sensors_section(self.sensors)
        bodies_of_feet = {self.model.frames[foot].body for foot in self.feet}
        touching = {self.model.frames[link].body for link in contacts.values()}
        touches_foot_or_base = any(body in bodies_of_feet or self.model.bodies[body].is_base for body in touching)
        is_floating = self._propose_base(touches_foot_or_base)
        if is_floating:
            self._propose_contacts(contacts, unmatched)

    def _propose_base(self, has_contacts: bool) -> bool:
        """Propose the base; True if it floats."""
        if "base" in self.config.model_fields_set:
            return self.config.base.kind == "floating"
        logged = self.logged
        if not (logged.has_imu or logged.has_pose):
            if has_contacts:
                why = "The base is assumed to stand still, because not every log has an IMU or a pose."
                remark = (
                    "A base that moves needs one: the columns imu_wx to imu_az or base_x to base_qz, or a topic of "
                    "sensor_msgs/Imu or nav_msgs/Odometry."
                )
                self.sections["base"] = ConfigSection("base", (why, remark), {"kind": "fixed"})
                self.todo.append(
                    TodoItem("base", "the logs have contacts and no IMU or pose: log one if the base moves")
                )
            return False
        sensor = "IMU" if logged.has_imu else "pose"
        reason = None
        if words(self.robot.root) & _WORLD_WORDS:
            reason = f"the URDF's root is {self.robot.root}"
        elif not logged.base_moves and not has_contacts:
            reason = f"the {sensor} stands still, and no contact was logged"
        if reason is not None:
            article = "an" if logged.has_imu else "a"
            comment = f"The base is fixed, although the logs have {article} {sensor}: {reason} (logs and URDF)."
            self.sections["base"] = ConfigSection("base", (comment,), {"kind": "fixed"})
            return False
        self.sections["base"] = self._base_with_imu() if logged.has_imu else self._base_with_pose()
        return True

    def _base_with_pose(self) -> ConfigSection:
        """The section ``base`` of a robot whose pose was logged, and no IMU."""
        comments = ["The base floats, because the logs have its pose (logs). link: the URDF's root."]
        root = self.robot.root
        named = [link for link in self.robot.links if words(link) & _MARKER_WORDS and self._is_on_base(link)]
        link = min(named, key=len) if named else root
        if named:
            comments.append(f"pose.link: the link whose pose it is; by its name (URDF): {join_names(named)}.")
        else:
            comments.append(f"pose.link: the link whose pose it is; {root} if its origin and its axes were tracked.")
            self.todo.append(TodoItem("base.pose.link", f"the link whose pose was logged; {root} is a guess"))
        pose: dict[str, Any] = {"link": link}
        if self.pose_topics:
            comments.append(f"pose.topic: one of {join_names(self.pose_topics)} (logs).")
            pose["topic"] = self.pose_topics[0]
            if len(self.pose_topics) > 1:
                self.todo.append(TodoItem("base.pose.topic", f"one of {join_names(self.pose_topics)}: the base's"))
        comments.append("pose.delay: how late the pose is, s; auto (default): determined while the robot stands.")
        return ConfigSection(
            "base", tuple(comments), {"kind": "floating", "link": root, "pose": {**pose, "delay": "auto"}}
        )

    def _base_with_imu(self) -> ConfigSection:
        """The section ``base`` of a robot whose IMU was logged."""
        comments = ["The base floats, because the logs have an IMU (logs). link: the URDF's root."]
        named = [link for link in self.robot.links if "imu" in words(link) and self._is_on_base(link)]
        topic = self.imu_topics[0] if self.imu_topics else None
        link = self.robot.root
        if named:
            link = (topic and match(topic, named)) or min(named, key=len)
            comments.append("imu.link: the link on the base with imu in its name (URDF).")
            if len(named) > 1:
                comments[-1] = f"imu.link: one of {join_names(named)} (URDF); check which one was logged."
        else:
            comments.append(f"imu.link: no link that is fixed to {link} has imu in its name; name the link of the IMU.")
            what = f"the link of the IMU; {link} is only right if the IMU is at its origin and along its axes"
            self.todo.append(TodoItem("base.imu.link", what))
        imu: dict[str, Any] = {"link": link}
        if topic is not None:
            comments.append(f"imu.topic: one of {join_names(self.imu_topics)} (logs).")
            imu["topic"] = topic
            if len(self.imu_topics) > 1:
                self.todo.append(TodoItem("base.imu.topic", f"one of {join_names(self.imu_topics)}: that on the base"))
        comments.append("imu.delay: how late the IMU is, s; auto (default): determined while the robot stands.")
        value = {"kind": "floating", "link": self.robot.root, "imu": {**imu, "delay": "auto"}}
        return ConfigSection("base", tuple(comments), value)

    def _is_on_base(self, link: str) -> bool:
        return self.model.bodies[self.model.frames[link].body].is_base

    def _logged_contacts(self) -> tuple[dict[str, str], list[str]]:
        """Link of each contact that was logged, by its name; and the names that match no link."""
        of_sensors = {channel for sensor in self.config.wrench_sensors for channel in sensor.logged_channels}
        contacts: dict[str, str] = {}
        unmatched = []
        for name in dict.fromkeys((*self.logged.flags, *self.logged.wrenches)):
            has_flag = name in self.logged.flags
            is_of_sensor = name in self.sensors or f"force_{name}_x" in of_sensors
            if is_of_sensor and not has_flag:
                continue
            link = self._link_of_contact(name)
            if link is None and has_flag and words(name) & (_SUPPORT_WORDS | _BASE_WORDS):
                link = self.robot.root
            if link is None:
                unmatched.append(name)
            else:
                contacts[name] = link
        bodies = {name: self.model.frames[link].body for name, link in contacts.items()}
        flagged = {body for name, body in bodies.items() if name in self.logged.flags}
        for name, body in bodies.items():
            if name not in self.logged.flags and body in flagged:  # one contact, whose flag is enough
                del contacts[name]
                self.unused_forces.append(name)
        if self.feet and set(self.feet) <= set(contacts.values()):  # so that what is left is none of them
            contacts |= {name: self.robot.root for name in unmatched if name in self.logged.flags}
        return contacts, [name for name in unmatched if name not in contacts]

    def _link_of_contact(self, name: str) -> str | None:
        """The link of a contact: one of that name, else a foot, else the end of a leg, else any link that is alike."""
        links = list(self.robot.links)
        if name in links:
            return name
        ends = leg_ends(self.robot, self.model)
        found = (match(name, candidates) for candidates in (self.feet, ends, links))
        return next((link for link in found if link is not None), None)

    def _propose_contacts(self, logged: dict[str, str], unmatched: Sequence[str]) -> None:
        """Propose the contacts of a floating base."""
        if "contacts" in self.config.model_fields_set:
            return
        comments = [
            "Where the ground, or whatever holds the robot, acts on it (names in logs and URDF). A point takes a "
            "force, a surface also a moment."
        ]
        entries = [self._logged_contact(name, link) for name, link in logged.items()]
        touched = {self.model.frames[link].body for link in logged.values()}
        for foot in self.feet:
            if self.model.frames[foot].body not in touched:
                entries.append(self._unlogged_contact(foot))
        comments += self._contact_comments(entries, logged)
        if not entries:
            entries.append({"name": "support", "link": self.robot.root, "kind": "surface"})
            comments.append(
                "No contact was logged and no link is named as a foot: support stands for all that carries the base, "
                "such as wheels."
            )
            self.todo.append(TodoItem("contacts", "the links that touch the ground, if these are others than the base"))
        if unmatched:
            channels = [self.logged.flags.get(name, f"force_{name}_x") for name in unmatched]
            comments.append(f"Channels that match no link: {join_names(channels)}.")
            self.todo.append(TodoItem("contacts", f"the links of {join_names(channels)}"))
        if self.logged.in_some_logs:
            comments.append(f"Not used, because some log lacks them: {join_names(self.logged.in_some_logs)}.")
        self.sections["contacts"] = ConfigSection("contacts", tuple(comments), entries)

    def _logged_contact(self, name: str, link: str) -> dict[str, Any]:
        """A contact with its flag or, if it has none, with its measured wrench."""
        entry = {"name": name, "link": link, **self._contact_geometry(link)}
        if name in self.logged.flags:
            return {**entry, "flag": self.logged.flags[name]}
        channels = self.logged.wrenches[name]
        has_moment = len(channels) == WRENCH_SIZE
        entry["kind"] = "surface" if has_moment else "point"
        entry["frame"] = "world" if self.logged.has_orientation else "link"
        entry["force"] = list(channels[:3])
        if has_moment:
            entry["moment"] = list(channels[3:])
        return entry

    def _unlogged_contact(self, foot: str) -> dict[str, Any]:
        """A contact that the torque of the leg tells; always closed if it cannot tell the moment."""
        entry = {"name": foot, "link": foot, **self._contact_geometry(foot)}
        return {**entry, "flag": "auto"} if entry["kind"] == "point" else entry

    def _contact_geometry(self, link: str) -> dict[str, Any]:
        """Kind of a contact, and radius and centre of the ball if the URDF has one."""
        touch = self._touch(link)
        if touch.is_surface:
            return {"kind": "surface"}
        if touch.centre is None:
            return {"kind": "point"}
        place = {"point": list(touch.centre)} if any(touch.centre) else {}
        if not self.logged.has_orientation:  # which tells the lowest point of the ball
            return {"kind": "point", **place}
        return {"kind": "point", "radius": touch.radius, **place}

    def _touch(self, link: str) -> Touch:
        return touch_of(self.robot, self.model, link)

    def _contact_comments(self, entries: Sequence[dict[str, Any]], logged: dict[str, str]) -> list[str]:
        """Comments on the meaning of the values, and on what is not known."""
        comments = []
        points = [entry for entry in entries if entry["kind"] == "point"]
        bounds = [entry["name"] for entry in points if "radius" in entry and self._touch(entry["link"]).is_bound]
        if any("radius" in entry and entry["name"] not in bounds for entry in points):
            comments.append("radius and point: of the sphere in the link's geometry, m (URDF).")
        if bounds:
            comments.append(
                f"{_RADIUS_COMMENT}{join_names(bounds)}: of a ball about the mesh, which may be larger than the foot "
                "(URDF); check it, m."
            )
            self.todo.append(TodoItem(_RADIUS_KEY, f"the radius of {join_names(bounds)}, which is that of a mesh"))
        unknown = [entry["name"] for entry in points if "radius" not in entry]
        if self.logged.has_orientation:
            of_feet = [entry["name"] for entry in points if entry["link"] in self.feet]
            self.feet_without_radius = [name for name in of_feet if name in (*bounds, *unknown)]
        if unknown and not self.logged.has_orientation:
            comments.append("radius: none, because it needs the orientation of the IMU, imu_qw to imu_qz.")
        elif unknown:
            comments.append(
                f"{_RADIUS_COMMENT}{join_names(unknown)}: unknown, so 0; of a foot that is a ball, give it, m."
            )
            self.todo.append(TodoItem(_RADIUS_KEY, f"the radius of {join_names(unknown)}, if they are balls"))
        off_foot = [entry["name"] for entry in points if "radius" not in entry and entry["link"] not in self.feet]
        if off_foot:
            comments.append(f"point of {join_names(off_foot)}: unknown, so the origin of the link; give the place, m.")
            self.todo.append(TodoItem("contacts.point", f"where {join_names(off_foot)} is in the frame of its link"))
        surfaces = [entry for entry in entries if entry["kind"] == "surface"]
        held = [entry["name"] for entry in surfaces if "flag" in entry and entry["link"] == self.robot.root]
        if held:
            comments.append(f"{join_names(held)}: taken for what holds {self.robot.root}; if not, name another link.")
        detected = [entry["name"] for entry in entries if entry.get("flag") == "auto"]
        if detected:
            comments.append(
                f"flag: auto: no flag of {join_names(detected)} was logged, so the torque of the leg tells."
            )
        closed = [entry["name"] for entry in surfaces if "flag" not in entry and "force" not in entry]
        if closed:
            comments.append(f"Always closed without a flag, which costs accuracy: {join_names(closed)}.")
        both = [name for name in logged if name in self.logged.flags and name in self.logged.wrenches]
        both = [name for name in (*both, *self.unused_forces) if name not in self.sensors]
        if both:
            first = self.logged.wrenches[both[0]]
            comments.append(
                f"The measured force of {join_names(both)} is not needed. To use it, replace flag by "
                f"force: [{', '.join(first[:3])}] and by frame, world or link."
            )
        return comments
