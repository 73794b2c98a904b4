"""CSV logs: every spelling of a column, every way of writing numbers, and everything that is wrong with a table."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from sentences import sentences

from idtool.common.exceptions import LogError
from idtool.data.logs import JointLog, read_log

Written = Callable[[str | bytes, str], Path]

ROWS = "0,1,2,3\n0.1,1.5,2.5,3.5\n0.2,-1,-2,-3e-5\n"
T, Q, V, TAU = np.loadtxt(ROWS.split(), delimiter=",").T


def check(log: JointLog, joints: tuple[str, ...] = ("hip",)) -> None:
    assert log.joints == joints
    np.testing.assert_array_equal(log.t, T)
    for signal, values in (("q", Q), ("v", V), ("tau", TAU)):
        np.testing.assert_array_equal(log.signals[signal][:, 0], values)


@pytest.mark.parametrize(
    "header",
    [
        "t,q_hip,v_hip,tau_hip",
        "time,hip.position,hip.velocity,hip.effort",
        "__time,hip/position,hip/velocity,hip/effort",
        "timestamp,/joint_states/hip/position,/joint_states/hip/velocity,/joint_states/hip/effort",
        "t,/go2/joint_states/hip/position,/go2/joint_states/hip/velocity,/go2/joint_states/hip/effort",
        "t,joint_states/hip/position,joint_states/hip/velocity,joint_states/hip/effort",
        "t,/joint_states/hip.position,/joint_states/hip.velocity,/joint_states/hip.effort",
        '"t","q_hip","v_hip","tau_hip"',
        " t , q_hip , v_hip , tau_hip ",
        't, "q_hip", v_hip, tau_hip',
        "t,q_hip,hip.velocity,/x/hip/effort",
    ],
)
def test_every_spelling(written: Written, header: str) -> None:
    log = read_log(written(f"{header}\n{ROWS}", "log.csv"))
    check(log)
    assert sentences(log.notices) == ()


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace(",", ";"),
        lambda text: text.replace(",", "\t"),
        lambda text: text.replace("\n", "\r\n"),
        lambda text: "\ufeff" + text,
        lambda text: "\n\r\n" + text,
        lambda text: text + "\n\n\r\n",
        lambda text: text.replace("2.5", '"2.5"'),
        lambda text: text.replace(",", " , "),
        lambda text: text.replace("\n", ",\n"),
        lambda text: text.replace("0,1,2,3\n", "0,1,2,3\n\n"),
    ],
)
def test_every_way_to_write(written: Written, change: Callable[[str], str]) -> None:
    log = read_log(written(change("t,q_hip,v_hip,tau_hip\n" + ROWS), "log.csv"))
    check(log)
    assert sentences(log.notices) == ()


def test_columns_in_any_order_and_others_ignored(written: Written) -> None:
    header = "note,tau_hip,temp,t,v_hip,q_hip"
    rows = [f'"a, b ""{i}""",{TAU[i]},,{T[i]},{V[i]},{Q[i]}' for i in range(3)]
    log = read_log(written("\n".join([header, *rows, ""]), "log.csv"))
    check(log)
    assert sentences(log.notices) == ("columns without a joint signal were ignored: note, temp",)


def test_commands_and_joints_that_lack_signals(written: Written) -> None:
    log = read_log(written("t,qcmd_hip,q_hip,vcmd_knee,q_knee\n0,1,2,3,4\n1,5,6,7,8\n", "log.csv"))
    assert log.joints == ("hip", "knee")
    assert {name: array[0].tolist() for name, array in log.signals.items() if name == "q"} == {"q": [2, 4]}
    np.testing.assert_array_equal(log.signals["qcmd"], [[1, np.nan], [5, np.nan]])
    np.testing.assert_array_equal(log.signals["vcmd"], [[np.nan, 3], [np.nan, 7]])
    assert log.segments == (slice(0, 2),)
    assert not log.has("v", "hip")
    assert log.has("qcmd", "hip")
    assert not log.has("qcmd", "knee")


@pytest.mark.parametrize(
    ("header", "joints"),
    [
        ("t,q_a.b,q_a/c,q_d_e", ("a.b", "a/c", "d_e")),
        ("t,left/hip.position,left/knee/position,left/toe/position", ("hip", "knee", "toe")),
        ("t,left/hip/position,right/hip/position,tail.position", ("left/hip", "right/hip", "tail")),
        ("t,/x/left.hip/position,/x/right.hip/position,/y/z/tail/position", ("left.hip", "right.hip", "tail")),
    ],
)
def test_names_with_dots_and_slashes(written: Written, header: str, joints: tuple[str, ...]) -> None:
    assert read_log(written(f"{header}\n{ROWS}", "log.csv")).joints == joints


def test_topic_chooses_among_prefixes(written: Written) -> None:
    header = "t,/states/left/hip/position,/commands/left/hip/position,/states/left/hip/effort"
    path = written(f"{header}\n{ROWS}", "log.csv")
    with pytest.raises(LogError, match=r"are of different topics; set log\.topic"):
        read_log(path)
    for topic in ("/states", "states/"):
        log = read_log(path, topic=topic)
        assert log.joints == ("left/hip",)
        np.testing.assert_array_equal(log.signals["q"][:, 0], Q)
        np.testing.assert_array_equal(log.signals["tau"][:, 0], TAU)
    assert read_log(path, topic="/states/left").joints == ("hip",)
    with pytest.raises(LogError, match="has no columns of topic /state; did you mean /states/left"):
        read_log(path, topic="/state")
    mapped = read_log(path, topic="/states", columns={"qcmd_left/hip": "/commands/left/hip/position"})
    np.testing.assert_array_equal(mapped.signals["qcmd"][:, 0], V)


def test_topic_is_no_matter_without_prefixes(written: Written) -> None:
    check(read_log(written("t,q_hip,v_hip,tau_hip\n" + ROWS, "log.csv"), topic="/joint_states"))


def test_named_columns(written: Written) -> None:
    columns = {"t": "Zeit", "q_hip": "angle", "v_hip": "speed", "tau_hip": "q_hip"}
    path = written("Zeit,angle,speed,q_hip\n" + ROWS, "log.csv")
    check(read_log(path, columns=columns))
    only = read_log(path, columns={"t": "Zeit", "q_hip": "angle"})
    assert list(only.signals) == ["q"]
    assert sentences(only.notices) == ("columns without a joint signal were ignored: speed, q_hip",)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"q_hip": "angl"}, "has no column angl; did you mean angle?"),
        ({"angle_hip": "angle"}, "log.columns: angle_hip is not a canonical name; use t or <signal>_<joint>"),
        ({"position_hip": "angle"}, "log.columns: position_hip is not a canonical name; did you mean q_hip?"),
        ({"taus_hip": "angle"}, "log.columns: taus_hip is not a canonical name; did you mean tau_hip?"),
        ({"tt": "angle"}, "log.columns: tt is not a canonical name; did you mean t?"),
        ({"q_hip": "twice"}, "has 2 columns twice"),
    ],
)
def test_named_columns_that_are_not_there(written: Written, columns: dict[str, str], said: str) -> None:
    with pytest.raises(LogError) as error:
        read_log(written("t,angle,twice,twice\n" + ROWS, "log.csv"), columns=columns)
    assert error.value.what.startswith(said)


def test_empty_cells_are_missing(written: Written) -> None:
    text = "v_hip,t,q_hip,q_knee\n,0,1,2\n,1,3,\n,2,,4\n,3,5,6\n,4,7,8\n"
    log = read_log(written(text, "log.csv"))
    np.testing.assert_array_equal(log.signals["q"], [[1, 2], [3, np.nan], [np.nan, 4], [5, 6], [7, 8]])
    assert list(log.signals) == ["q"]
    assert log.segments == (slice(3, 5),)


@pytest.mark.parametrize(
    ("no", "yes"), [("false", "true"), ("False", "True"), ("FALSE", "TRUE"), ('"False"', '"True"')]
)
def test_flags_in_words(written: Written, no: str, yes: str) -> None:
    rows = f"0,1,2,3,{no},0\n0.1,1.5,2.5,3.5,,{no}\n0.2,-1,-2,-3e-5,1,{yes}\n"
    log = read_log(written(f"t,q_hip,v_hip,tau_hip,contact_left,contact_right\n{rows}", "log.csv"))
    check(log)
    np.testing.assert_array_equal(log.channels["contact_left"].x, [0, np.nan, 1])
    np.testing.assert_array_equal(log.channels["contact_right"].x, [0, 0, 1])


@pytest.mark.parametrize(("q", "flag", "named"), [("True", "True", "q_hip: 'True'"), ("1", "maybe", "left: 'maybe'")])
def test_words_that_are_no_numbers(written: Written, q: str, flag: str, named: str) -> None:
    with pytest.raises(LogError, match=f"line 2, column .*{named} is not a number"):
        read_log(written(f"t,q_hip,contact_left\n0,{q},{flag}\n0.1,1,True\n", "log.csv"))


@pytest.mark.parametrize(("last", "codes"), [("True", []), ("False", []), ("Fals", ["log_truncated"])])
def test_last_word_without_a_line_end(written: Written, last: str, codes: list[str]) -> None:
    log = read_log(written(f"t,q_hip,contact_left\n0,1,False\n0.1,1,False\n0.2,1,{last}", "log.csv"))
    assert [notice.code for notice in log.notices] == codes
    assert len(log) == 3 - len(codes)


def test_rows_of_other_topics_are_passed_over(written: Written) -> None:
    text = "__time,/joint_states/hip/position,/imu/x\n0,1,\n0.05,,7\n0.1,2,\n0.15,,8\n0.2,3,\n"
    log = read_log(written(text, "log.csv"))
    assert log.t.tolist() == [0, 0.1, 0.2]
    assert log.segments == (slice(0, 3),)
    assert sentences(log.notices)[1:] == ("2 rows without a joint signal were skipped",)


def test_rows_of_two_topics_that_take_turns(written: Written) -> None:
    rows = "".join(f"{i},{i},,\n{i}.5,,{i},{i}\n" for i in range(10))
    log = read_log(written("t,/a/hip/effort,/b/hip/position,/b/hip/velocity\n" + rows, "log.csv"))
    assert list(log.signals) == ["q", "v"]
    assert log.t.tolist() == [i + 0.5 for i in range(10)]
    assert sentences(log.notices)[0].endswith("kept: 10 samples of hip; ignored: 10 samples, tau_hip")


@pytest.mark.parametrize(
    ("start", "step", "unit"),
    [
        (1_600_000_000_000_000_000, 1_000_000, "ns"),
        (0, 1_000_000, "ns"),
        (1_600_000_000_000_000, 1000, "us"),
        (0, 1000, "us"),
        (1_600_000_000_000, 1, "ms"),
    ],
)
def test_other_units_of_time(written: Written, start: int, step: int, unit: str) -> None:
    per_second = {"ns": 10**9, "us": 10**6, "ms": 10**3}[unit]
    rows = "".join(f"{start + i * step},{i}\n" for i in range(50))
    log = read_log(written("t,q_hip\n" + rows, "log.csv"))
    assert log.t.tolist() == [float(start + i * step) / per_second for i in range(50)]
    assert sentences(log.notices) == (f"its times are in {unit}; they were converted to seconds",)
    assert len(log.segments) == 1


@pytest.mark.parametrize("start", [0.0, 1.6e9, -5.0])
def test_seconds_stay(written: Written, start: float) -> None:
    rows = "".join(f"{start + i!r},{i}\n" for i in range(50))
    log = read_log(written("t,q_hip\n" + rows, "log.csv"))
    assert log.t.tolist() == [start + i for i in range(50)]
    assert sentences(log.notices) == ("samples are 1 s apart; the times seem to be in ms",)


def test_many_pieces(written: Written, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
    monkeypatch.setattr("idtool.data.logs.table._BLOCK_BYTES", 1000)
    values = rng.normal(size=(500, 4)) * 10.0 ** rng.integers(-9, 9, size=(500, 4))
    values[:, 0] = np.arange(500)
    text = "t,q_a,q_b,v_b\n" + "".join(",".join(map(repr, row)) + "\n" for row in values.tolist())
    log = read_log(written(text, "log.csv"))
    np.testing.assert_array_equal(np.column_stack([log.t, log.signals["q"], log.signals["v"][:, 1]]), values)
    with pytest.raises(LogError, match="line 402, column q_b: 'x' is not a number"):
        read_log(written(text.replace(repr(values[400, 2].item()), "x"), "log.csv"))


def test_cut_off_in_the_last_line(written: Written, rng: np.random.Generator) -> None:
    values = rng.uniform(0.1, 9, size=(40, 3))
    values[:, 0] = np.arange(40) / 100
    text = "t,q_a,q_b\n" + "".join(",".join(f"{value:.6f}" for value in row) + "\n" for row in values)
    last = text.rstrip().rindex("\n") + 1
    for size in range(last, len(text) + 1):
        log = read_log(written(text[:size], "log.csv"))
        whole = size >= len(text) - 1
        assert len(log) == (40 if whole else 39)
        np.testing.assert_allclose(log.signals["q"], values[: len(log), 1:], atol=6e-7)
        cut = (
            ()
            if whole or size == last
            else ("the file was cut off while it was written; kept: 39 samples, up to t = 0.380 s",)
        )
        assert sentences(log.notices) == cut


def test_no_line_end_is_no_cut(written: Written) -> None:
    log = read_log(written("t,q_hip\n0,1\n.1,22\n.2,3", "log.csv"))
    assert log.signals["q"][:, 0].tolist() == [1, 22, 3]
    assert sentences(log.notices) == ()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "t,q.abad,v.abad\n0,1,2\n",
            "is not a log: its first line has no joint signal (columns: t, q.abad, v.abad); name the",
        ),
        ("t,q_hip\n", "has no samples after the header line; check the logger, or give another log"),
        ("t,q_hip", "has no samples after the header line"),
        ("t,q_hip\n1,2\n", "has 1 sample; at least two are needed"),
        ("\n\n", "is not a log: its first line has no joint signal (columns: none)"),
        ("Lorem ipsum\ndolor\n", "is not a log: its first line has no joint signal (columns: Lorem ipsum)"),
        ("0,1\n1,2\n", "is not a log: its first line has no joint signal (columns: 0, 1)"),
        ("t,q_hip" + "x" * 140_000 + "\n0,1\n", "line 1 cannot be read as column names in UTF-8"),
        ("t,q_hip\n0,1\n1," + "x" * 140_000 + "\n", "line 3: field larger than field limit"),
        ("t,angle\n0,1\n", "is not a log: its first line has no joint signal (columns: t, angle)"),
        ("q_hip\n1\n", "has no time column; name it t, or set log.columns: {t: <its name>}"),
        ("t,v_hip\n0,1\n1,2\n", "no joint positions found"),
        ("t,q_hip,q_hip\n0,1,2\n", "has two columns q_hip; rename or remove one"),
        ("t,t,q_hip\n0,1,2\n", "has 2 columns t; rename all but one"),
        ("t,q_hip,hip.position\n0,1,2\n", "columns q_hip and hip.position both match q_hip; set log.columns"),
        ("t,q_hip\n0,1\n1\n2,3\n", "line 3 has 1 cells; the first line has 2"),
        ("t,q_hip\n0,1\n1,2,3\n2,3\n", "line 3 has 3 cells; the first line has 2"),
        ("t,x,q_hip\n0,1,1\n1,2\n2,2,3\n", "line 3 has 2 cells; the first line has 3"),
        ("t,q_hip,x\n0,1,1\n1,2,3,4\n", "line 3 has 4 cells; the first line has 3"),
        ('t,q_hip,x\n0,1,"1"\n1,2,3,4\n', "line 3 has 4 cells; the first line has 3"),
        ("t,q_hip\n0,1\n1,abc\n", "line 3, column q_hip: 'abc' is not a number"),
        ("t;q_hip\n0;1\n1;1,5\n", "line 3, column q_hip: '1,5' is not a number"),
        ("t,q_hip\n0,1\n1, \n", "line 3, column q_hip: ' ' is not a number"),
        ("t,q_hip\n0,1\n1,1_0\n", "line 3, column q_hip: '1_0' is not a number"),
        ("t,q_hip\n0,1\n\n\n1,é\n", "line 5, column q_hip: 'é' is not a number"),
        ("t,q_hip\n0,1\n0,2\n0,3\n", "time does not advance"),
        ("t,q_hip\n0,1\n1,inf\n2,3\n", "no two consecutive samples are complete"),
        ('t,q_hip\n0,"1\n1,2\n', "line "),
    ],
)
def test_tables_that_cannot_be_read(written: Written, text: str, said: str) -> None:
    path = written(text, "log.csv")
    with pytest.raises(LogError) as error:
        read_log(path)
    assert str(error.value).startswith(f"{path}: {said}")
    assert "\n" not in str(error.value)


def test_an_infinite_time_is_left_out_without_a_numpy_warning(written: Written) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        log = read_log(written("t,q_hip\n0.5,1\ninf,1\n1.5,2\n2.5,3\n", "log.csv"))
    assert [notice.code for notice in log.notices] == ["not_finite", "wrong_unit"]


def test_lines_without_end(written: Written, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("idtool.data.logs.table._MAX_LINE", 1000)
    monkeypatch.setattr("idtool.data.logs.table._BLOCK_BYTES", 700)
    for text in ("t,q_hip," + "x" * 2000, "t,q_hip\n0,1\n" + "1" * 3000):
        with pytest.raises(LogError, match="longer than"):
            read_log(written(text, "log.csv"))
