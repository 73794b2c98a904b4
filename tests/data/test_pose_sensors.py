"""Motion of a base by its pose: against the closed form of a motion, and as it is read from messages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ground.logs import MESSAGES, write_csv
from ground.logs import Recording as GroundRecording
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import idtool
from idtool.common.exceptions import LogError
from idtool.data.base_sensors import POSE, PoseSensors, interpolate
from idtool.data.filters import DIFFERENCE_REACH
from idtool.data.logs import read_log
from idtool.data.logs.log import Channel, JointLog
from idtool.data.logs.sensor_channels import SensorOptions, with_sensors
from idtool.robot.body import Frame
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import read_robot
from idtool.setup.loaded_logs import find_sensors

Array = NDArray[np.float64]
GRAVITY = np.array([0.0, 0.0, -9.81])
RATE = 1000
LINK = Frame(0, Rotation.from_euler("xyz", [0.3, -0.2, 1.1]).as_matrix(), np.array([0.1, -0.05, 0.2]))


def base_motion(t: Array) -> tuple[Array, Rotation, Array]:
    """Position [m], rotation to the world and angular velocity in its own axes [rad/s] of a base that sways."""
    position = np.stack([0.1 * np.sin(5 * t), 0.05 * np.cos(7 * t), 0.3 + 0.02 * np.sin(9 * t)])
    yaw, roll = 0.8 * np.sin(3 * t), 0.3 * np.cos(4 * t)
    yaw_rate, roll_rate = 2.4 * np.cos(3 * t), -1.2 * np.sin(4 * t)
    rotation = Rotation.from_euler("z", yaw[:, None]) * Rotation.from_euler("x", roll[:, None])
    w = np.stack([roll_rate, yaw_rate * np.sin(roll), yaw_rate * np.cos(roll)])
    return position, rotation, w


def proper_acceleration(t: Array) -> Array:
    """That of the base's origin in its own axes, by hand."""
    _, rotation, _ = base_motion(t)
    acceleration = np.stack([-2.5 * np.sin(5 * t), -2.45 * np.cos(7 * t), -1.62 * np.sin(9 * t)])
    return rotation.inv().apply((acceleration - GRAVITY[:, None]).T).T


def pose_log(t: Array, delay: float = 0.0) -> JointLog:
    position, rotation, _ = base_motion(t)
    of_link = position + rotation.apply(LINK.p).T
    orientation = (rotation * Rotation.from_matrix(LINK.R)).as_quat().T
    channels = {name: Channel(t + delay, x) for name, x in zip(POSE, [*of_link, *orientation], strict=True)}
    return JointLog(
        Path("log"), ("j",), t, {"q": np.zeros((len(t), 1))}, (slice(0, len(t)),), 1 / RATE, channels=channels
    )


@pytest.mark.parametrize(("rate", "tolerance"), [(1000, 2e-4), (250, 2e-3)])
def test_motion_of_the_base_is_that_of_the_closed_form(rate: int, tolerance: float) -> None:
    """Also with a link that is turned and away from the base's origin, with late stamps, and at a lower rate."""
    sensors = PoseSensors(pose_log(np.arange(0, 3, 1 / rate), delay=0.02), LINK, 0.02, GRAVITY)
    t = np.arange(0.5, 2.5, 1 / RATE)
    v, a = sensors.kinematics(t, 1 / RATE, lambda x: x)
    inner = t[2 * DIFFERENCE_REACH : -2 * DIFFERENCE_REACH]
    _, rotation, w = base_motion(inner)
    step = 1e-5
    alpha = (base_motion(inner + step)[2] - base_motion(inner - step)[2]) / (2 * step)
    np.testing.assert_array_equal(v[:3], 0)
    np.testing.assert_allclose(v[3:], w, atol=tolerance)
    np.testing.assert_allclose(a[3:], alpha, atol=50 * tolerance)
    np.testing.assert_allclose(a[:3], proper_acceleration(inner), atol=50 * tolerance)
    R = np.moveaxis(sensors.world_to_base(inner), -1, 0)
    np.testing.assert_allclose(R, rotation.inv().as_matrix(), atol=tolerance)


def test_velocity_of_the_base_is_that_of_the_closed_form() -> None:
    sensors = PoseSensors(pose_log(np.arange(0, 3, 1 / RATE)), LINK, 0.0, GRAVITY)
    t = np.arange(0.5, 2.5, 0.005)
    _, rotation, w = base_motion(t)
    velocity = np.stack([0.5 * np.cos(5 * t), -0.35 * np.sin(7 * t), 0.18 * np.cos(9 * t)])
    inner = slice(30, -30)
    in_base = rotation.inv().apply(velocity.T).T
    np.testing.assert_allclose(sensors.linear_velocity(t)[:, inner], in_base[:, inner], atol=0.01)
    np.testing.assert_allclose(sensors.angular_velocity(t)[:, inner], w[:, inner], atol=0.03)


def test_interpolation_is_exact_for_polynomials_of_degree_five_at_uneven_times() -> None:
    rng = np.random.default_rng(0)
    nodes = np.sort(rng.uniform(0, 1, 40))
    nodes = np.concatenate([nodes[:20], nodes[19:]])  # one stamp twice
    coefficients = rng.normal(size=(2, 6))
    x = np.stack([np.polyval(c, nodes) for c in coefficients])
    t = np.linspace(nodes[0], nodes[-1], 333)
    np.testing.assert_allclose(interpolate(nodes, x, t), [np.polyval(c, t) for c in coefficients], atol=1e-8)
    np.testing.assert_allclose(interpolate(nodes, x, np.array([-5.0, 5.0])), x[:, [0, -1]], atol=1e-12)


HEADER_DEFINITIONS = MESSAGES["sensor_msgs/msg/JointState"].partition("=")
SEPARATOR = "=" * 80 + "\n"
POSE_DEFINITIONS = (
    f"{SEPARATOR}MSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"
    f"{SEPARATOR}MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
    f"{SEPARATOR}MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
    f"{HEADER_DEFINITIONS[1]}{HEADER_DEFINITIONS[2]}"
)
POSE_MESSAGES = {
    "geometry_msgs/msg/PoseStamped": f"std_msgs/Header header\ngeometry_msgs/Pose pose\n{POSE_DEFINITIONS}",
    "nav_msgs/msg/Odometry": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
        "geometry_msgs/TwistWithCovariance twist\n"
        f"{SEPARATOR}MSG: geometry_msgs/PoseWithCovariance\ngeometry_msgs/Pose pose\nfloat64[36] covariance\n"
        f"{SEPARATOR}MSG: geometry_msgs/TwistWithCovariance\ngeometry_msgs/Twist twist\nfloat64[36] covariance\n"
        f"{SEPARATOR}MSG: geometry_msgs/Twist\ngeometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"
        f"{SEPARATOR}MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n{POSE_DEFINITIONS}"
    ),
}


def write_poses(path: Path, topics: Sequence[tuple[str, str]], imus: Sequence[str] = ()) -> None:
    """Joint states at 1 kHz, and poses of (topic, type) at 100 Hz of which x counts the topics from 1, and IMUs."""
    from mcap_ros2.writer import Writer

    types = {**MESSAGES, **POSE_MESSAGES}
    with path.open("wb") as file:
        writer = Writer(file)
        schemas = {name: writer.register_msgdef(name, text) for name, text in types.items()}
        for i in range(200):
            nanoseconds = 10**12 + i * 10**6
            stamp = {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}
            header = {"stamp": stamp, "frame_id": "world" if i < 100 else "w"}
            state = {"header": header, "name": ["j"], "position": [0.01 * i], "velocity": [10.0], "effort": [1.0]}
            messages: list[tuple[str, str, dict[str, Any]]] = [("/joint_states", "sensor_msgs/msg/JointState", state)]
            for k, (topic, name) in enumerate(topics if i % 10 == 0 else ()):
                pose: dict[str, Any] = {
                    "position": {"x": k + 1.0, "y": i / 1000, "z": 0.5},
                    "orientation": {"x": 0.1, "y": 0.2, "z": 0.3, "w": 0.9},
                }
                message = {"header": header, "pose": pose}
                if name.startswith("nav_msgs"):
                    message = {"header": header, "child_frame_id": "base", "pose": {"pose": pose}}
                messages.append((topic, name, message))
            for topic in imus:
                messages.append((topic, "sensor_msgs/msg/Imu", {"header": header}))
            for topic, name, message in messages:
                writer.write_message(topic, schemas[name], message, nanoseconds, nanoseconds)
        writer.finish()


@pytest.mark.parametrize("name", POSE_MESSAGES)
def test_poses_are_read_with_their_own_stamps(tmp_path: Path, name: str) -> None:
    path = tmp_path / "log.mcap"
    write_poses(path, [("/odom", name)])
    log = read_log(path, sensors=SensorOptions())
    assert set(POSE) <= set(log.channels)
    channels = with_sensors(log, POSE).channels  # in the order of time
    np.testing.assert_allclose(np.diff(channels["base_x"].t), 0.01, atol=1e-6)
    np.testing.assert_array_equal(channels["base_x"].x, 1.0)
    np.testing.assert_allclose(channels["base_y"].x, np.arange(0, 0.2, 0.01))
    for axis, value in {"x": 0.1, "y": 0.2, "z": 0.3, "w": 0.9}.items():
        np.testing.assert_array_equal(channels[f"base_q{axis}"].x, value)


def test_one_of_several_poses_is_chosen(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write_poses(path, [("/odom", "nav_msgs/msg/Odometry"), ("/goal", "geometry_msgs/msg/PoseStamped")])
    assert not set(POSE) & set(read_log(path, sensors=SensorOptions()).channels)
    chosen = read_log(path, sensors=SensorOptions(pose_topic="/goal", needs_pose=True)).channels
    assert chosen["base_x"].x[0] == 2
    with pytest.raises(LogError, match=r"2 topics carry a pose; set base\.pose\.topic to one of /odom, /goal"):
        read_log(path, sensors=SensorOptions(needs_pose=True))
    with pytest.raises(LogError, match=r"base\.pose\.topic: no pose on topic /odm; did you mean /odom"):
        read_log(path, sensors=SensorOptions(pose_topic="/odm"))


def test_poses_of_which_none_is_chosen_are_named(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write_poses(path, [("/odom", "nav_msgs/msg/Odometry"), ("/goal", "geometry_msgs/msg/PoseStamped")])
    (notice,) = idtool.Log(path, sensors=True).notices
    assert notice.code == "pose_not_chosen"
    assert notice.message == "2 topics carry a pose, and none of them was read: /odom, /goal"
    assert not idtool.Log(path, sensors=True, pose_topic="/goal").notices
    write_poses(path, [("/odom", "nav_msgs/msg/Odometry")])
    assert not idtool.Log(path, sensors=True).notices


@pytest.mark.parametrize("poses", [["/odom"], ["/odom", "/goal_pose"], []])
def test_pose_is_read_though_no_imu_is_in_all_logs(tmp_path: Path, poses: Sequence[str]) -> None:
    """For a first configuration; without a pose, the IMU is left to the user."""
    urdf = tmp_path / "robot.urdf"
    urdf.write_text('<robot name="r"><link name="base"/></robot>')
    logs = [tmp_path / "first.mcap", tmp_path / "second.mcap"]
    topics = [(name, "geometry_msgs/msg/PoseStamped") for name in poses]
    write_poses(logs[0], topics, imus=["/imu", "/head/imu"])
    write_poses(logs[1], topics, imus=["/body/imu", "/camera/imu"])
    choice = find_sensors(read_robot(urdf), logs, parse_config({}, ""), None)
    assert choice.pose_topics == (tuple(poses) if len(poses) > 1 else ())
    if not poses:
        assert choice.options is None
        return
    assert choice.options is not None
    for log in logs:
        channels = read_log(log, sensors=choice.options).channels
        assert channels["base_x"].x[0] == 1
        assert "imu_wx" not in channels


def test_columns_of_a_pose_may_have_empty_cells(tmp_path: Path) -> None:
    t = np.arange(0, 1, 1e-3)
    columns = {"t": t, "q_j": t, "v_j": 1 + 0 * t, "tau_j": t}
    for name in POSE:
        columns[name] = np.where(np.arange(len(t)) % 4, np.nan, np.sin(t))
    write_csv(tmp_path / "log.csv", GroundRecording(columns))
    channel = read_log(tmp_path / "log.csv").channels["base_qw"]
    assert np.isfinite(channel.x).sum() == 250


def test_saved_pose_is_read_again(tmp_path: Path) -> None:
    """As messages, whatever type it was of."""
    write_poses(tmp_path / "log.mcap", [("/odom", "nav_msgs/msg/Odometry")])
    log = idtool.Log(tmp_path / "log.mcap", sensors=True)
    log.save(tmp_path / "copy.mcap")
    before = with_sensors(log.record, POSE).channels
    after = with_sensors(idtool.Log(tmp_path / "copy.mcap", sensors=True).record, POSE).channels
    for name in POSE:
        np.testing.assert_allclose(after[name].x, before[name].x)
        np.testing.assert_allclose(after[name].t, before[name].t, atol=1e-6)


def test_pose_is_the_same_in_parts(rng: np.random.Generator) -> None:
    """As read in batches, each of which looks at the samples about it only; many samples have the same time."""
    t = np.sort(rng.integers(0, 120, 400) / 100.0)
    channels = {name: Channel(t, rng.normal(size=len(t))) for name in POSE}
    log = JointLog(Path("log"), (), t, {}, (slice(0, len(t)),), 0.01, channels=channels)
    sensors = PoseSensors(log, LINK, 0.003, GRAVITY)
    times = np.arange(-0.1, 1.3, 0.004)
    samples = np.stack([channels[name].x for name in POSE])
    parts = [sensors._values(POSE, part) for part in np.array_split(times, 30)]
    np.testing.assert_array_equal(np.concatenate(parts, axis=1), interpolate(t, samples, times + 0.003))
