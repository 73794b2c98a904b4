"""rosbag2 folders: several files are one log."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import zstandard
from commands import idtool
from recordings import IMU, bag, check_log, metadata, ros2, states, write_mcap
from sentences import sentences

from idtool.common.exceptions import LogError
from idtool.data.logs import JointLog, make_log, read_log, write_log

ITEMS = states(300)
PARTS = ITEMS[:100], ITEMS[100:220], ITEMS[220:]


def test_a_folder_is_one_log(tmp_path: Path) -> None:
    folder = bag(tmp_path / "run", *PARTS)
    log, whole = read_log(folder), read_log(write_mcap(tmp_path / "whole.mcap", ros2(ITEMS)))
    check_log(log, ITEMS)
    assert (log.path, sentences(log.notices)) == (folder, ())
    assert log.segments == whole.segments == (slice(0, 300),)
    assert log.dt == whole.dt
    assert all(array.flags.owndata for array in (log.t, *log.signals.values()))


def test_the_samples_are_in_the_order_of_time(tmp_path: Path) -> None:
    log = read_log(bag(tmp_path / "run", *PARTS, listed=[2, 0, 1]))
    check_log(log, ITEMS)
    assert log.segments == (slice(0, 300),)


def test_time_lost_between_two_files_is_a_gap(tmp_path: Path) -> None:
    log = read_log(bag(tmp_path / "run", ITEMS[:100], ITEMS[110:]))
    assert log.segments == (slice(0, 100), slice(100, 290))


def test_a_folder_without_a_sample_in_some_files(tmp_path: Path) -> None:
    check_log(read_log(bag(tmp_path / "run", [], ITEMS[:200], [], ITEMS[200:], [])), ITEMS)


def test_a_log_with_commands_in_several_files(tmp_path: Path) -> None:
    whole = read_log(write_mcap(tmp_path / "whole", ros2(ITEMS)))
    signals = {**whole.signals, "qcmd": 2 * whole.signals["q"]}
    folder = tmp_path / "run"
    folder.mkdir()
    for i, rows in enumerate((slice(200, 300), slice(0, 200))):
        part = {name: array[rows] for name, array in signals.items()}
        write_log(folder / f"{i}.mcap", type(whole)(whole.path, whole.joints, whole.t[rows], part, (), whole.dt))
    (folder / "metadata.yaml").write_text(metadata(["0.mcap", "1.mcap"]))
    log = read_log(folder)
    assert log.signals.keys() == signals.keys()
    for name, array in signals.items():
        np.testing.assert_array_equal(log.signals[name], array)


def test_of_two_topics_the_one_that_is_wanted(tmp_path: Path) -> None:
    folder = bag(tmp_path / "run", *PARTS)
    other = states(50, ("wrist",))
    write_mcap(folder / "run_2.mcap", ros2(other, "/other"), ros2(PARTS[2]))
    with pytest.raises(
        LogError, match=r"run: 2 topics carry joint states; set log\.topic to one of /joint_states, /ot"
    ):
        read_log(folder)
    check_log(read_log(folder, topic="/joint_states"), ITEMS)
    check_log(read_log(folder, topic="/other"), other)


def test_old_and_poor_metadata(tmp_path: Path) -> None:
    check_log(read_log(bag(tmp_path / "a", *PARTS, relative_file_paths=[], storage_identifier="")), ITEMS)  # reindexed
    check_log(read_log(bag(tmp_path / "b", *PARTS, files="x")), ITEMS)
    names = [f"was/c_{i}.mcap" for i in range(3)]
    check_log(read_log(bag(tmp_path / "c", *PARTS, relative_file_paths=names)), ITEMS)
    (tmp_path / "a" / "within").symlink_to(tmp_path / "a" / "a_0.mcap")
    (tmp_path / "a" / "metadata.yaml").write_text(metadata(["within", "a_1.mcap"]))
    check_log(read_log(tmp_path / "a"), ITEMS[:220])


@pytest.mark.parametrize("where", [".", "../run"])
def test_the_folder_one_is_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str) -> None:
    monkeypatch.chdir(bag(tmp_path / "run", *PARTS))
    log = read_log(where)
    check_log(log, ITEMS)
    assert log.path.name == "run"


# --- what was cut off ---


def kept(log: JointLog, rows: slice = slice(None)) -> str:
    t = log.t[rows]
    return f"kept: {len(t)} samples, up to t = {t[-1]:.3f} s" if len(t) else "kept: no samples"


@pytest.mark.parametrize("part", [0.3, 0.6, 0.99])
def test_a_last_file_that_was_cut_off(tmp_path: Path, part: float) -> None:
    folder = bag(tmp_path / "run", *PARTS)
    last = folder / "run_2.mcap"
    last.write_bytes(last.read_bytes()[: int(part * last.stat().st_size)])
    log = read_log(folder)
    assert 220 < len(log) <= 300
    check_log(log, ITEMS[: len(log)])
    assert sentences(log.notices) == (f"run_2.mcap was cut off while it was written; {kept(log, slice(220, None))}",)
    done = idtool("inspect", folder, folder=tmp_path)
    assert (done.code, done.err) == (0, "")
    assert "run_2.mcap was cut off while it was written" in " ".join(done.out.split())


@pytest.mark.parametrize("left", [b"", b"\0" * 4096, b"\x89MCAP0\r\n"])
def test_a_last_file_of_which_nothing_is_left(tmp_path: Path, left: bytes) -> None:
    folder = bag(tmp_path / "run", *PARTS)
    (folder / "run_2.mcap").write_bytes(left)
    log = read_log(folder)
    check_log(log, ITEMS[:220])
    assert sentences(log.notices) == ("run_2.mcap was cut off while it was written; kept: no samples",)


@pytest.mark.parametrize("beyond", [0, 3, 9])
def test_zeros_from_the_end_of_a_record_on(tmp_path: Path, beyond: int) -> None:
    path = write_mcap(tmp_path / "log", channel := ros2(ITEMS[:40]), use_chunking=False)
    data = path.read_bytes()
    end = data.index(channel.payloads[20]) + len(channel.payloads[20])
    path.write_bytes(data[: end + beyond] + bytes(4096))
    log = read_log(path)
    check_log(log, ITEMS[:21])
    assert sentences(log.notices) == (f"the file was cut off while it was written; {kept(log)}",)


def test_a_file_in_between_that_was_cut_off(tmp_path: Path) -> None:
    folder = bag(tmp_path / "run", *PARTS)
    middle = folder / "run_1.mcap"
    middle.write_bytes(middle.read_bytes()[: middle.stat().st_size // 2])
    log = read_log(folder)
    assert 180 < len(log) < 300
    assert len(log.segments) == 2
    assert sentences(log.notices) == (
        f"run_1.mcap was cut off while it was written; {kept(log, slice(100, len(log) - 80))}",
    )


def test_several_files_that_were_cut_off_out_of_order(tmp_path: Path) -> None:
    """Each by itself, though the samples are put in the order of time, and though the topic begins in the second."""
    folder = bag(tmp_path / "run", *PARTS, listed=[1, 2, 0])
    write_mcap(folder / "run_1.mcap", IMU)
    for i in (0, 2):
        path = folder / f"run_{i}.mcap"
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    log = read_log(folder)
    (split,) = np.flatnonzero(np.diff(log.t) > 0.01) + 1
    assert sentences(log.notices)[:2] == (
        f"run_2.mcap was cut off while it was written; {kept(log, slice(split, None))}",
        f"run_0.mcap was cut off while it was written; {kept(log, slice(0, split))}",
    )


def test_a_folder_of_which_nothing_is_left(tmp_path: Path) -> None:
    folder = bag(tmp_path / "run", *PARTS)
    for path in folder.glob("*.mcap"):
        path.write_bytes(b"")
    with pytest.raises(LogError, match="run: was cut off before its first message"):
        read_log(folder)


# --- files that are compressed as a whole ---


def compressed(path: Path) -> Path:
    """The file as rosbag2 compresses it: in one frame, the name with another ending."""
    data = zstandard.ZstdCompressor().compress(path.read_bytes())
    path.unlink()
    path = path.with_name(f"{path.name}.zstd")
    path.write_bytes(data)
    return path


def test_a_compressed_bag(tmp_path: Path) -> None:
    folder = bag(tmp_path / "run", *PARTS)
    names = [compressed(path).name for path in sorted(folder.glob("*.mcap"))]
    text = metadata(names, compression_format="zstd", compression_mode="FILE")
    (folder / "metadata.yaml").write_text(text)
    check_log(read_log(folder), ITEMS)
    check_log(read_log(folder / names[1]), PARTS[1])
    last = folder / names[-1]
    last.write_bytes(last.read_bytes()[: last.stat().st_size // 2])
    log = read_log(folder)
    check_log(log, ITEMS[: len(log)])
    assert len(log) < 300
    assert sentences(log.notices) == (f"{names[-1]} was cut off while it was written; {kept(log, slice(220, None))}",)


def test_a_compressed_file_that_is_no_use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x"
    path.write_text("t,q_hip\n")
    path = compressed(path)
    with pytest.raises(LogError, match="is not an MCAP file"):
        read_log(path)
    path.write_bytes(path.read_bytes()[:4] + b"\xff" * 40)
    with pytest.raises(LogError, match="is damaged"):
        read_log(path)
    (tmp_path / "y").write_bytes(b"\x89MCAP0\r\n" + bytes(4 << 20))
    monkeypatch.setattr("idtool.data.logs.size_limits._FREE_BYTES", 1 << 20)
    with pytest.raises(LogError, match="expands to more than 256 times its size"):
        read_log(compressed(tmp_path / "y"))


# --- as a user meets them ---


def test_inspect_takes_a_folder(tmp_path: Path) -> None:
    bag(tmp_path / "run", *PARTS)
    done = idtool("inspect", "run", "--json", "--quiet", folder=tmp_path)
    assert done.code == 0
    assert (done.json["path"], done.json["samples"]) == ("run", 300)
    assert idtool("inspect", ".", folder=tmp_path / "run").code == 0


def test_a_folder_takes_no_more_memory_than_a_file(tmp_path: Path) -> None:
    count, files = 12_500, 4
    t, values = np.arange(count * files) / 1000, np.random.default_rng(0).normal(size=(count * files, 1))

    def write(path: Path, rows: slice) -> None:
        signals = dict.fromkeys(("q", "v", "tau"), values[rows])
        write_log(path, make_log(path, t[rows], ("hip",), signals))

    def peak(path: Path) -> int:
        tracemalloc.start()
        log = read_log(path)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        np.testing.assert_allclose(log.t, t, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(log.signals["tau"], values)
        assert len(log.segments) == 1
        return most

    write(tmp_path / "whole.mcap", slice(None))
    for i in range(files):
        write(tmp_path / f"{i}.mcap", slice(i * count, (i + 1) * count))
    whole = peak(tmp_path / "whole.mcap")
    for order in ([0, 1, 2, 3], [2, 0, 3, 1]):
        (tmp_path / "metadata.yaml").write_text(metadata([f"{i}.mcap" for i in order]))
        assert peak(tmp_path) < 1.05 * whole + (1 << 18)
