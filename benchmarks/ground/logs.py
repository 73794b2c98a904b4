"""Logs of a robot in motion, and the configuration for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from ground.motions import Motion
from ground.plant import BASE, Physics, Plant
from ground.robot import Array, Robot
from ground.robots import motion

RATE = 1000  # samples a second
_STEPS = 4  # of the simulation for each sample
_CLOSED = 4.0  # N: normal force from which a foot's flag is set
_FORCE_PARTS, _MOMENT_PARTS = ("x", "y", "z"), ("mx", "my", "mz")

CONFIGS = ("unknown", "measured", "sensors")  # forces on the feet, see `config_text`


@dataclass(frozen=True)
class Sensors:
    """Noise of the sensors, each as a standard deviation of white noise, delays [s], and the rate of a pose.

    With a ``pose_rate``, the pose of the IMU's link is logged, as by motion capture [samples/s].
    """

    q: float = 3e-5  # rad
    v: float = 5e-3  # rad/s
    tau: float = 0.08  # N m
    gyroscope: float = 2e-3  # rad/s
    accelerometer: float = 0.04  # m/s^2
    orientation: float = 5e-4  # rad
    force: float = 0.5  # N
    moment: float = 0.02  # N m
    imu_delay: float = 0.0
    torque_delay: float = 0.0
    pose_rate: int | None = None
    pose_position: float = 1e-4  # m
    pose_orientation: float = 5e-4  # rad
    pose_delay: float = 0.0


@dataclass(frozen=True)
class Recording:
    """A motion as logged, and as it was.

    Attributes
    ----------
    columns
        Channels as logged, by their column's name, shape (N,).
    truth
        What no sensor measures: ``position`` of the base, shape (N, 3) [m], its rotation ``R`` to the world, shape
        (N, 3, 3), and the way ``slip`` that each foot has slipped so far, shape (N, feet) [m].
    """

    columns: Mapping[str, Array]
    truth: Mapping[str, Array] = field(default_factory=dict)


def record(
    robot: Robot,
    kind: str,
    seconds: float,
    seed: int,
    physics: Physics | None = None,
    sensors: Sensors | None = None,
) -> Recording:
    """Recording of a motion of a kind; RuntimeError if the robot falls."""
    return record_motion(robot, motion(robot, kind, seconds, seed), seconds, seed, physics, sensors)


def record_motion(
    robot: Robot,
    course: Motion,
    seconds: float,
    seed: int,
    physics: Physics | None = None,
    sensors: Sensors | None = None,
) -> Recording:
    """Recording of a motion; RuntimeError if the robot falls."""
    return recording_of(robot, simulated_states(robot, course, seconds, physics), sensors or Sensors(), seed)


def simulated_states(robot: Robot, course: Motion, seconds: float, physics: Physics | None = None) -> dict[str, Array]:
    """True states of a motion, one a sample, by name; RuntimeError if the robot falls."""
    physics = replace(physics or Physics(), is_held=course.is_held)
    q_first, _ = course.reference(0.0)
    dt = 1 / RATE / _STEPS
    plant = Plant(robot, physics, dt, q_first, course.height)
    rows = []
    late_half = _HalfSample.at_rest(plant)  # of the last sample time
    for i in range(round((seconds + 1) * RATE)):
        t = i / RATE - 1  # it settles for a second
        q_reference, v_reference = course.reference(max(t, 0.0))
        tau = course.kp * (q_reference - plant.q) + course.kd * (v_reference - plant.v[BASE:])
        if course.balance is not None:
            tau = tau + course.balance(max(t, 0.0), plant.base[0], plant.v[:3])
        state = _state(plant)
        early_half = _steps(plant, tau, _STEPS // 2)
        if t >= 0:
            rows.append({**state, **early_half.mean_with(late_half)})
        late_half = _steps(plant, tau, _STEPS // 2)
        if not course.is_held and plant.base[0][2] < robot.fallen_height:
            raise RuntimeError(f"the robot fell after {t:.1f} s")
    return {key: np.array([row[key] for row in rows]) for key in rows[0]}


@dataclass(frozen=True)
class _HalfSample:
    """Means over half a sample time: accelerations, wrenches on the feet and of the sensors, torques of the motors.

    Sensors average over a sample time: a foot's impact is shorter, and would be aliased.
    """

    acceleration: Array
    wrenches: Array
    sensor_wrenches: Array
    tau: Array

    @classmethod
    def at_rest(cls, plant: Plant) -> _HalfSample:
        """Those of a robot that does not move, with which the recording does not begin."""
        wrenches, sensor_wrenches = np.zeros_like(plant.wrenches), np.zeros_like(plant.sensor_wrenches)
        return cls(np.zeros_like(plant.v), wrenches, sensor_wrenches, np.zeros_like(plant.q))

    def mean_with(self, other: _HalfSample) -> dict[str, Array]:
        """Means over both halves, by name."""
        own, others = vars(self), vars(other)
        return {name: (own[name] + others[name]) / 2 for name in own}


def _steps(plant: Plant, tau: Array, count: int) -> _HalfSample:
    """Take steps under constant torque."""
    accelerations, wrenches, sensor_wrenches = [], [], []
    for _ in range(count):
        plant.step(tau)
        accelerations.append(plant.acceleration.copy())
        wrenches.append(plant.wrenches.copy())
        sensor_wrenches.append(plant.sensor_wrenches.copy())
    return _HalfSample(*(np.mean(values, axis=0) for values in (accelerations, wrenches, sensor_wrenches)), tau)


def _state(plant: Plant) -> dict[str, Any]:
    position, R = plant.base
    return {"q": plant.q.copy(), "v": plant.v.copy(), "position": position, "R": R, "slip": plant.slip}


def recording_of(robot: Robot, states: Mapping[str, Array], sensors: Sensors, seed: int) -> Recording:
    """Noisy readings of the sensors in true states, as `simulated_states` gives them."""
    rng = np.random.default_rng([seed, 4])
    count = len(states["q"])
    R, w = states["R"], states["v"][:, 3:BASE]
    at_origin = np.einsum("nji,nj->ni", R, states["acceleration"][:, :3] + [0.0, 0.0, 9.81])
    angular = states["acceleration"][:, 3:BASE]
    lever = robot.imu.position
    at_imu = at_origin + np.cross(angular, lever) + np.cross(w, np.cross(w, lever))
    turn = Rotation.from_euler("z", robot.imu.turn)
    to_imu = turn.as_matrix().T
    orientation = (
        Rotation.from_matrix(R) * turn * Rotation.from_rotvec(sensors.orientation * rng.normal(size=(count, 3)))
    )
    quaternion = orientation.as_quat()
    columns: dict[str, Array] = {"t": np.arange(count) / RATE}
    late = round(sensors.torque_delay * RATE)
    for j, name in enumerate(robot.joints):
        columns[f"q_{name}"] = states["q"][:, j] + sensors.q * rng.normal(size=count)
        columns[f"v_{name}"] = states["v"][:, BASE + j] + sensors.v * rng.normal(size=count)
        torque = np.concatenate([np.repeat(states["tau"][:1, j], late), states["tau"][: count - late, j]])
        columns[f"tau_{name}"] = torque + sensors.tau * rng.normal(size=count)
    imu_late = round(sensors.imu_delay * RATE)
    imu = {
        "w": w @ to_imu.T + sensors.gyroscope * rng.normal(size=(count, 3)),
        "a": at_imu @ to_imu.T + sensors.accelerometer * rng.normal(size=(count, 3)),
    }
    for letter, values in imu.items():
        for k, axis in enumerate("xyz"):
            columns[f"imu_{letter}{axis}"] = _late(values[:, k], imu_late)
    for k, part in enumerate("xyzw"):
        columns[f"imu_q{part}"] = _late(quaternion[:, k], imu_late)
    for k, foot in enumerate(robot.feet):
        wrench = states["wrenches"][:, k]
        columns[f"contact_{foot.name}"] = (wrench[:, 2] > _CLOSED).astype(float)
        columns |= _wrench_columns(foot.name, wrench if foot.is_sole else wrench[:, :3], sensors, rng)
    for k, (joint, offset) in enumerate(robot.wrench_sensors.items()):
        columns |= _wrench_columns(joint, states["sensor_wrenches"][:, k] + offset, sensors, rng)
    columns["contact_rope"] = np.full(count, float(np.all(states["wrenches"] == 0)))
    if sensors.pose_rate is not None:
        columns |= _pose_columns(robot, states, sensors, np.random.default_rng([seed, 5]))
    truth = {name: states[name] for name in ("position", "R", "slip")}
    return Recording(columns, truth)


def _pose_columns(
    robot: Robot, states: Mapping[str, Array], sensors: Sensors, rng: np.random.Generator
) -> dict[str, Array]:
    """Noisy pose of the IMU's link in the world; not a number between its samples."""
    count = len(states["R"])
    position = states["position"] + states["R"] @ robot.imu.position
    position = position + sensors.pose_position * rng.normal(size=(count, 3))
    noise = Rotation.from_rotvec(sensors.pose_orientation * rng.normal(size=(count, 3)))
    orientation = Rotation.from_matrix(states["R"]) * Rotation.from_euler("z", robot.imu.turn) * noise
    late = round(sensors.pose_delay * RATE)
    step = RATE // (sensors.pose_rate or RATE)
    is_between = np.arange(count) % step != 0
    columns = {}
    for name, values in zip(
        ["x", "y", "z", "qx", "qy", "qz", "qw"], [*position.T, *orientation.as_quat().T], strict=True
    ):
        columns[f"base_{name}"] = np.where(is_between, np.nan, _late(values, late))
    return columns


def _wrench_columns(name: str, wrench: Array, sensors: Sensors, rng: np.random.Generator) -> dict[str, Array]:
    """Noisy channels of a force, shape (N, 3), or of a force and a moment, shape (N, 6)."""
    noise = np.repeat([sensors.force, sensors.moment], 3)
    columns = {}
    for channel, values, sigma in zip(_wrench_channels(name), wrench.T, noise, strict=False):
        columns[channel] = values + sigma * rng.normal(size=len(values))
    return columns


def _wrench_channels(name: str) -> list[str]:
    return [f"force_{name}_{part}" for part in (*_FORCE_PARTS, *_MOMENT_PARTS)]


def _late(x: Array, samples: int) -> Array:
    return np.concatenate([np.repeat(x[:1], samples), x[: len(x) - samples]])


def write_csv(path: Path, recording: Recording) -> None:
    """Write a recording as a table."""
    table = np.stack(list(recording.columns.values()), axis=1)
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(recording.columns), comments="")


def config_text(robot: Robot, forces: str = "unknown", base_sensor: str = "imu") -> str:
    """Configuration: floating base, contacts, rotors by data sheet, bounds of the links.

    Parameters
    ----------
    robot
        The robot.
    forces
        Of the ground on the feet: ``unknown``, ``measured``, or ``sensors``: unknown, with the robot's wrench sensors.
    base_sensor
        ``imu`` or ``pose``, both of the IMU's link.
    """
    contacts: list[dict[str, Any]] = []
    for foot in robot.feet:
        contact: dict[str, Any] = {"name": foot.name, "link": foot.name, "kind": "surface" if foot.is_sole else "point"}
        if not foot.is_sole:
            contact["radius"] = foot.radius
        if forces != "measured":
            contact["flag"] = f"contact_{foot.name}"
        else:
            channels = _wrench_channels(foot.name)
            contact["force"] = channels[:3]
            if foot.is_sole:
                contact |= {"frame": "link", "moment": channels[3:]}
        contacts.append(contact)
    rope = {"name": "rope", "link": robot.base, "kind": "surface", "flag": "contact_rope"}
    if robot.hook is not None:
        rope |= {"link": robot.hook.link, "kind": "point", "point": robot.hook.position.tolist()}
    contacts.append(rope)
    ellipsoids = {}
    for name, body in robot.links.items():
        ellipsoids[name] = [{"center": body.center.tolist(), "semi_axes": body.semi_axes.tolist()}]
    rotors = {}
    for name, body in robot.rotors.items():
        rotors[f"{name}_rotor"] = {
            "joint": name,
            "gear_ratio": robot.gear,
            "inertial": {
                "mass": body.mass,
                "com": [0.0, 0.0, 0.0],
                "inertia": body.inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]].tolist(),
            },
            "bounding_ellipsoid": {"center": [0.0, 0.0, 0.0], "semi_axes": body.semi_axes.tolist()},
        }
    content: dict[str, Any] = {
        "base": {"kind": "floating", "link": robot.base, base_sensor: {"link": "imu_link"}},
        "contacts": contacts,
        "bounding_ellipsoids": ellipsoids,
        "rotors": rotors,
    }
    if forces == "sensors":
        content["wrench_sensors"] = [{"joint": joint} for joint in robot.wrench_sensors]
    return yaml.safe_dump(content, sort_keys=False)


def write_mcap(path: Path, robot: Robot, recording: Recording, imu_topics: Sequence[str] = ("/imu",)) -> None:
    """Write a recording as ROS 2 messages: joint states, IMU at half their rate, flags of the feet, and wrenches."""
    from mcap_ros2.writer import Writer

    columns = recording.columns
    with path.open("wb") as file:
        writer = Writer(file)
        schemas = {name: writer.register_msgdef(name, text) for name, text in MESSAGES.items()}
        for i, t in enumerate(columns["t"]):
            stamp = {"sec": 1000 + int(t), "nanosec": round(t % 1 * 1e9)}
            nanoseconds = stamp["sec"] * 10**9 + stamp["nanosec"]
            header = {"stamp": stamp, "frame_id": ""}
            messages: list[tuple[str, str, dict[str, Any]]] = [
                (
                    "/joint_states",
                    "sensor_msgs/msg/JointState",
                    {
                        "header": header,
                        "name": list(robot.joints),
                        "position": [columns[f"q_{joint}"][i] for joint in robot.joints],
                        "velocity": [columns[f"v_{joint}"][i] for joint in robot.joints],
                        "effort": [columns[f"tau_{joint}"][i] for joint in robot.joints],
                    },
                )
            ]
            if i % 2 == 0:
                imu = {
                    "header": header,
                    "orientation": {axis: columns[f"imu_q{axis}"][i] for axis in "xyzw"},
                    "angular_velocity": {axis: columns[f"imu_w{axis}"][i] for axis in "xyz"},
                    "linear_acceleration": {axis: columns[f"imu_a{axis}"][i] for axis in "xyz"},
                }
                messages += [(topic, "sensor_msgs/msg/Imu", imu) for topic in imu_topics]
            for name in (*(foot.name for foot in robot.feet), *robot.wrench_sensors):
                if f"contact_{name}" in columns:
                    flag = {"data": bool(columns[f"contact_{name}"][i])}
                    messages.append((f"/contact/{name}", "std_msgs/msg/Bool", flag))
                values = [columns[channel][i] for channel in _wrench_channels(name) if channel in columns]
                force, torque = (dict(zip("xyz", part, strict=False)) for part in (values[:3], values[3:]))
                wrench = {"header": header, "wrench": {"force": force, "torque": torque}}
                messages.append((f"/force/{name}", "geometry_msgs/msg/WrenchStamped", wrench))
            if i == 0:
                messages.append(("/contact/rope", "std_msgs/msg/Bool", {"data": bool(columns["contact_rope"][0])}))
            for topic, name, message in messages:
                writer.write_message(topic, schemas[name], message, nanoseconds, nanoseconds)
        writer.finish()


_HEADER = "std_msgs/Header header\n"
_SEPARATOR = "=" * 80 + "\n"
_HEADER_DEFINITION = (
    f"{_SEPARATOR}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{_SEPARATOR}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
_VECTOR = f"{_SEPARATOR}MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
MESSAGES = {
    "sensor_msgs/msg/JointState": (
        f"{_HEADER}string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n{_HEADER_DEFINITION}"
    ),
    "sensor_msgs/msg/Imu": (
        f"{_HEADER}geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n"
        f"{_HEADER_DEFINITION}{_SEPARATOR}MSG: geometry_msgs/Quaternion\n"
        f"float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n{_VECTOR}"
    ),
    "geometry_msgs/msg/WrenchStamped": (
        f"{_HEADER}geometry_msgs/Wrench wrench\n{_HEADER_DEFINITION}"
        f"{_SEPARATOR}MSG: geometry_msgs/Wrench\ngeometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n{_VECTOR}"
    ),
    "std_msgs/msg/Bool": "bool data\n",
}
