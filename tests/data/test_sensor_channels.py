"""Channels of sensors that are of no joint: reading, gaps, and what they say of a floating base."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ground.logs import Recording, write_mcap
from mcap.records import Schema
from quadruped_recordings import TRUTH, record_quadruped

from idtool.common.exceptions import LogError
from idtool.data.base_sensors import ImuSensors, needed_channels
from idtool.data.contact_channels import ContactChannels
from idtool.data.filters import DIFFERENCE_REACH
from idtool.data.logs import JointLog, make_log, read_log
from idtool.data.logs.log import Channel
from idtool.data.logs.payloads import sensor_decoder_for
from idtool.data.logs.payloads.base import PayloadError
from idtool.data.logs.sensor_channels import SensorOptions, with_sensors
from idtool.data.logs.state_topics import imu_topics
from idtool.robot.body import Frame
from idtool.robot.config import Config, parse_config

Array = np.ndarray
DT = 1e-3
ROOT = Frame(0, np.eye(3), np.zeros(3))


def identity(x: Array) -> Array:
    return x


def log_of(channels: dict[str, Channel], seconds: float = 2.0) -> JointLog:
    t = np.arange(0, seconds, DT)
    log = make_log(Path("log.csv"), t, ("hip",), {"q": np.sin(t)[:, None], "tau": np.cos(t)[:, None]})
    return JointLog(log.path, log.joints, log.t, log.signals, log.segments, log.dt, channels=channels)


def config_of(**config: Any) -> Config:
    return parse_config({"base": {"kind": "floating"}, **config}, "")


def test_csv_has_the_channels_with_their_own_stamps(tmp_path: Path) -> None:
    """Every second row has the IMU; a row of the IMU alone is no sample of the joint."""
    lines = ["t,q_hip,tau_hip,imu_wx,contact_foot,temperature"]
    for i in range(20):
        imu = f"{i}" if i % 2 == 0 else ""
        lines.append(f"{i * DT:.3f},0.1,0.2,{imu},1,20")
    lines.append(f"{20 * DT:.3f},,,20,0,")
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines) + "\n")
    log = read_log(path)
    assert len(log) == 20
    assert set(log.channels) == {"imu_wx", "contact_foot"}
    needed = with_sensors(log, ["imu_wx", "contact_foot"])
    np.testing.assert_allclose(needed.channels["imu_wx"].at(log.t), np.arange(20), atol=1e-9)
    assert needed.channels["contact_foot"].is_set(np.array([0.0105, 0.021])).tolist() == [True, False]
    (notice,) = [one for one in log.notices if one.code == "unused_columns"]
    assert notice.message.endswith("temperature")


def test_channel_may_be_mapped(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,q_hip,tau_hip,gyro\n0,0,0,1\n0.001,0,0,2\n0.002,0,0,3\n")
    log = read_log(path, columns={"imu_wx": "gyro"})
    assert log.channels["imu_wx"].x.tolist() == [1.0, 2.0, 3.0]


def test_samples_without_a_sensor_are_left_out() -> None:
    t = np.arange(0.1, 1.9, 5e-3)
    with_gap = t[(t < 0.8) | (t > 1.0)]
    log = with_sensors(log_of({"imu_wx": Channel(with_gap, with_gap), "imu_wy": Channel(t, t)}), ["imu_wx"])
    assert list(log.channels) == ["imu_wx"]
    starts_and_ends = [(log.t[part.start], log.t[part.stop - 1]) for part in log.segments]
    np.testing.assert_allclose(starts_and_ends, [(0.1, 0.795), (1.0, 1.895)], atol=6e-3)
    assert [notice.code for notice in log.notices] == ["sensors_missing"]


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        ({}, "has no channel imu_wx"),
        ({"imu_wx": Channel(np.array([0.0, 1.0]), np.full(2, np.nan))}, "imu_wx has no values"),
        ({"imu_wx": Channel(np.array([100.0, 101.0]), np.ones(2))}, "compare the times of imu_wx"),
    ],
)
def test_missing_sensors_are_named(channels: dict[str, Channel], message: str) -> None:
    with pytest.raises(LogError, match=message):
        with_sensors(log_of(channels), ["imu_wx"])


def test_contact_whose_flag_has_no_value_counts_as_closed() -> None:
    t = np.arange(0, 2.0, 0.01)
    flags = {"contact_left": Channel(t, np.full(len(t), np.nan)), "contact_right": Channel(t, 0 * t)}
    log = with_sensors(log_of(flags), flags)
    at = np.array([-1.0, 0.5, 3.0])
    assert log.channels["contact_left"].is_set(at).all()
    assert log.channels["contact_right"].is_set(at).tolist() == [True, False, False]
    (notice,) = log.notices
    assert (notice.code, notice.severity) == ("contact_flag_empty", "warning")
    assert notice.message.startswith("no value of contact_left:")


def test_sign_of_a_quaternion_means_nothing() -> None:
    """A turn about x by a full circle and a half, with a sign that jumps, at a third of the joints' rate."""
    t = np.arange(0, 2.0, 3e-3)
    angle = 1.5 * np.pi * t
    sign = np.where(np.arange(len(t)) % 7 < 3, 1.0, -1.0)
    parts = {"qw": np.cos(angle / 2), "qx": np.sin(angle / 2), "qy": 0 * t, "qz": 0 * t}
    channels = {f"imu_{name}": Channel(t, sign * x) for name, x in parts.items()}
    still = {f"imu_{name}": Channel(t, 0 * t) for name in ("wx", "wy", "wz", "ax", "ay", "az")}
    config = config_of(contacts=[{"name": "foot", "link": "calf", "radius": 0.02}])
    log = with_sensors(log_of({**channels, **still}), needed_channels(config))
    at = np.arange(0.1, 1.9, DT)
    found = ImuSensors(log, ROOT, 0.0).world_to_base(at)
    expected = np.stack([0 * at, np.sin(1.5 * np.pi * at), np.cos(1.5 * np.pi * at)])
    np.testing.assert_allclose(found[:, 2], expected, atol=1e-4)


def test_lever_arm_and_delay_of_the_imu_are_undone() -> None:
    """A base that turns about z with its origin at rest; the IMU is turned, off the origin and 8 ms late."""
    delay, lever_arm = 8e-3, np.array([0.1, 0.05, 0.02])
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    t = np.arange(0, 2.0, DT)
    rate, change = 2 * np.sin(5 * (t - delay)), 10 * np.cos(5 * (t - delay))
    zero = 0 * t
    w, alpha = np.stack([zero, zero, rate]), np.stack([zero, zero, change])
    tangential = np.cross(alpha, lever_arm, axis=0)
    centripetal = np.cross(w, np.cross(w, lever_arm, axis=0), axis=0)
    acceleration = np.array([[0.0], [0.0], [9.81]]) + tangential + centripetal
    channels = {}
    for axis, own_w, own_a in zip("xyz", turn.T @ w, turn.T @ acceleration, strict=True):
        channels[f"imu_w{axis}"] = Channel(t, own_w)
        channels[f"imu_a{axis}"] = Channel(t, own_a)
    config = config_of(base={"kind": "floating", "imu": {"delay": delay}})
    log = with_sensors(log_of(channels), needed_channels(config))
    sensors = ImuSensors(log, Frame(0, turn, lever_arm), config.base.imu.known_delay)
    at = np.arange(0.2, 1.8, DT)
    v, a = sensors.kinematics(at, DT, identity)
    inner = at[2 * DIFFERENCE_REACH : -2 * DIFFERENCE_REACH]
    np.testing.assert_allclose(v[3:], np.stack([0 * inner, 0 * inner, 2 * np.sin(5 * inner)]), atol=1e-5)
    np.testing.assert_allclose(v[:3], 0)
    np.testing.assert_allclose(a[:3], np.outer([0, 0, 9.81], np.ones(len(inner))), atol=2e-4)
    np.testing.assert_allclose(a[5], 10 * np.cos(5 * inner), atol=1e-3)


@pytest.mark.parametrize("sign", [1, -1])
def test_wrench_is_that_on_the_link(sign: int) -> None:
    """Measured on the link, or on what it touches."""
    t = np.arange(0, 2.0, DT)
    names = [f"force_plate_{part}" for part in ("x", "y", "z", "mx", "my", "mz")]
    plate = {name: Channel(t, (k + 1) * np.sin(t)) for k, name in enumerate(names)}
    contact = {"name": "tool", "link": "calf", "kind": "surface", "force": names[:3], "moment": names[3:], "sign": sign}
    config = config_of(base={"kind": "fixed"}, contacts=[contact])
    assert needed_channels(config) == tuple(names)
    log = with_sensors(log_of(plate), needed_channels(config))
    at = np.arange(0.2, 1.8, DT)
    samples = ContactChannels(config.contacts, log.channels, None).samples(at, at, identity)
    np.testing.assert_allclose(samples.wrenches[0], sign * np.outer(np.arange(1, 7), np.sin(at)), atol=1e-6)


def test_flag_is_widened_at_both_ends() -> None:
    """Set from 0.5 s to 1.0 s, and logged at a rate of 20 Hz."""
    t = np.arange(0, 2.0, 0.05)
    flag = Channel(t, ((t > 0.49) & (t < 0.99)).astype(float))
    still = {f"imu_{name}": Channel(t, 0 * t) for name in ("wx", "wy", "wz", "ax", "ay", "az")}
    contact = {"name": "foot", "link": "calf", "flag": "contact_foot", "widen": 0.1}
    config = config_of(contacts=[contact, {"name": "rope", "link": "trunk", "kind": "surface"}])
    log = with_sensors(log_of({"contact_foot": flag, **still}), needed_channels(config))
    at = np.arange(0.2, 1.8, DT)
    is_closed = ContactChannels(config.contacts, log.channels, None).samples(at, at, identity).is_closed
    first, last = at[is_closed[0]][[0, -1]]
    assert (first, last) == pytest.approx((0.4, 1.1), abs=2e-3)
    assert is_closed[1].all()  # without a flag, always


@pytest.fixture(scope="module")
def recording() -> Recording:
    return record_quadruped("hang", 0.3)


def test_topics_become_the_channels_of_the_table(recording: Recording, tmp_path: Path) -> None:
    """Messages by mcap_ros2; the IMU at half the rate of the joints, and one message of the rope's flag."""
    write_mcap(tmp_path / "log.mcap", TRUTH, recording)
    log = read_log(tmp_path / "log.mcap", sensors=SensorOptions())
    columns = recording.columns
    for axis in ("wx", "ay", "qz"):
        channel = log.channels[f"imu_{axis}"]
        np.testing.assert_allclose(channel.t, 1000 + columns["t"][::2], atol=1e-6)
        np.testing.assert_array_equal(channel.x, columns[f"imu_{axis}"][::2])
    np.testing.assert_array_equal(log.channels["force_RL_foot_z"].x, columns["force_RL_foot_z"])
    assert log.channels["contact_rope"].x.tolist() == [1.0]
    names = ["imu_wx", "force_FL_foot_y", "contact_rope", "contact_FR_foot"]
    assert sum(part.stop - part.start for part in with_sensors(log, names).segments) == len(log)
    assert not read_log(tmp_path / "log.mcap").channels  # which a fixed base does not need


@pytest.mark.parametrize(
    ("imu", "message"),
    [
        (None, "2 topics carry an IMU; set base.imu.topic to one of /imu, /torso/imu"),
        ("/gyro", "no IMU on topic /gyro"),
    ],
)
def test_imu_is_chosen_by_its_topic(recording: Recording, tmp_path: Path, imu: str | None, message: str) -> None:
    path = tmp_path / "log.mcap"
    write_mcap(path, TRUTH, recording, imu_topics=("/imu", "/torso/imu"))
    with pytest.raises(LogError, match=message):
        read_log(path, sensors=SensorOptions(imu))
    assert "imu_wx" in read_log(path, sensors=SensorOptions("/torso/imu")).channels
    assert imu_topics(path) == ("/imu", "/torso/imu")


def test_message_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    schema = Schema(id=1, name="sensor_msgs/msg/Imu", encoding="ros2msg", data=b"")
    decoder = sensor_decoder_for("cdr", schema)
    assert decoder is not None
    message = bytes([0, 1, 0, 0]) + bytes(100)
    with pytest.raises(PayloadError, match="is incomplete"):
        decoder.decode(message, np.array([0]), np.array([len(message)]))
    assert sensor_decoder_for("cdr", Schema(id=1, name="tf2_msgs/msg/TFMessage", encoding="ros2msg", data=b"")) is None


def test_flag_of_another_clock_is_refused() -> None:
    """Stamps since 1970, and joints that begin at 0."""
    flag = Channel(1.7e9 + np.arange(10.0), np.ones(10))
    with pytest.raises(LogError, match=r"contact_foot are .* from those of the joints: it has another clock"):
        with_sensors(log_of({"contact_foot": flag}), ["contact_foot"])


def test_flag_is_set_before_its_first_value() -> None:
    """A flag that is logged when it changes: the foot is lifted after a second."""
    log = with_sensors(log_of({"contact_foot": Channel(np.array([1.0]), np.array([0.0]))}), ["contact_foot"])
    assert log.channels["contact_foot"].is_set(np.array([0.5, 1.5])).tolist() == [True, False]


def test_flag_is_the_same_in_parts(rng: np.random.Generator) -> None:
    """As read in batches, each of which looks at the values about it only."""
    times = np.cumsum(rng.integers(0, 3, 200))  # some of them twice
    flag = Channel(times.astype(float), rng.integers(0, 2, 200).astype(float))
    t = np.arange(-5.0, times[-1] + 5.0, 0.5)
    for widen in (0.0, 2.0):
        expected = flag.is_set(t, widen)
        parts = [flag.is_set(part, widen) for part in np.array_split(t, 40)]
        np.testing.assert_array_equal(np.concatenate(parts), expected)
        one_by_one = [(flag.x[max(np.searchsorted(times, at - widen, "right") - 1, 0)] > 0.5) for at in t]
        near = [flag.x[(times >= at - widen) & (times <= at + widen)].max(initial=0.0) > 0.5 for at in t]
        np.testing.assert_array_equal(expected, np.logical_or(one_by_one, near))
    assert not len(flag.is_set(t[:0]))
