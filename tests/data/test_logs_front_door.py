"""Reading and writing through the front door: formats found by what they are, round trips, and errors in one line."""

from __future__ import annotations

import gzip
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from recordings import ros2, states, write_mcap
from sentences import sentences

from idtool.common.exceptions import LogError
from idtool.data.logs import SIGNALS, JointLog, make_log, read_log, write_log

Written = Callable[[str | bytes, str], Path]

ENDINGS = (".csv", ".mcap")


def a_log(
    count: int = 200, signals: tuple[str, ...] = SIGNALS, joints: tuple[str, ...] = ("hip", "a/b.c d")
) -> JointLog:
    rng = np.random.default_rng(count)
    t = 1.7e9 + np.arange(count) / 1000 + rng.uniform(0, 1e-4, count)
    return make_log(Path("log"), t, joints, {name: rng.normal(size=(count, len(joints))) for name in signals})


def same(log: JointLog, other: JointLog, late: float = 1e-9) -> None:
    assert log.joints == other.joints
    np.testing.assert_allclose(log.t, other.t, rtol=0, atol=late)
    assert log.signals.keys() == other.signals.keys()
    for name in other.signals:
        np.testing.assert_array_equal(log.signals[name], other.signals[name])
    assert log.segments == other.segments
    assert sentences(log.notices) == sentences(other.notices)


@pytest.mark.parametrize("ending", [*ENDINGS, ".CSV"])
@pytest.mark.parametrize("signals", [("q",), ("q", "v", "tau"), ("q", "qcmd"), ("q", "vcmd"), SIGNALS])
def test_round_trip(tmp_path: Path, ending: str, signals: tuple[str, ...]) -> None:
    log = a_log(5000, signals)
    path = tmp_path / f"log{ending}"
    write_log(path, log)
    same(read_log(path), log, 0.0)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("ending", ENDINGS)
@given(data=st.data())
def test_round_trip_of_any_numbers(tmp_path_factory: pytest.TempPathFactory, ending: str, data: st.DataObject) -> None:
    count = data.draw(st.integers(2, 6))
    numbers = hnp.arrays(np.float64, (count, 2), elements=st.floats(allow_nan=False, allow_infinity=False))
    steps = data.draw(st.lists(st.integers(1, 10**9), min_size=count, max_size=count))
    t = np.cumsum([data.draw(st.integers(-1000, 1000)) * 1e9, *steps])[1:] / 1e9
    if (np.diff(t) <= 0).any():
        return
    log = make_log(Path("log"), t, ("a", "b"), {name: data.draw(numbers) for name in ("q", "tau", "qcmd")})
    path = tmp_path_factory.mktemp("logs") / f"log{ending}"
    write_log(path, log)
    read = read_log(path)
    np.testing.assert_allclose(read.t, log.t, rtol=0, atol=1e-9)
    for name in log.signals:
        np.testing.assert_array_equal(read.signals[name], log.signals[name])


@pytest.mark.parametrize("ending", ENDINGS)
def test_round_trip_of_what_is_missing(tmp_path: Path, ending: str) -> None:
    log = a_log(50)
    log.signals["tau"][:, 1] = np.nan
    log.signals["v"][7, 0] = np.nan
    log = make_log(log.path, log.t, log.joints, log.signals)
    write_log(tmp_path / f"log{ending}", log)
    same(read_log(tmp_path / f"log{ending}"), log, 0.0)
    assert len(log.segments) == 2


def test_times_before_zero_and_at_it(tmp_path: Path) -> None:
    log = make_log(Path("log"), np.linspace(-0.75, 0.75, 7), ("hip",), {"q": np.arange(7.0)[:, None]})
    write_log(tmp_path / "log.mcap", log)
    same(read_log(tmp_path / "log.mcap"), log, 0.0)


def test_written_mcap_is_what_others_read(tmp_path: Path) -> None:
    log = a_log(30)
    write_log(tmp_path / "log.mcap", log)
    with (tmp_path / "log.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        decoded = [(c.topic, s.name, m) for s, c, _, m in reader.iter_decoded_messages() if s]
    assert {name for _, name, _ in decoded} == {"sensor_msgs/msg/JointState"}
    of = {topic: [m for at, _, m in decoded if at == topic] for topic in ("/joint_states", "/joint_commands")}
    for topic, names in {"/joint_states": ("q", "v", "tau"), "/joint_commands": ("qcmd", "vcmd")}.items():
        for name, field in zip(names, ("position", "velocity", "effort"), strict=False):
            np.testing.assert_array_equal([getattr(m, field) for m in of[topic]], log.signals[name])
        assert [m.header.stamp.sec + m.header.stamp.nanosec / 1e9 for m in of[topic]] == log.t.tolist()
    assert [m.effort for m in of["/joint_commands"]] == [[]] * 30


def test_commands_by_themselves(tmp_path: Path) -> None:
    log = a_log(30)
    write_log(tmp_path / "log.mcap", log)
    commands = read_log(tmp_path / "log.mcap", topic="/joint_commands")
    np.testing.assert_array_equal(commands.signals["q"], log.signals["qcmd"])
    same(read_log(tmp_path / "log.mcap", topic="/joint_states"), log, 0.0)


@pytest.mark.parametrize("part", [0.4, 0.41, 0.42, 0.43, 0.8, 0.99999])
def test_commands_in_a_file_that_was_cut(tmp_path: Path, part: float) -> None:
    log = a_log(6000)
    write_log(tmp_path / "log.mcap", log)
    data = (tmp_path / "log.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: int(part * len(data))])
    read = read_log(tmp_path / "cut.mcap")
    assert 0.3 * part < len(read) / len(log) <= 1
    np.testing.assert_array_equal(read.signals["q"], log.signals["q"][: len(read)])
    commands = read.signals["qcmd"][read.segments[0]]
    assert len(read.segments) == 1
    assert len(commands) >= len(read) - 1
    np.testing.assert_array_equal(commands, log.signals["qcmd"][: len(commands)])


def test_commands_of_other_times_are_left_out(tmp_path: Path) -> None:
    items = states(30)
    commands = replace(ros2(states(30, step=999_999), "/orders"), metadata={"idtool.commands_of": "/joint_states"})
    log = read_log(write_mcap(tmp_path / "log", commands, ros2(items)))
    assert list(log.signals) == ["q", "v", "tau"]
    assert sentences(log.notices) == (
        "the commands were ignored: their joints or times differ from those of the states",
    )
    same_times = replace(ros2(items, "/orders"), metadata={"idtool.commands_of": "/joint_states"})
    log = read_log(write_mcap(tmp_path / "log", same_times, ros2(items)))
    assert list(log.signals) == ["q", "v", "tau", "qcmd", "vcmd"]


def test_csv_header_is_canonical(tmp_path: Path) -> None:
    write_log(tmp_path / "log.csv", a_log(3, ("q", "v", "tau"), ("hip", "knee")))
    header = (tmp_path / "log.csv").read_text().splitlines()[0]
    assert header == "t,q_hip,v_hip,tau_hip,q_knee,v_knee,tau_knee"


def test_what_a_file_holds_tells_its_format(tmp_path: Path) -> None:
    log = a_log(20)
    for ending in ENDINGS:
        write_log(tmp_path / f"log{ending}", log)
        path = (tmp_path / f"log{ending}").rename(tmp_path / "log.bin")
        same(read_log(str(path)), log, 0.0)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("log.txt", "unsupported log format '.txt'; use .csv or .mcap"),
        ("log", "unsupported log format ''"),
        ("no/log.csv", "cannot be written: No such file or directory"),
        (".csv", "unsupported log format ''"),
    ],
)
def test_what_cannot_be_written(tmp_path: Path, name: str, said: str) -> None:
    with pytest.raises(LogError) as error:
        write_log(tmp_path / name, a_log(3))
    assert str(error.value).startswith(f"{tmp_path / name}: {said}")


@pytest.mark.parametrize("time", [np.nan, np.inf, 2.0**31])
def test_a_file_stays_when_writing_fails(tmp_path: Path, time: float) -> None:
    log = a_log(20)
    path = tmp_path / "log.mcap"
    path.write_bytes(b"before")
    log.t[-1] = time
    with pytest.raises(LogError, match="its times are too large for"):
        write_log(path, log)
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    "binary", [b"", b"\x89MCAP", b"\x89PNG\r\n\x1a\n", b"\0" * 5000, b"PK\3\4", "t,q_ü\n0,1\n".encode("latin1")]
)
def test_what_is_no_log(written: Written, binary: bytes) -> None:
    with pytest.raises(LogError, match=r"is empty|unknown version|is not a log in a supported format"):
        read_log(written(binary, "log.csv"))


def test_what_is_compressed_by_other_means(written: Written) -> None:
    with pytest.raises(LogError, match=r"log\.csv\.gz: is compressed with gzip; run 'gunzip -k .*log\.csv\.gz' first"):
        read_log(written(gzip.compress(b"t,q_hip\n0,1\n1,2\n"), "log.csv.gz"))


def test_columns_of_csv_are_of_no_use_to_mcap(tmp_path: Path) -> None:
    log = read_log(write_mcap(tmp_path / "log", ros2(states(20))), columns={"t": "stamp", "tau_hip": "current"})
    assert sentences(log.notices) == ("log.columns is only for CSV and was ignored: t, tau_hip",)


def test_what_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="is a folder"):
        read_log(tmp_path)
    with pytest.raises(LogError, match="there is no such file"):
        read_log(tmp_path / "log.csv")
    with pytest.raises(LogError, match="cannot be read: File name too long"):
        read_log(tmp_path / ("x" * 300))


@pytest.mark.parametrize("ending", ENDINGS)
def test_scale(tmp_path: Path, ending: str) -> None:
    log = a_log(20)
    write_log(tmp_path / f"log{ending}", log)
    read = read_log(tmp_path / f"log{ending}", scale={"tau": {"hip": 0.118}, "q": {"hip": -1, "a/b.c d": 2}})
    np.testing.assert_array_equal(read.signals["tau"], log.signals["tau"] * [0.118, 1])
    np.testing.assert_array_equal(read.signals["q"], log.signals["q"] * [-1, 2])
    np.testing.assert_array_equal(read.signals["v"], log.signals["v"])


@pytest.mark.parametrize(
    ("scale", "said"),
    [
        ({"tau": {"hipp": 2.0}}, "log.scale: tau: the log has no joint hipp; did you mean hip?"),
        ({"v": {"hip": 2.0}}, "log.scale: the log has no v; available: q, tau"),
    ],
)
def test_scale_of_what_is_not_there(tmp_path: Path, scale: Mapping[str, Mapping[str, float]], said: str) -> None:
    write_log(tmp_path / "log.csv", a_log(20, ("q", "tau")))
    with pytest.raises(LogError) as error:
        read_log(tmp_path / "log.csv", scale=scale)
    assert error.value.what == said


def test_arrays_are_float64_and_nothing_longer(tmp_path: Path) -> None:
    log = read_log(write_mcap(tmp_path / "log", ros2(states(5000))))
    for array in (log.t, *log.signals.values()):
        assert array.dtype == np.float64
        assert array.flags.owndata
        assert array.flags.c_contiguous
        assert array.nbytes == 8 * array.size


def test_import_is_cheap() -> None:
    code = (
        "import sys, idtool.data.logs; print([m for m in ('mcap', 'google.protobuf', 'zstandard') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out == "[]\n"
