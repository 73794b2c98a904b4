"""Logs cut off in mid-write: what was whole is kept, and damage elsewhere is told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from recordings import COMPRESSIONS, Channel, State, ros2, states, write_mcap
from sentences import sentences

from idtool.common.exceptions import LogError
from idtool.data.logs import JointLog, read_log

LAYOUTS: list[dict[str, Any]] = [
    {"use_chunking": False},
    *({"chunk_size": 1500, "compression": compression} for compression in COMPRESSIONS.values()),
]


def kept(path: Path, data: bytes, full: JointLog) -> int:
    """How many samples are read of the beginning of a file; they are the first of ``full``."""
    path.write_bytes(data)
    try:
        log = read_log(path)
    except LogError:
        return 0
    np.testing.assert_array_equal(log.t, full.t[: len(log)])
    for signal in full.signals:
        np.testing.assert_array_equal(log.signals[signal], full.signals[signal][: len(log)])
    assert sentences(log.notices) == (
        f"the file was cut off while it was written; kept: {len(log)} samples, up to t = {log.t[-1]:.3f} s",
    )
    return len(log)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_everywhere(tmp_path: Path, layout: dict[str, Any]) -> None:
    path = write_mcap(tmp_path / "whole", ros2(states(40)), **layout)
    full, data = read_log(path), path.read_bytes()
    counts = [kept(tmp_path / "cut", data[:size], full) for size in range(0, len(data), 31)]
    assert counts == sorted(counts)
    assert counts[-1] == kept(tmp_path / "cut", data[:-1], full) == 40


@pytest.mark.parametrize("layout", LAYOUTS[:2])
def test_uncompressed_up_to_the_last_whole_message(tmp_path: Path, layout: dict[str, Any]) -> None:
    channel = ros2(states(40))
    path = write_mcap(tmp_path / "whole", channel, **layout)
    full, data = read_log(path), path.read_bytes()
    ends = [data.index(payload) + len(payload) for payload in channel.payloads]
    for i, end in enumerate(ends[2:], 2):
        assert kept(tmp_path / "cut", data[:end], full) == i + 1
        assert kept(tmp_path / "cut", data[: end - 1], full) == (i if i > 1 else 0)


@pytest.mark.parametrize("layout", LAYOUTS[1:])
def test_all_chunks_that_are_whole(tmp_path: Path, layout: dict[str, Any]) -> None:
    path = write_mcap(tmp_path / "whole", ros2(states(40)), **layout)
    full, data = read_log(path), path.read_bytes()
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary
    assert len(summary.chunk_indexes) > 4
    for chunk in summary.chunk_indexes:
        count = int((full.t <= (chunk.message_end_time - 4) / 1e9).sum())
        assert kept(tmp_path / "cut", data[: chunk.chunk_start_offset + chunk.chunk_length], full) == count


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_part_of_a_chunk(tmp_path: Path, compression: str) -> None:
    path = write_mcap(tmp_path / "whole", ros2(states(6000)), chunk_size=1 << 23, compression=COMPRESSIONS[compression])
    full, data = read_log(path), path.read_bytes()
    assert 2000 < kept(tmp_path / "cut", data[: len(data) // 2], full) < 4000


@pytest.mark.parametrize("zeros", [1024, 100_000])
@pytest.mark.parametrize("layout", [LAYOUTS[0], LAYOUTS[3]])
def test_zeros_in_place_of_the_rest(tmp_path: Path, layout: dict[str, Any], zeros: int) -> None:
    path = write_mcap(tmp_path / "whole", ros2(states(40)), **layout)
    full, data = read_log(path), path.read_bytes()
    count = kept(tmp_path / "cut", data[: len(data) // 2], full)
    assert 10 < count == kept(tmp_path / "cut", data[: len(data) // 2] + bytes(zeros), full)


def test_zeros_in_between(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "log", ros2(states(40)), use_chunking=False)
    data = path.read_bytes()
    path.write_bytes(data[:3000] + bytes(2000) + data[5000:])
    with pytest.raises(LogError):
        read_log(path)


def test_nothing_left(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "whole", ros2(states(40)))
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(LogError, match="cut off before its first message"):
        read_log(path)


def damaged(path: Path, find: bytes, change: bytes) -> Path:
    """The same file with other bytes where ``find`` comes first."""
    data = path.read_bytes()
    at = data.index(find)
    path.write_bytes(data[:at] + change + data[at + len(change) :])
    return path


def test_damage_is_no_cut(tmp_path: Path) -> None:
    channel = ros2(states(40))
    length = (len(channel.payloads[20]) + 22).to_bytes(8, "little")
    for name, layout in (("loose", {"use_chunking": False}), ("chunk", {"compression": COMPRESSIONS["none"]})):
        path = write_mcap(tmp_path / name, channel, **layout)
        with pytest.raises(LogError, match=r"damaged near byte \d+; try 'mcap recover'"):
            read_log(damaged(path, b"\5" + length, b"\5" + (10**12).to_bytes(8, "little")))
    with pytest.raises(LogError, match="damaged near byte"):
        read_log(damaged(path, b"\5" + (10**12).to_bytes(8, "little"), b"\5" + (3).to_bytes(8, "little")))


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_damage_in_a_chunk(tmp_path: Path, compression: str) -> None:
    path = write_mcap(tmp_path / "log", ros2(states(2000)), compression=COMPRESSIONS[compression])
    at = path.read_bytes().index(compression.encode()) + len(compression) + 8
    data = bytearray(path.read_bytes())
    data[at : at + 4] = b"\0\0\0\0"
    path.write_bytes(data)
    with pytest.raises(LogError, match=rf"chunk at byte [0-9]+ that is damaged \({compression}\)"):
        read_log(path)


def test_damage_in_the_last_chunk_of_a_file_that_was_cut(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "whole", ros2(states(40)), chunk_size=1500)
    full, data = read_log(path), path.read_bytes()
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary
    last = summary.chunk_indexes[3].chunk_start_offset
    before = kept(tmp_path / "cut", data[:last], full)
    assert 0 < before == kept(tmp_path / "cut", data[: last + 53] + b"\0\1\2\3" * 8, full)


@pytest.mark.parametrize(
    ("field", "value"), [(28, 500), (36, 1 << 20)]
)  # lengths of the compression's name, and the data
def test_lengths_within_a_chunk(tmp_path: Path, field: int, value: int) -> None:
    path = write_mcap(tmp_path / "log", ros2(states(40)))
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary
    at = summary.chunk_indexes[0].chunk_start_offset + 9 + field
    data = path.read_bytes()
    path.write_bytes(data[:at] + value.to_bytes(4, "little") + data[at + 4 :])
    with pytest.raises(LogError, match="damaged near byte"):
        read_log(path)


def test_a_channel_that_cannot_be_read(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "log", ros2(states(40)), use_chunking=False)
    with pytest.raises(LogError, match="a schema or channel cannot be read"):
        read_log(damaged(path, b"/joint_states", b"\xff"))


def test_a_chunk_shorter_than_it_says(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "log", ros2(states(100)))
    size = path.stat().st_size
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary
    true = summary.chunk_indexes[0].uncompressed_size
    with pytest.raises(LogError, match="damaged near byte"):
        read_log(damaged(path, true.to_bytes(8, "little"), (true + 1).to_bytes(8, "little")))
    with pytest.raises(LogError, match="has a record of 1024 MiB at byte"):
        read_log(damaged(path, (true + 1).to_bytes(8, "little"), (1 << 30).to_bytes(8, "little")))
    assert path.stat().st_size == size


def test_expansion_is_bounded(tmp_path: Path) -> None:
    filler = Channel("/zeros", range(11), [bytes(1 << 25)] * 11, schema=("x", "ros2msg", b""))
    with pytest.raises(LogError, match="expands to more than 256 times its size"):
        read_log(write_mcap(tmp_path / "log", ros2(states(5)), filler))


def test_unknown_compression(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "log", ros2(states(5)))
    with pytest.raises(LogError, match="has the unsupported compression 'zst9'; use lz4, zstd or none"):
        read_log(damaged(path, b"zstd", b"zst9"))


def test_message_of_no_channel(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "log", ros2(states(5)), use_chunking=False)
    message = b"\5" + (len(ros2(states(5)).payloads[0]) + 22).to_bytes(8, "little")
    with pytest.raises(LogError, match="messages of channel 9, which is not defined"):
        read_log(damaged(path, message + b"\1\0", message + b"\t\0"))


def test_unknown_version(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "log", ros2([State(1, ("a",), (0.0,))]))
    with pytest.raises(LogError, match="unknown version"):
        read_log(damaged(path, b"MCAP0", b"MCAP1"))
