"""MCAP logs against the mcap packages: what they write is read, and what they decode is what is read."""

from __future__ import annotations

import struct
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2._cdr import CdrReader, CdrWriter, EncapsulationKind
from mcap_ros2.decoder import DecoderFactory
from recordings import (
    COMPRESSIONS,
    FIELDS,
    UNINDEXED,
    Channel,
    State,
    check_log,
    ros2,
    states,
    write_mcap,
)
from sentences import sentences

from idtool.common.exceptions import LogError
from idtool.data.logs import read_log

NAMES = ("abad", "hip", "knee")


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("options", [{}, {"use_chunking": False}, UNINDEXED, {**UNINDEXED, "use_chunking": False}])
def test_every_container(tmp_path: Path, compression: str, options: dict[str, Any]) -> None:
    items = states(300)
    path = write_mcap(
        tmp_path / "log", ros2(items), compression=COMPRESSIONS[compression], **{"chunk_size": 7000} | options
    )
    log = read_log(path)
    check_log(log, items)
    assert sentences(log.notices) == ()


def test_many_messages(tmp_path: Path) -> None:
    items = states(12_000, NAMES[:1])  # more than are decoded together, or taken together outside chunks
    check_log(read_log(write_mcap(tmp_path / "log", ros2(items), use_chunking=False)), items)
    check_log(read_log(write_mcap(tmp_path / "log", ros2(items))), items)


def records(path: Path, *opcodes: int) -> bytes:
    """Whole records of an MCAP file, as they stand there."""
    data, at, found = path.read_bytes(), 8, b""
    while data[at] != 0x0F:
        end = at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")
        found += data[at:end] if data[at] in opcodes else b""
        at = end
    return found


def test_messages_in_chunks_and_outside(tmp_path: Path) -> None:
    items = states(90)
    loose = records(write_mcap(tmp_path / "loose", ros2(items[:30]), use_chunking=False), 3, 4, 5)
    chunks = records(write_mcap(tmp_path / "chunks", ros2(items[30:60]), chunk_size=900), 6)
    more = records(write_mcap(tmp_path / "more", ros2(items[60:]), use_chunking=False), 3, 4, 5)
    end = b"\x0f" + (4).to_bytes(8, "little") + bytes(4)
    magic = b"\x89MCAP0\r\n"
    (tmp_path / "log").write_bytes(magic + loose + chunks + more + end + magic)
    log = read_log(tmp_path / "log")
    check_log(log, items)
    assert sentences(log.notices) == ()


def test_reads_what_the_decoder_decodes(tmp_path: Path) -> None:
    items = [replace(state, frame="base" * (i % 3)) for i, state in enumerate(states(50, ("a", "bcd", "ef/gh.i", "ü")))]
    path = write_mcap(tmp_path / "log.mcap", ros2(items))
    log = read_log(path)
    with path.open("rb") as file:
        decoded = [
            message for *_, message in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        ]
    for signal, field in FIELDS.items():
        np.testing.assert_array_equal(log.signals[signal], [getattr(message, field) for message in decoded])
    assert log.joints == tuple(decoded[0].name)
    assert log.t.tolist() == [m.header.stamp.sec + m.header.stamp.nanosec / 1e9 for m in decoded]


def big_endian(state: State) -> bytes:
    """A state in big-endian CDR, by the encoder of mcap_ros2."""
    stream = BytesIO()
    writer = CdrWriter(stream, EncapsulationKind.CDR_BE)
    writer.write_int32(state.stamp // 10**9)
    writer.write_uint32(state.stamp % 10**9)
    writer.write_string(state.frame)
    writer.write_uint32(len(state.names))
    writer.write_string_array(list(state.names))
    for field in FIELDS.values():
        writer.write_uint32(len(getattr(state, field)))
        writer.write_float64_array(getattr(state, field))
    return stream.getvalue()


def test_big_endian(tmp_path: Path) -> None:
    items = states(20, ("a", "bc", "defg"))
    channel = replace(ros2(items), payloads=[big_endian(state) for state in items])
    assert not CdrReader(channel.payloads[0]).little_endian
    check_log(read_log(write_mcap(tmp_path / "log", channel)), items)


@pytest.mark.parametrize("order", ["<", ">"])
def test_xcdr2(tmp_path: Path, order: str) -> None:
    def encode(state: State) -> bytes:
        names = struct.pack(f"{order}I", len(state.names))
        for name in state.names:
            names += bytes(-len(names) % 4) + struct.pack(f"{order}I", len(name) + 1) + name.encode() + b"\0"
        data = struct.pack(f"{order}iII", state.stamp // 10**9, state.stamp % 10**9, 1) + b"\0\0\0\0"
        data += struct.pack(f"{order}I", len(names)) + names
        for field in FIELDS.values():
            values = getattr(state, field)
            data += bytes(-len(data) % 4) + struct.pack(f"{order}I{len(values)}d", len(values), *values)
        return (b"\0\6" if order == ">" else b"\0\7") + b"\0\0" + data

    items = states(20, ("a", "bc"))
    channel = replace(ros2(items), payloads=[encode(state) for state in items])
    check_log(read_log(write_mcap(tmp_path / "log", channel)), items)


def test_padding_is_not_looked_at(tmp_path: Path) -> None:
    items = states(40, ("a", "b"))
    channel = ros2(items)
    first = np.frombuffer(channel.payloads[0], np.uint8)
    padding = (
        first.size - first[::-1].tobytes().find(b"\0a") - 2
    )  # the byte that closes the name, which padding follows
    payloads = [
        data[: padding + 2] + bytes([i, i, i])[: -(padding + 2) % 4] + data[padding + 2 :][-(padding + 2) % 4 :]
        for i, data in enumerate(channel.payloads)
    ]
    assert len(set(map(len, payloads))) == 1
    check_log(read_log(write_mcap(tmp_path / "log", replace(channel, payloads=payloads))), items)


def test_mixed_shapes(tmp_path: Path) -> None:
    both = states(60)
    items = []
    for i, state in enumerate(both):
        order = [(0, 1, 2), (2, 0, 1)][i % 2]  # of one length, in another order
        items.append(
            replace(
                state,
                names=[state.names[k] for k in order],
                position=[state.position[k] for k in order],
                velocity=[state.velocity[k] for k in order] if i % 5 else (),
                effort=[state.effort[k] for k in order],
            )
        )
    log = read_log(write_mcap(tmp_path / "log", ros2(items)))
    check_log(log, items)
    assert any("12 samples" in warning for warning in sentences(log.notices))  # which lack the velocity


def test_joints_that_come_later(tmp_path: Path) -> None:
    items = states(30, ("hip",)) + states(40, ("hip", "knee"), 10**18 + 30 * 10**6)
    log = read_log(write_mcap(tmp_path / "log", ros2(items), chunk_size=500))
    check_log(log, items)
    assert log.segments == (slice(30, 70),)


def test_sources_that_take_turns(tmp_path: Path) -> None:
    arm, gripper = states(100), states(20, ("finger",), 10**18 + 1000, 5 * 10**6)
    both = sorted([*arm, *gripper], key=lambda state: state.stamp)
    log = read_log(write_mcap(tmp_path / "log", ros2(both), chunk_size=3000))
    check_log(log, arm)
    assert sentences(log.notices)[0].endswith(
        "kept: 100 samples of abad, hip, knee; ignored: 20 samples, q_finger, v_finger, tau_finger"
    )


def test_a_source_that_speaks_seldom(tmp_path: Path) -> None:
    arm = states(100)
    items = [
        replace(s, names=[*s.names, "finger"], position=[*s.position, 1.0], velocity=[*s.velocity, 0.0], effort=())
        if i % 10 == 5
        else replace(s, effort=())
        for i, s in enumerate(arm)
    ]
    log = read_log(write_mcap(tmp_path / "log", ros2(items)))
    check_log(log, [replace(s, effort=()) for s in arm])
    assert sentences(log.notices)[0].endswith("ignored: q_finger, v_finger")


def test_two_publishers_of_one_topic(tmp_path: Path) -> None:
    items = states(40)
    path = write_mcap(tmp_path / "log", ros2(items[::2]), ros2(items[1::2]))
    check_log(read_log(path), items)


def test_nothing_but_nan(tmp_path: Path) -> None:
    items = [replace(state, position=[np.nan] * 3, velocity=(), effort=()) for state in states(10)]
    with pytest.raises(LogError, match="no joint positions found"):
        read_log(write_mcap(tmp_path / "log", ros2(items)))


def test_missing_signals(tmp_path: Path) -> None:
    items = [replace(state, velocity=(), effort=()) for state in states(10)]
    assert list(read_log(write_mcap(tmp_path / "log", ros2(items))).signals) == ["q"]
    unknown = [replace(state, effort=[np.nan] * 3) for state in states(10)]
    assert list(read_log(write_mcap(tmp_path / "log", ros2(unknown))).signals) == ["q", "v"]


def test_log_time_where_the_stamp_is_zero(tmp_path: Path) -> None:
    items = [replace(state, stamp=0 if i % 2 else state.stamp) for i, state in enumerate(states(20))]
    log = read_log(write_mcap(tmp_path / "log", ros2(items)))
    check_log(log, [replace(state, stamp=state.stamp or state.logged) for state in items])


def test_messages_without_joints_are_no_samples(tmp_path: Path) -> None:
    items = states(20)
    empty = replace(items[7], names=(), position=(), velocity=(), effort=())
    log = read_log(write_mcap(tmp_path / "log", ros2([*items[:7], empty, *items[7:]])))
    check_log(log, items)
    assert len(log.segments) == 1


@pytest.mark.parametrize(
    ("payload", "said"),
    [
        (b"", "no joint positions"),
        (b"\0\1", "message 3 of /joint_states is not plain CDR: it begins with 00 01"),
        (b"\0\2\0\0" + bytes(40), "is not plain CDR"),
        (b"\0\1\0\0" + bytes(8), "ends within a field, after 12 bytes"),
        (b"\0\1\0\0" + bytes(8) + b"\1\0\0\0\0" + bytes(3) + b"\xff\xff\xff\xff", "is too short for 4294967295 names"),
        (b"\0\1\0\0" + bytes(8) + b"\1\0\0\0\0" + bytes(3) + b"\1\0\0\0\2\0\0\0\xff\0", "not UTF-8"),
        (b"\0\1\0\0" + bytes(8) + b"\xff\xff\xff\xff", "ends within a field, after 16 bytes"),
    ],
)
def test_payloads_that_cannot_be_read(tmp_path: Path, payload: bytes, said: str) -> None:
    payloads = [cdr_of(1, 1)] * 2 + [payload] if payload else [payload] * 3
    path = write_mcap(tmp_path / "log", Channel("/joint_states", range(3), payloads))
    with pytest.raises(LogError, match=said):
        read_log(path)


def cdr_of(names: int, values: int) -> bytes:
    """A message with another number of names than of positions, unless these are equal."""
    body = struct.pack("<iII", 1, 0, 1) + b"\0\0\0\0" + struct.pack("<I", names)
    body += b"".join(struct.pack("<I", 2) + bytes([97 + i, 0, 0, 0]) for i in range(names))
    body += struct.pack("<I", values)
    body += bytes(-len(body) % 8) * bool(values) + bytes(8 * values) + bytes(8)
    return b"\0\1\0\0" + body


def test_counts_that_do_not_agree(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "log", Channel("/joint_states", range(3), [cdr_of(3, 2)] * 3))
    with pytest.raises(LogError, match="message 1 of /joint_states has 3 names and 2 values of position"):
        read_log(path)


def test_a_joint_that_comes_twice(tmp_path: Path) -> None:
    items = states(3, ("hip", "hip"))
    with pytest.raises(LogError, match="names joint hip twice"):
        read_log(write_mcap(tmp_path / "log", ros2(items)))


def test_names_without_end(tmp_path: Path) -> None:
    items = [replace(state, names=(f"j{i}",)) for i, state in enumerate(states(600, ("x",)))]
    with pytest.raises(LogError, match="more than 512 joints"):
        read_log(write_mcap(tmp_path / "log", ros2(items)))
