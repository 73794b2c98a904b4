"""Written logs have the channels of the sensors, which are read back as they were."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ground.logs import write_mcap
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from quadruped_recordings import TRUTH, record_quadruped

from idtool.api.log import Log
from idtool.common.exceptions import LogError
from idtool.data.logs import JointLog, make_log
from idtool.data.logs.log import Channel
from idtool.data.logs.merged_rows import merge_rows
from idtool.data.logs.sensor_channels import finite_samples, with_sensors

SUFFIXES = (".csv", ".mcap")


def check_equal(log: JointLog, expected: JointLog) -> None:
    """Bit by bit, where there are values."""
    np.testing.assert_array_equal(log.t, expected.t)
    for name, values in expected.signals.items():
        np.testing.assert_array_equal(log.signals[name], values)
    filled = {name: channel for name, channel in log.channels.items() if len(finite_samples(channel).t)}
    assert filled.keys() == expected.channels.keys()
    for name, channel in expected.channels.items():
        written, read = finite_samples(channel), finite_samples(filled[name])
        np.testing.assert_array_equal(read.t, written.t)
        np.testing.assert_array_equal(read.x, written.x)


def log_of(channels: dict[str, Channel], start: float = 0.0) -> JointLog:
    t = np.round(start + 1e-3 * np.arange(200), 9)  # as stamps are
    log = make_log(Path("log"), t, ("hip",), {"q": np.sin(t)[:, None], "tau": np.cos(t)[:, None]})
    return replace(log, channels=channels)


@pytest.fixture(scope="module")
def ground_log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    """By mcap_ros2: an IMU at half the rate of the joints, flags, wrenches, and one message of the rope's flag."""
    path = tmp_path_factory.mktemp("ground") / "log.mcap"
    write_mcap(path, TRUTH, record_quadruped("hang", 0.3))
    return Log(path, sensors=True)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_log_of_a_quadruped(ground_log: Log, tmp_path: Path, suffix: str) -> None:
    once = Log(ground_log.save(tmp_path / f"once{suffix}"), sensors=True)
    check_equal(once.record, ground_log.record)
    other = ".csv" if suffix == ".mcap" else ".mcap"
    check_equal(Log(once.save(tmp_path / f"twice{other}"), sensors=True).record, ground_log.record)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_stamps_of_their_own(tmp_path: Path, suffix: str, start: float) -> None:
    """Before, between and after the joints' samples, some equal to them, some twice, some without a value."""
    rng = np.random.default_rng(0)
    ticks = np.sort(rng.choice(np.arange(0, 250_000_000, 50_000), 300, replace=False))
    t = start + np.concatenate([ticks / 1e9, [0.05, 0.05, 0.1]])
    x = rng.normal(size=len(t))
    x[::7] = np.nan
    flag = Channel(np.array([start]), np.array([1.0]))
    channels = {
        "imu_wx": Channel(t, x),
        "imu_ay": Channel(t[1:], x[1:]),
        "force_left_x": Channel(t, x**3),
        "force_left_mz": Channel(t[:9], np.arange(9.0)),
        "contact_left": flag,
        "contact_right": Channel(t, (rng.random(len(t)) > 0.5).astype(float)),
    }
    log = log_of(channels, start)
    check_equal(Log(Log.from_record(log).save(tmp_path / f"log{suffix}"), sensors=True).record, log)


def test_messages_are_those_of_ros(ground_log: Log, tmp_path: Path) -> None:
    """As mcap_ros2 decodes them."""
    path = ground_log.save(tmp_path / "log.mcap")
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        messages: dict[str, list[object]] = {}
        for _, channel, _, message in reader.iter_decoded_messages():
            messages.setdefault(channel.topic, []).append(message)
    assert {"/joint_states", "/imu", "/force/FL_foot", "/contact/FL_foot", "/contact/rope"} <= messages.keys()
    channels = ground_log.record.channels
    imu = [message.angular_velocity.y for message in messages["/imu"]]  # type: ignore[attr-defined]
    np.testing.assert_array_equal(imu, channels["imu_wy"].x)
    stamps = [m.header.stamp.sec + m.header.stamp.nanosec / 1e9 for m in messages["/imu"]]  # type: ignore[attr-defined]
    np.testing.assert_array_equal(stamps, channels["imu_wy"].t)
    moments = [message.wrench.torque.z for message in messages["/force/FL_foot"]]  # type: ignore[attr-defined]
    np.testing.assert_array_equal(moments, channels["force_FL_foot_mz"].x)
    assert [message.data for message in messages["/contact/rope"]] == [True]  # type: ignore[attr-defined]


def test_log_with_its_sensors_chosen_can_be_written(tmp_path: Path) -> None:
    """Flags then have a value before the log, at a negative time, which MCAP lacks."""
    flag = Channel(np.array([0.05, 0.1]), np.array([0.0, 1.0]))
    log = with_sensors(log_of({"contact_foot": flag}), ["contact_foot"])
    assert log.channels["contact_foot"].t[0] < 0
    for suffix in SUFFIXES:
        read = Log(Log.from_record(log).save(tmp_path / f"log{suffix}"), sensors=True).record
        is_set = read.channels["contact_foot"]
        expected = (log.t < 0.05) | (log.t >= 0.1)
        np.testing.assert_array_equal(finite_samples(is_set).is_set(log.t), expected)


@pytest.mark.parametrize(
    ("channels", "start", "expected"),
    [
        ({"contact_left/toe": Channel(np.zeros(1), np.ones(1))}, 0.0, "channel contact_left/toe cannot be a topic"),
        ({"force_contact_toe_x": Channel(np.zeros(1), np.ones(1))}, 0.0, "force_contact_toe_x cannot be a topic"),
        ({"contact_left": Channel(np.array([-0.05]), np.ones(1))}, -0.1, "contact_left has negative times"),
        ({"imu_wx": Channel(np.array([1e10]), np.ones(1))}, 0.0, "times are too large for a header stamp"),
    ],
)
def test_what_mcap_cannot_hold(tmp_path: Path, channels: dict[str, Channel], start: float, expected: str) -> None:
    log = log_of(channels, start)
    with pytest.raises(LogError, match=expected):
        Log.from_record(log).save(tmp_path / "log.mcap")
    assert not list(tmp_path.iterdir())
    if channels.keys().isdisjoint({"imu_wx"}):
        check_equal(Log(Log.from_record(log).save(tmp_path / "log.csv"), sensors=True).record, log)


def test_rows_keep_the_order_of_the_joints() -> None:
    t = np.array([0.0, 2.0, 1.0, np.nan, 3.0])
    times, (first, second) = merge_rows(t, [np.array([0.5, 1.0, 1.0, 9.0])])
    np.testing.assert_array_equal(times[first >= 0], t)
    assert first[first >= 0].tolist() == [0, 1, 2, 3, 4]
    assert second[second >= 0].tolist() == [0, 2, 1, 3]
    np.testing.assert_array_equal(times[second >= 0], [0.5, 1.0, 1.0, 9.0])
