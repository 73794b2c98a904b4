"""What a stranger's log may take: memory is bounded by the size of the file, whatever it says it holds."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType
from recordings import UNINDEXED, Channel, Proto, bag, check_log, metadata, proto_channel, ros2, states, write_mcap

from idtool.common.exceptions import LogError
from idtool.common.safe_yaml import parse_yaml
from idtool.data.logs import read_log
from idtool.data.logs.bag import log_files
from idtool.data.logs.payloads.cdr import encode
from idtool.data.logs.sample_buffer import SampleBuffer, Samples

JOINTS = tuple(f"joint{i:03d}" for i in range(512))
ZEROS = Channel("/zeros", range(40), [bytes(1 << 20)] * 40, schema=("x", "ros2msg", b""))


# --- joints, each of which takes room in every sample ---


def one_by_one(count: int) -> Channel:
    """Messages that hold a joint each, in turn."""
    one = np.zeros((1, 1))
    messages = [encode(np.zeros(1, int), (name,), {"q": one, "v": one, "tau": one})[0].tobytes() for name in JOINTS]
    return Channel("/joint_states", range(count), [messages[i % len(JOINTS)] for i in range(count)])


def test_many_joints_one_at_a_time_are_refused(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "log", one_by_one(20_000))
    tracemalloc.start()
    with pytest.raises(LogError, match="names 512 joints, but each message has only a few; is this a log of one robot"):
        read_log(path)
    assert tracemalloc.get_traced_memory()[1] < 300 << 20  # 20 000 samples of 512 joints would take 250 MB and more
    tracemalloc.stop()


def test_robots_that_publish_their_joints_in_parts_are_not(tmp_path: Path) -> None:
    """Thirty joints, an arm's or a hand's in each message."""
    items = states(3000)
    for i, item in enumerate(items):
        item.names = [f"{i % 10}_{name}" for name in item.names]
    log = read_log(write_mcap(tmp_path / "log", ros2(items)))
    assert len(log.joints) == 3


def test_new_joints_are_admitted_together(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Arrays are made wider once for all pieces, not once for each."""
    widened, pad = [], np.pad
    monkeypatch.setattr("idtool.data.logs.sample_buffer.np.pad", lambda *a, **k: widened.append(a) or pad(*a, **k))
    series, values = SampleBuffer(tmp_path), np.ones((1, 1))
    for names in (JOINTS[:100], JOINTS[100:200]):
        series.append([Samples(np.array([i]), np.array([0.0]), (name,), {"q": values}) for i, name in enumerate(names)])
    assert len(widened) == 1
    q = series.arrays()[2]["q"]
    assert q.shape == (200, 200)
    np.testing.assert_array_equal(np.isfinite(q), np.eye(200, dtype=bool))


# --- compression ---


def padded(path: Path, size: int) -> bytes:
    """The file with a record of zeros in front, of a kind that is passed over."""
    data = path.read_bytes()
    return data[:8] + b"\x90" + size.to_bytes(8, "little") + bytes(size) + data[8:]


def test_compression_within_compression_does_not_multiply(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """40 MiB in 1 MiB that is in less than a KiB or two: each by itself is not out of bounds."""
    monkeypatch.setattr("idtool.data.logs.mcap_records._MAX_BYTES", 2 << 20)
    monkeypatch.setattr("idtool.data.logs.size_limits._FREE_BYTES", 2 << 20)
    path = write_mcap(
        tmp_path / "log", ros2(states(5)), ZEROS, compression=CompressionType.ZSTD, chunk_size=1 << 20, **UNINDEXED
    )
    path.write_bytes(padded(path, 1 << 20))
    check_log(read_log(path), states(5))
    packed = tmp_path / "log.zstd"
    packed.write_bytes(zstandard.ZstdCompressor().compress(path.read_bytes()))
    assert packed.stat().st_size < 1 << 14
    with pytest.raises(LogError, match="expands to more than 256 times its size"):
        read_log(packed)


# --- schemas and channels, which are kept ---


def test_definitions_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("idtool.data.logs.definitions._MAX_BYTES", 1 << 16)
    others = [Channel(f"/{i}", [1], [b"x"], schema=(f"s{i}", "ros2msg", bytes(7000))) for i in range(8)]
    check_log(read_log(write_mcap(tmp_path / "log", ros2(states(5)), *others)), states(5))
    others = [Channel(f"/{i}", [1], [b"x"], schema=(f"s{i}", "ros2msg", bytes(7000))) for i in range(10)]
    with pytest.raises(LogError, match="MiB of schemas and channels; it is not a robot log"):
        read_log(write_mcap(tmp_path / "log", ros2(states(5)), *others))
    many = [Channel("/" + "x" * 5000 + str(i), [1], [b"x"], schema=("s", "", b"")) for i in range(14)]
    with pytest.raises(LogError, match="MiB of schemas and channels; it is not a robot log"):
        read_log(write_mcap(tmp_path / "log", ros2(states(5)), *many))


def test_definitions_that_are_repeated_count_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As some writers do in every chunk."""
    monkeypatch.setattr("idtool.data.logs.definitions._MAX_BYTES", 1 << 16)
    channel = Channel("/x", [1], [b"x"], schema=("s", "ros2msg", bytes(7000)))
    path = write_mcap(tmp_path / "log", channel, ros2(states(5)), use_chunking=False, **UNINDEXED)
    data = path.read_bytes()
    end = data.index(b"\x05" + (22 + 1).to_bytes(8, "little"))  # of the definitions
    begin = data.index(b"\x03")
    path.write_bytes(data[:end] + 20 * data[begin:end] + data[end:])
    check_log(read_log(path), states(5))


def test_a_schema_is_looked_at_once_however_many_channels_have_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = []
    from idtool.data.logs import topics

    original = topics.decoder_for
    monkeypatch.setattr(topics, "decoder_for", lambda *given: made.append(given) or original(*given))
    channel = proto_channel(states(5), Proto())
    path = write_mcap(tmp_path / "log", channel, use_chunking=False, **UNINDEXED)
    data = path.read_bytes()
    at = data.rindex(b"\x04", 0, data.index(b"/joint_states"))
    length = 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    record = data[at : at + length]
    others = b"".join(record[:9] + i.to_bytes(2, "little") + record[11:] for i in range(100, 150))
    path.write_bytes(data[: at + length] + others + data[at + length :])
    check_log(read_log(path), states(5))
    assert len(made) == 1


# --- a bag's metadata ---


def test_metadata_take_room_in_proportion(tmp_path: Path) -> None:
    folder = bag(tmp_path / "run", states(5))
    text = metadata(["run_0.mcap"]) + f"x: [{'a,' * (1 << 14)}]\n"
    (folder / "metadata.yaml").write_text(text)
    tracemalloc.start()
    log_files(folder)
    assert tracemalloc.get_traced_memory()[1] < 400 * len(text)
    tracemalloc.stop()


def test_metadata_are_parsed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parsed, original = [], parse_yaml
    monkeypatch.setattr("idtool.data.logs.bag.parse_yaml", lambda *a, **k: parsed.append(a) or original(*a, **k))
    folder = bag(tmp_path / "run_of_its_own", states(5))
    for _ in range(2):
        check_log(read_log(folder), states(5))
    assert len(parsed) == 1
    (folder / "metadata.yaml").write_text(metadata(["run_of_its_own_7.mcap"]))
    with pytest.raises(LogError, match="which is not in the folder"):
        read_log(folder)
