"""`idtool fit` on how far to trust a fit, as a user sees it: report.json, the terminal, --quick, --method, errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from commands import (
    JOINTS,
    LEG,
    SAMPLES,
    TRAIN,
    Row,
    column_set,
    columns_kept,
    config_with,
    csv_text,
    fitted,
    idtool,
    refuse,
    sample_table,
    strict_json,
)

CONFIG = SAMPLES / "leg.yaml"
ASKED = ("base_parameters", "bias", "repeatability")
GROUNDS = {"data", "combination", "constraints", "prior"}
STIFF = 150.0  # N·m/rad
_TRUTH = yaml.safe_load((SAMPLES / "truth.yaml").read_text())["leg"]["bodies"]
KNEE_ROTOR = _TRUTH["knee_rotor"]["inertia"][2] * 10.604**2  # kg·m²


def cut(folder: Path, name: str, first: int, last: int) -> Path:
    """Some samples of the sample log."""
    names, *samples = sample_table(last)
    path = folder / name
    path.write_text(csv_text([names, *samples[first:]]))
    return path


def asked(folder: Path, *arguments: object) -> dict[str, Any]:
    """The report of a fit that asks everything but the simulation."""
    done = idtool("fit", LEG, *arguments, "--out", folder, "--quiet", "--json", "--no-simulation")
    assert (done.code, done.err) == (0, "")
    assert done.json == strict_json((folder / "report.json").read_text())
    return done.json


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("trust")


@pytest.fixture(scope="module")
def logs(folder: Path) -> tuple[Path, Path]:
    """Two parts of one log, of different length."""
    return cut(folder, "run1.csv", 0, 3000), cut(folder, "run2.csv", 3000, 7000)


@pytest.fixture(scope="module")
def report(folder: Path, logs: tuple[Path, Path]) -> dict[str, Any]:
    return asked(folder / "out", *logs, "--config", CONFIG)


def test_bodies_say_what_each_number_rests_on(report: dict[str, Any]) -> None:
    for name, body in report["bodies"].items():
        assert len(body["interval"]) == len(body["rests_on"]) == 10
        for value, ends, sees, basis in zip(
            body["pi"], body["interval"], body["identifiable"], body["rests_on"], strict=True
        ):
            assert (ends is not None) == sees
            assert ends is None or ends[0] <= value <= ends[1]
            shares = [basis[key] for key in ("data", "constraints", "prior")]
            assert min(shares) >= 0
            assert sum(shares) == pytest.approx(1)
            assert basis["on"] in GROUNDS
            assert basis["text"].startswith(f"{name} ")
            low, high = basis["range"]
            near = 1e-3 * (high - low) if low is not None and high is not None else 1e-3 * abs(value)
            assert low is None or low <= value + near
            assert high is None or high >= value - near
    assert report["bodies"]["shank_link"]["rests_on"][6]["on"] == "data"  # I_yy, about the knee's axis
    assert report["bodies"]["abad_link"]["rests_on"][0]["on"] == "prior"  # the first link's mass, which turns about x


def test_base_parameters_are_counted_and_named(report: dict[str, Any]) -> None:
    base = report["base_parameters"]
    assert (base["of"], base["structural"], base["determined"]) == (66, 38, 38)
    assert len(base["parameters"]) == base["structural"]
    for p in base["parameters"]:
        low, high = p["interval"]
        assert low <= p["value"] <= high
        assert p["standard_error"] > 0
        assert p["terms"][0]["of"] in p["name"]
    assert base["held_away"] == sum(p["pull"] > 3 for p in base["parameters"])


def test_uncertainty_says_how_it_was_found(report: dict[str, Any]) -> None:
    found = report["uncertainty"]
    assert found["confidence"] == 0.95
    assert found["blocks"] >= 16
    assert found["blocks"] * found["block_seconds"] == pytest.approx(0.7 * 7.0, rel=0.2)  # of 7 s, less the ends
    assert 0.8 < found["bootstrap_ratio"] < 1.25
    for key in ("independent_samples", "torque_standard_error", "torque_standard_error_largest"):
        assert found[key].keys() == set(JOINTS)
        assert all(value > 0 for value in found[key].values())
    for joint in JOINTS:
        assert found["torque_standard_error"][joint] <= found["torque_standard_error_largest"][joint]
        assert found["torque_standard_error"][joint] < report["rms"]["validation"][joint]
        assert found["torque_undetermined"][joint] == 0


def test_rotors_are_seen_at_their_joints(report: dict[str, Any]) -> None:
    assert report["rotors"].keys() == {f"{joint}_rotor" for joint in JOINTS}
    for joint in JOINTS:
        (seen,) = report["rotors"][f"{joint}_rotor"].values()
        assert (seen["interval"] is None) == (seen["standard_error"] is None) == (joint != "knee")  # as links turn
        if seen["interval"]:
            assert seen["interval"][0] <= seen["reflected_inertia"] <= seen["interval"][1]
            assert abs(seen["reflected_inertia"] - KNEE_ROTOR) < 4 * seen["standard_error"]


def test_logs_of_one_robot_agree(report: dict[str, Any]) -> None:
    compared = report["repeatability"]
    assert compared["logs"] == ["run1.csv", "run2.csv"]
    assert compared["agree"] == all(p["agrees"] for p in compared["parameters"])
    assert sum(p["agrees"] for p in compared["parameters"]) >= 36
    assert compared["odd_one_out"] is None
    assert len(compared["cross_rms"]) == 2
    assert compared["cross_rms"][0][0] < compared["cross_rms"][1][0]
    assert compared["cross_rms"][1][1] < compared["cross_rms"][0][1]


def test_least_squares_and_instruments_are_compared(report: dict[str, Any]) -> None:
    bias = report["bias"]
    assert (report["method"], bias["method"], bias["instruments"]) == ("ls", "ls", "smoothed")
    assert {p["name"] for p in bias["parameters"]} <= {p["name"] for p in report["base_parameters"]["parameters"]}
    for p in bias["parameters"]:
        if not p["differs"]:
            assert abs(p["ls"] - p["iv"]) < 8 * p["standard_error"]


def test_two_runs_tell_the_same_but_for_the_time(folder: Path, logs: tuple[Path, Path], report: dict[str, Any]) -> None:
    again = asked(folder / "again", *logs, "--config", CONFIG)
    for one in (again, report):
        one.pop("seconds")
        one["solver"].pop("seconds")
    assert again == report


def test_quick_asks_nothing_but_still_has_errors(folder: Path, logs: tuple[Path, Path], report: dict[str, Any]) -> None:
    quick = fitted(folder / "quick", LEG, logs[0], logs[1], "--config", CONFIG)
    assert [quick[key] for key in (*ASKED, "simulation")] == [None] * 4
    assert all(body["rests_on"] is None for body in quick["bodies"].values())
    for name, body in report["bodies"].items():
        assert quick["bodies"][name]["interval"] == body["interval"]
        assert quick["bodies"][name]["pi"] == body["pi"]


def test_instruments_without_a_command_are_smoothed(folder: Path, logs: tuple[Path, Path]) -> None:
    report = asked(folder / "iv", logs[1], "--config", CONFIG, "--method", "iv")
    assert (report["method"], report["bias"]["method"], report["bias"]["instruments"]) == ("iv", "iv", "smoothed")
    assert report["bias"]["weak"] == []
    assert any(note.startswith("not every joint has a command") for note in report["warnings"])
    assert report["repeatability"] is None


def commanded(path: Path, count: int, kp: float = STIFF) -> Path:
    """The sample log, with the command that its torque is the answer to under stiffness alone."""
    table = sample_table(count)
    for joint in JOINTS:
        q, tau = (table[0].index(f"{signal}_{joint}") for signal in ("q", "tau"))
        command = [float(row[q]) + float(row[tau]) / kp for row in table[1:]]
        table[0].append(f"qcmd_{joint}")
        for row, value in zip(table[1:], command, strict=True):
            row.append(repr(value))
    path.write_text(csv_text(table))
    return path


def test_instruments_under_a_command_are_simulated(folder: Path) -> None:
    log = commanded(folder / "commanded.csv", 2000)
    config = config_with(folder / "commanded.yaml", CONFIG, controller={"kp": dict.fromkeys(JOINTS, STIFF)})
    report = asked(folder / "commanded", log, "--config", config, "--method", "iv")
    assert (report["bias"]["instruments"], report["bias"]["weak"]) == ("closed_loop", [])
    assert not any("not every joint has a command" in note for note in report["warnings"])


def test_a_simulation_that_does_not_follow_is_no_check(folder: Path) -> None:
    """Of a loop that rings, for a delay that the robot had not: its instruments know nothing of the motion."""
    log = commanded(folder / "ringing.csv", 1500, kp=500.0)
    controller = {"kp": dict.fromkeys(JOINTS, 500.0), "delay": 0.05}
    config = config_with(folder / "ringing.yaml", CONFIG, controller=controller)
    report = asked(folder / "ringing", log, "--config", config)
    assert "knee" in report["bias"]["weak"]
    (said,) = (note for note in report["warnings"] if note.startswith("instruments are weak"))
    assert said.endswith(f"least squares was not checked for bias: {', '.join(report['bias']['weak'])}")


def test_a_log_given_twice_is_named(folder: Path, logs: tuple[Path, Path]) -> None:
    """Its noise, twice the same, would be taken for twice the evidence."""
    copy = folder / "copy.csv"
    copy.write_bytes(logs[0].read_bytes())
    report = asked(folder / "twice", *logs, copy, "--config", CONFIG)
    assert "duplicate data make the intervals too narrow; leave out copy.csv" in report["warnings"]


def test_different_logs_are_no_copies(report: dict[str, Any]) -> None:
    assert not any("duplicate data" in note for note in report["warnings"])


def test_the_table_of_many_logs_is_no_wider_than_that_of_few(folder: Path) -> None:
    logs = [cut(folder, f"a_run_with_a_long_name_{i}.csv", 500 * i, 500 * (i + 1)) for i in range(9)]
    done = idtool("fit", LEG, *logs, "--config", CONFIG, "--out", folder / "many", "--no-simulation")
    assert (done.code, done.err) == (0, "")
    _, head, *rows = done.out[done.out.index("Parameters that differ most between the logs") :].splitlines()
    assert head.split() == ["parameter", "smallest", "in", "largest", "in", "scatter", "/", "expected", "significant"]
    assert "…" not in "".join(rows[:4]).replace("+ …", "")
    assert any(f"{log.name} " in rows[0] for log in logs)


def test_the_terminal_says_what_is_determined(folder: Path, logs: tuple[Path, Path]) -> None:
    done = idtool("fit", LEG, *logs, "--config", CONFIG, "--out", folder / "shown", "--no-simulation")
    determined = (
        "The logs determine all 38 base parameters, the combinations of parameters on which the torque depends."
    )
    assert f"data: {determined}" in done.out
    (head,) = (line.split() for line in done.out.splitlines() if line.startswith("body "))
    assert {"data", "combination", "constraints", "prior"} <= set(head)
    (head,) = (line.split() for line in done.out.splitlines() if line.startswith("parameter "))
    assert head[1:3] == ["run1.csv", "run2.csv"]


def test_too_short_for_blocks_is_said(folder: Path) -> None:
    report = asked(folder / "short", cut(folder, "short.csv", 0, 600), "--config", CONFIG)
    assert (report["uncertainty"]["blocks"], report["uncertainty"]["bootstrap_ratio"]) == (0, None)
    assert any("log for longer" in note for note in report["warnings"])


def still(table: list[Row]) -> list[Row]:
    return column_set(column_set(table, "q_hip", lambda i: 0.3), "v_hip", lambda i: 0.0)


@pytest.mark.parametrize("method", ["ls", "iv"])
@pytest.mark.parametrize(
    ("table", "naming"),
    [
        (still(sample_table(2000)), "joint hip hardly moves"),
        (columns_kept(sample_table(2000), lambda name: name != "tau_hip"), "joint hip has neither torque"),
        (sample_table(60), "log"),
    ],
    ids=["rests", "no torque", "short"],
)
def test_unusable_logs_are_refused(tmp_path: Path, table: list[Row], naming: str, method: str) -> None:
    (tmp_path / "log.csv").write_text(csv_text(table))
    arguments = ["--config", CONFIG, "--out", "out", "--method", method]
    refuse(tmp_path, "fit", LEG, "log.csv", *arguments, naming=naming, file="log.csv")


def test_a_method_that_there_is_not_is_refused(tmp_path: Path) -> None:
    refuse(tmp_path, "fit", LEG, TRAIN, "--out", "out", "--method", "lsq", naming="--method")
