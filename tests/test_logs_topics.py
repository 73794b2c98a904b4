"""Which topic of an MCAP file is read."""

from __future__ import annotations

from pathlib import Path

import pytest
from recordings import Channel, json_channel, ros2, states, write_mcap
from test_logs_mcap import check

from idtool.exceptions import LogError
from idtool.logs import read_log


def imu(topic: str = "/imu") -> Channel:
    return Channel(topic, [1, 2], [b"x" * 40, b"y" * 40], schema=("sensor_msgs/msg/Imu", "ros2msg", b"float64 x"))


def test_other_topics_are_passed_over(tmp_path: Path) -> None:
    items = states(30)
    check(read_log(write_mcap(tmp_path / "log", imu(), ros2(items), imu("/tf"))), items)


def test_several_topics(tmp_path: Path) -> None:
    left, right = states(20), states(25, ("wrist",))
    path = write_mcap(tmp_path / "log", ros2(left, "/left/joint_states"), json_channel(right, "/right/joint_states"))
    with pytest.raises(LogError, match=r"set log\.topic to one of /left/joint_states, /right/joint_states"):
        read_log(path)
    check(read_log(path, topic="/left/joint_states"), left)
    check(read_log(path, topic="/right/joint_states"), right)


def test_topic_without_messages_is_no_candidate(tmp_path: Path) -> None:
    items = states(20)
    check(read_log(write_mcap(tmp_path / "log", ros2([], "/other"), ros2(items))), items)


@pytest.mark.parametrize(
    ("topic", "said"),
    [
        ("/joint_state", "has no topic /joint_state; did you mean /joint_states?"),
        ("/imu", "topic /imu carries sensor_msgs/msg/Imu, cdr, not joint states; there are: /joint_states"),
        ("/empty", "topic /empty holds no messages"),
    ],
)
def test_topics_that_cannot_be_read(tmp_path: Path, topic: str, said: str) -> None:
    path = write_mcap(tmp_path / "log", ros2(states(20)), imu(), ros2([], "/empty"))
    with pytest.raises(LogError) as error:
        read_log(path, topic=topic)
    assert error.value.what == said
