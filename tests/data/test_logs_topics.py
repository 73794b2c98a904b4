"""Which topic of an MCAP file is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from recordings import Channel, Proto, State, bag, check_log, json_channel, proto_channel, ros2, states, write_mcap
from sentences import sentences

from idtool.common.exceptions import LogError
from idtool.data.logs import read_log
from idtool.data.logs.state_topics import state_topics


def imu(topic: str = "/imu") -> Channel:
    return Channel(topic, [1, 2], [b"x" * 40, b"y" * 40], schema=("sensor_msgs/msg/Imu", "ros2msg", b"float64 x"))


def test_other_topics_are_passed_over(tmp_path: Path) -> None:
    items = states(30)
    check_log(read_log(write_mcap(tmp_path / "log", imu(), ros2(items), imu("/tf"))), items)


def test_several_topics(tmp_path: Path) -> None:
    left, right = states(20), states(25, ("wrist",))
    path = write_mcap(tmp_path / "log", ros2(left, "/left/joint_states"), json_channel(right, "/right/joint_states"))
    with pytest.raises(LogError, match=r"set log\.topic to one of /left/joint_states, /right/joint_states"):
        read_log(path)
    check_log(read_log(path, topic="/left/joint_states"), left)
    check_log(read_log(path, topic="/right/joint_states"), right)


def test_topic_without_messages_is_no_candidate(tmp_path: Path) -> None:
    items = states(20)
    check_log(read_log(write_mcap(tmp_path / "log", ros2([], "/other"), ros2(items))), items)


@pytest.mark.parametrize(
    ("topic", "said"),
    [
        ("/joint_state", "has no topic /joint_state; did you mean /joint_states?"),
        ("/imu", "topic /imu carries sensor_msgs/msg/Imu, cdr, not joint states; available: /joint_states"),
        ("/empty", "topic /empty has no messages"),
    ],
)
def test_topics_that_cannot_be_read(tmp_path: Path, topic: str, said: str) -> None:
    path = write_mcap(tmp_path / "log", ros2(states(20)), imu(), ros2([], "/empty"))
    with pytest.raises(LogError) as error:
        read_log(path, topic=topic)
    assert error.value.what == said


# --- topics of joint states that are none of a log ---


def effort_only(items: Sequence[State]) -> list[State]:
    return [replace(state, position=(), velocity=()) for state in items]


def velocity_only(items: Sequence[State]) -> list[State]:
    return [replace(state, position=(), effort=()) for state in items]


def no_number(items: Sequence[State]) -> list[State]:
    return [replace(state, position=[float("nan")] * 3) for state in items]


def latched(items: Sequence[State]) -> list[State]:
    return list(items[:1])


BESIDE = {change.__name__: change for change in (effort_only, velocity_only, no_number, latched)}


@pytest.mark.parametrize("beside", BESIDE)
@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("batch", [4096, 7])
def test_commands_and_latched_states_are_no_candidates(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, beside: str, first: bool, batch: int
) -> None:
    monkeypatch.setattr("idtool.data.logs.mcap_records._BATCH", batch)
    items = states(50)
    channels = [ros2(BESIDE[beside](states(50, start=10**17)), "/command"), ros2(items)]
    path = write_mcap(tmp_path / "log", *channels[:: 1 if first else -1])
    log = read_log(path)
    check_log(log, items)
    assert sentences(log.notices) == ()
    assert state_topics(path) == ("/joint_states",)


def test_states_that_begin_after_the_commands(tmp_path: Path) -> None:
    """In another file, and in one in which the topic is the first."""
    items = states(60)
    folder = bag(tmp_path / "run", [], items[:30], items[30:])
    write_mcap(folder / "run_0.mcap", ros2(effort_only(states(40)), "/command"))
    check_log(read_log(folder), items)
    assert state_topics(folder) == ("/joint_states",)


def test_two_topics_of_states_beside_commands_are_still_two(tmp_path: Path) -> None:
    channels = [ros2(states(20), "/left"), ros2(effort_only(states(20)), "/command"), ros2(states(20), "/right")]
    path = write_mcap(tmp_path / "log", *channels)
    with pytest.raises(LogError, match=r"2 topics carry joint states; set log\.topic to one of /left, /right"):
        read_log(path)
    assert state_topics(path) == ("/left", "/right")


def test_commands_alone_are_no_log(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "log", ros2(effort_only(states(20)), "/command"), ros2(states(20)))
    with pytest.raises(LogError, match="no joint positions found"):
        read_log(path, topic="/command")
    with pytest.raises(LogError, match="no joint positions found"):
        read_log(write_mcap(tmp_path / "log", ros2(effort_only(states(20)), "/command")))


# --- the topics to choose from ---


def test_the_topics_of_a_bag_in_several_files(tmp_path: Path) -> None:
    folder = bag(tmp_path / "run", states(20), states(20), states(20))
    write_mcap(folder / "run_1.mcap", imu(), ros2(states(20), "/other"))
    write_mcap(folder / "run_2.mcap", proto_channel(states(20), Proto()), ros2([], "/empty"))
    assert state_topics(folder) == ("/joint_states", "/other")
    assert state_topics(folder / "run_1.mcap") == ("/other",)
    (tmp_path / "log.csv").write_text("t,q_hip\n0,1\n")
    assert state_topics(tmp_path / "log.csv") == ()


def test_topics_are_found_without_decoding_all_messages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from idtool.data.logs.topics import TopicReader

    decoded: list[int] = []
    original = TopicReader._decode

    def counted(self: TopicReader, *given: Any) -> Any:
        samples = original(self, *given)
        decoded.append(sum(len(piece.t) for piece in samples))
        return samples

    monkeypatch.setattr(TopicReader, "_decode", counted)
    monkeypatch.setattr("idtool.data.logs.mcap_records._BATCH", 10)
    path = write_mcap(tmp_path / "log", ros2(states(100), "/a"), ros2(states(100), "/b"))
    assert state_topics(path) == ("/a", "/b")
    assert sum(decoded) == 10
    decoded.clear()
    read_log(path, topic="/b")
    assert sum(decoded) == 105  # and the first batch of the other
