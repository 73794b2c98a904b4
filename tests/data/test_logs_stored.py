"""Logs larger than memory: what is read through a temporary file is what is read in memory, to the last digit."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from ground.logs import write_mcap as write_ground_mcap
from quadruped_recordings import TRUTH, record_quadruped
from recordings import Proto, State, bag, json_channel, proto_channel, ros2, states, write_mcap
from sentences import sentences

from idtool.common.exceptions import LogError
from idtool.data.controller import with_unknown_torque, without_constant_torque
from idtool.data.inspection import inspect_log
from idtool.data.logs import JointLog, make_log, read_log, write_log
from idtool.data.logs import stored_arrays as stored
from idtool.data.logs.sensor_channels import SensorOptions, with_sensors
from idtool.data.same_recording import is_same_recording
from idtool.robot.config import Controller

Source = Callable[[Path], Path]

ITEMS = states(300)
SCALE = {"tau": {"hip": 0.3}, "q": {"knee": -2.0}}


@pytest.fixture
def in_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """No log has room in memory, and blocks are short."""
    monkeypatch.setattr(stored, "MAX_BYTES", 0)
    monkeypatch.setattr(stored, "BLOCK_ROWS", 7)


def read_both_ways(
    path: Path, sensors: SensorOptions | None = None, block_rows: int = 7, **options: object
) -> tuple[JointLog, JointLog]:
    """A log read in memory, and through a temporary file."""
    in_memory = read_log(path, sensors=sensors, **options)  # type: ignore[arg-type]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stored, "MAX_BYTES", 0)
        patch.setattr(stored, "BLOCK_ROWS", block_rows)
        in_file = read_log(path, sensors=sensors, **options)  # type: ignore[arg-type]
    assert not any(map(stored.is_in_file, in_memory.signals.values()))
    assert all(map(stored.is_in_file, in_file.signals.values()))
    return in_memory, in_file


def check_same(log: JointLog, expected: JointLog) -> None:
    """Equal in every field."""
    np.testing.assert_array_equal(log.t, expected.t)
    assert log.signals.keys() == expected.signals.keys()
    for name, array in expected.signals.items():
        np.testing.assert_array_equal(log.signals[name], array)
    assert log.channels.keys() == expected.channels.keys()
    for name, channel in expected.channels.items():
        np.testing.assert_array_equal(log.channels[name].t, channel.t)
        np.testing.assert_array_equal(log.channels[name].x, channel.x)
    for name in ("path", "joints", "segments", "dt", "notices", "sources", "unknown_torque", "preset"):
        assert getattr(log, name) == getattr(expected, name), name


def swinging_log(count: int = 500, joints: tuple[str, ...] = ("hip", "knee")) -> JointLog:
    """Two joints with a command and a missing value each; the torque of the first never changes."""
    t = np.arange(count) / 1000
    phase = 2 * np.pi * t[:, None] * np.arange(1, len(joints) + 1)
    signals = {"q": np.sin(phase), "v": np.cos(phase), "tau": np.sin(2 * phase), "qcmd": np.sin(phase + 0.1)}
    signals["tau"][:, 0] = 1.5
    signals["v"][count // 2] = np.nan
    return make_log(Path("log"), t, joints, signals)


def states_of_two_sources() -> list[State]:
    """An arm and a gripper that publish in turn."""
    arm = states(60)
    gripper = states(60, ("finger",), start=10**18 + 5 * 10**5)
    return [state for pair in zip(arm, gripper, strict=True) for state in pair]


def states_with_late_joints() -> list[State]:
    """Two joints, then a third, and at the end another signal of all of them."""
    items = states(120)
    for i, item in enumerate(items):
        if i < 50:
            item.names, item.position, item.velocity = item.names[:2], item.position[:2], item.velocity[:2]
        if i < 90:
            item.effort = ()
    return items


def cut(path: Path, part: float) -> Path:
    """The first part of a file."""
    data = path.read_bytes()
    path.write_bytes(data[: int(part * len(data))])
    return path


def written_log(ending: str) -> Source:
    def write(folder: Path) -> Path:
        write_log(folder / f"log{ending}", swinging_log())
        return folder / f"log{ending}"

    return write


SOURCES: dict[str, Source] = {
    "CDR": lambda folder: write_mcap(folder / "log", ros2(ITEMS)),
    "JSON": lambda folder: write_mcap(folder / "log", json_channel(ITEMS)),
    "protobuf": lambda folder: write_mcap(folder / "log", proto_channel(ITEMS, Proto())),
    "CSV with commands": written_log(".csv"),
    "MCAP with commands": written_log(".mcap"),
    "two topics": lambda folder: write_mcap(folder / "log", ros2(ITEMS), ros2(ITEMS, "/wrist")),
    "joints that appear late": lambda folder: write_mcap(folder / "log", ros2(states_with_late_joints())),
    "two sources in turn": lambda folder: write_mcap(folder / "log", ros2(states_of_two_sources())),
    "bag": lambda folder: bag(folder / "run", ITEMS[:100], ITEMS[100:220], ITEMS[220:]),
    "bag out of order": lambda folder: bag(
        folder / "run", ITEMS[:100], [], ITEMS[100:220], ITEMS[220:], listed=[2, 0, 3, 1]
    ),
    "times in ns": lambda folder: _csv_in_nanoseconds(folder),
    "cut off": lambda folder: cut(write_mcap(folder / "log", ros2(ITEMS), use_chunking=False), 0.6),
    "CSV cut off": lambda folder: cut(written_log(".csv")(folder), 0.6),
}


def _csv_in_nanoseconds(folder: Path) -> Path:
    rows = "".join(f"{10**18 + i * 10**6},{i / 7},{i / 9}\n" for i in range(50))
    (folder / "log.csv").write_text(f"t,q_hip,tau_hip\n{rows}")
    return folder / "log.csv"


@pytest.mark.parametrize("name", SOURCES)
def test_every_source_is_read_alike(name: str, tmp_path: Path) -> None:
    topic = "/joint_states" if name == "two topics" else None
    in_memory, in_file = read_both_ways(SOURCES[name](tmp_path), topic=topic)
    check_same(in_file, in_memory)


@pytest.mark.parametrize("part", [0.4, 0.42, 0.43, 0.8])
def test_commands_of_a_file_that_was_cut_off(tmp_path: Path, part: float) -> None:
    """The last batch may have fewer commands than states, or more."""
    t = np.arange(6000) / 1000
    log = make_log(Path("log"), t, ("hip",), {"q": np.sin(t)[:, None], "qcmd": np.cos(t)[:, None]})
    write_log(tmp_path / "log.mcap", log)
    in_memory, in_file = read_both_ways(cut(tmp_path / "log.mcap", part))
    check_same(in_file, in_memory)
    assert "qcmd" in in_file.signals


@pytest.mark.parametrize("ending", [".csv", ".mcap"])
def test_sensors_are_read_alike(tmp_path: Path, ending: str) -> None:
    """An IMU at half the rate of the joints, flags, wrenches, and one message of the rope's flag."""
    write_ground_mcap(tmp_path / "log.mcap", TRUTH, record_quadruped("hang", 0.3))
    if ending == ".csv":
        write_log(tmp_path / "log.csv", read_log(tmp_path / "log.mcap", sensors=SensorOptions()))
    in_memory, in_file = read_both_ways(tmp_path / f"log{ending}", SensorOptions(), block_rows=101)
    check_same(in_file, in_memory)
    assert all(stored.is_in_file(channel.x) for channel in in_file.channels.values())
    names = [name for name in in_memory.channels if name != "contact_rope"]
    check_same(with_sensors(in_file, names), with_sensors(in_memory, names))


@pytest.mark.parametrize("ending", [".csv", ".mcap"])
def test_scale_changes_what_is_in_the_file(tmp_path: Path, ending: str) -> None:
    write_log(tmp_path / f"log{ending}", swinging_log())
    in_memory, in_file = read_both_ways(tmp_path / f"log{ending}", scale=SCALE)
    check_same(in_file, in_memory)
    assert in_file.signals["tau"][9, 0] == 0.3 * 1.5


def test_torque_is_removed_from_a_copy(tmp_path: Path, in_files: None) -> None:
    write_log(tmp_path / "log.mcap", swinging_log())
    log = read_log(tmp_path / "log.mcap")
    changed = without_constant_torque(log, Controller(kp={"hip": 10.0, "knee": 10.0}, kd={}))
    assert stored.is_in_file(changed.signals["tau"])
    assert not changed.has("tau", "hip")
    np.testing.assert_array_equal(changed.signals["tau"][:, 1], log.signals["tau"][:, 1])
    assert (log.signals["tau"][:, 0] == 1.5).all()
    unknown = with_unknown_torque(log, None)
    assert unknown.unknown_torque == ("hip",)
    assert (unknown.signals["tau"][:, 0] == 0).all()


def test_inspection_finds_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_log(tmp_path / "log.mcap", swinging_log(4000))
    in_memory, in_file = read_both_ways(tmp_path / "log.mcap")
    expected = inspect_log(in_memory)
    assert inspect_log(in_file) == expected
    monkeypatch.setattr(stored, "BLOCK_ROWS", 333)
    in_short_blocks = inspect_log(in_file)
    assert sentences(in_short_blocks.findings) == sentences(expected.findings)
    for name, joint in expected.joints.items():
        for signal, figures in joint.signals.items():
            assert in_short_blocks.joints[name].signals[signal].rms == pytest.approx(figures.rms, rel=1e-12)
    assert in_short_blocks.stamps.jitter_rms_ms == pytest.approx(expected.stamps.jitter_rms_ms, rel=1e-9, abs=1e-12)


def test_same_recording_is_found(tmp_path: Path, in_files: None) -> None:
    log = swinging_log()
    write_log(tmp_path / "log.mcap", log)
    write_log(tmp_path / "log.csv", log)
    log.signals["q"][-1, 1] += 0.01
    write_log(tmp_path / "other.csv", log)
    first, same, other = (read_log(tmp_path / name) for name in ("log.mcap", "log.csv", "other.csv"))
    assert is_same_recording(first, same)
    assert not is_same_recording(first, other)


def test_bound_is_for_all_logs_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written_log(".mcap")(tmp_path)
    size = sum(array.nbytes for array in read_log(path).signals.values())
    stored.is_memory_full(0)  # forgets the logs of other tests that are gone
    others = sum(array.nbytes for reference in stored._counted.values() if (array := reference()) is not None)
    monkeypatch.setattr(stored, "MAX_BYTES", others + 5 * size)
    logs = [read_log(path) for _ in range(7)]
    are_in_file = [stored.is_in_file(log.signals["q"]) for log in logs]
    assert are_in_file == sorted(are_in_file)  # the first have room
    assert not are_in_file[0]
    assert are_in_file[-1]
    del logs
    assert not stored.is_in_file(read_log(path).signals["q"])


def test_changes_stay_when_pages_are_released(in_files: None) -> None:
    rows = stored.StoredRows(Path("log"), 3)
    rows.append(np.arange(3000.0).reshape(-1, 3))
    array = rows.array()
    array[:, 1] *= 2
    stored.release_pages([array[5:, 1], array.T])
    np.testing.assert_array_equal(array[:, 1], 2 * np.arange(1, 3000, 3))
    np.testing.assert_array_equal(stored.copy_array(Path("log"), array), array)
    np.testing.assert_array_equal(rows.columns(), array.T)
    stored.release_pages([np.zeros(3)])


def test_file_outlives_the_reader_and_has_no_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, in_files: None
) -> None:
    path = written_log(".mcap")(tmp_path)
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    log = read_log(path)
    assert not list(folder.iterdir())
    expected = swinging_log()
    np.testing.assert_array_equal(log.signals["q"], expected.signals["q"])


LIMITED = """
import resource, sys
from idtool.data.logs import stored_arrays
stored_arrays.MAX_BYTES = 1 << 16
resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, 1 << 20))
from idtool.__main__ import main
sys.argv = ["idtool", "inspect", sys.argv[1]]
main()
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits the size of files")
def test_full_temporary_folder_gives_one_line(tmp_path: Path) -> None:
    t = np.arange(2000) / 1000
    q = np.sin(t[:, None] + np.arange(40))
    names = tuple(f"j{i}" for i in range(40))
    write_log(tmp_path / "log.mcap", make_log(Path("log"), t, names, {"q": q, "v": q, "tau": q}))
    command = [sys.executable, "-c", LIMITED, str(tmp_path / "log.mcap")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith(f"error: {tmp_path / 'log.mcap'}: needs more than 1 MiB in the temporary folder ")
    assert line.endswith("; set TMPDIR to a folder with more space")
    assert not done.stdout


def test_no_temporary_folder_gives_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, in_files: None) -> None:
    path = written_log(".csv")(tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    with pytest.raises(LogError, match=r"log\.csv: needs more than 0 MiB in a temporary folder \(No such file"):
        read_log(path)


RESIDENT = """
import re, sys
from pathlib import Path
from idtool.data import channels, inspection
from idtool.data.inspection import frozen, inspect_log, jumps
from idtool.data.logs import read_log, stored_arrays
from idtool.data.signals import Signals
from idtool.estimation.dataset.experiment import _check_signals, position_ranges
from idtool.robot.config import Config

stored_arrays.MAX_BYTES = int(sys.argv[1])
# so that a short log is enough
inspection._MAX_SAMPLES = channels.MAX_ANALYZED_SAMPLES = frozen._BLOCK = jumps._BLOCK = 1 << 13
stored_arrays.BLOCK_ROWS = 1 << 12

def resident(name):
    return 1024 * int(re.findall(rf"{name}:\\s+(\\d+)", Path("/proc/self/status").read_text())[0])

def work(path):
    log = read_log(path, scale={"tau": {"j0": 2.0}})
    inspect_log(log)
    _check_signals(log, log.joints)
    position_ranges(log, log.joints)
    signals = Signals(log, log.joints, Config())
    total = sum(float(batch.motion.tau.sum()) for batch in signals.batches())
    return log, total

log, total = work(sys.argv[2])
print(resident("VmHWM"), sum(x.nbytes for x in log.signals.values()), repr(total))
"""


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_resident_memory_is_bounded(tmp_path: Path) -> None:
    """The whole way from the file to the batches takes hardly more for more samples, which it does in memory."""
    rng = np.random.default_rng(0)
    names = tuple(f"j{i}" for i in range(40))
    for file, count in (("short.mcap", 30_000), ("long.mcap", 80_000)):
        t = np.arange(count) / 1000
        phase = t[:, None] * rng.uniform(1, 5, len(names))
        signals = {"q": np.sin(phase), "v": np.cos(phase), "tau": np.sin(phase + 1)}
        write_log(tmp_path / file, make_log(Path("log"), t, names, signals))
    growth = {}
    totals = {}
    for bound in (1 << 20, 1 << 40):
        figures = []
        for file in ("short.mcap", "long.mcap"):
            command = [sys.executable, "-c", RESIDENT, str(bound), tmp_path / file]
            output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
            peak, size, totals[bound] = output.split()
            figures.append((int(peak), int(size)))
        (short_peak, short_size), (long_peak, long_size) = figures
        growth[bound] = (long_peak - short_peak) / (long_size - short_size)
    assert totals[1 << 20] == totals[1 << 40]
    assert growth[1 << 20] < 0.2  # bytes of memory per byte of samples, of which times and masks are in memory
    assert growth[1 << 40] > 0.8
