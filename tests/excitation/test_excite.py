"""`idtool excite`: what it writes keeps the limits, by Pinocchio's word, and tells more than a random motion."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import LEG, SAMPLES, TRAIN, idtool
from exciting import arm, body, derivatives, excited, joint, robot, torque
from pages import Page, complete

from idtool.common.number_text import number
from idtool.data.logs import JointLog, read_log
from idtool.excitation.objective import Objective

FRICTION = {"a": (0.2, 0.5), "b": (0.2, 0.5)}


def within(log: JointLog, report: dict[str, Any], share: float = 1.0) -> None:
    """Position, velocity and acceleration are within the limits the report names, by the positions alone."""
    q, v, a = derivatives(log)
    for j, name in enumerate(log.joints):
        limits = report["limits"][name]
        lower, upper = limits["position"]
        middle, half = (lower + upper) / 2, (upper - lower) / 2
        assert np.abs(q[:, j] - middle).max() <= share * half
        assert np.abs(v[:, j]).max() <= share * limits["velocity"]
        assert np.abs(a[:, j]).max() <= share * limits["acceleration"] * (1 + 1e-4)  # of differences


@pytest.mark.parametrize("pattern", ["fourier", "bspline"])
def test_limits_are_kept_by_pinocchios_word(tmp_path: Path, pattern: str) -> None:
    urdf = arm(effort=9.0)  # static torque reaches 4.4, so that the effort limits bind
    report, log = excited(tmp_path, urdf, "--pattern", pattern, "--iterations", "25", "--margin", "0.05")
    within(log, report, 0.95)
    tau = torque(urdf, ("a", "b"), FRICTION, log)
    largest = np.abs(tau).max(axis=0)
    assert largest[0] <= 0.9 * 9.0 * (1 + 1e-3)
    assert largest[1] <= 0.9 * 30.0
    assert largest == pytest.approx([report["use"]["a"]["effort"] * 9, report["use"]["b"]["effort"] * 30], rel=0.02)
    assert max(report["use"]["a"].values()) > 0.8  # and are made use of


def test_it_begins_and_ends_at_rest_and_velocity_is_the_derivative(tmp_path: Path) -> None:
    report, log = excited(tmp_path, arm(), "--duration", "12", "--start", "a=0.3")
    _, v, a = derivatives(log)
    assert log.signals["vcmd"][2:-2] == pytest.approx(v, abs=1e-5)  # of differences
    jumps = np.abs(np.diff(a, axis=0)).max(axis=0)
    assert (jumps < 0.06 * np.abs(a).max(axis=0)).all()  # the acceleration is continuous, where parts meet too
    for end in (0, -1):
        assert log.signals["qcmd"][end] == pytest.approx([0.3, report["home"]["b"]], abs=1e-9)
        assert log.signals["vcmd"][end] == pytest.approx(0, abs=1e-9)
        assert a[end] == pytest.approx(0, abs=0.1)
    assert [part["pattern"] for part in report["parts"]] == ["fourier", "slow"]
    assert report["parts"][-1]["end"] == pytest.approx(12)
    assert (log.t[0], log.t[-1], len(log)) == (0, 12, 12001)


def test_slow_sweeps_and_standstill_are_there(tmp_path: Path) -> None:
    report, log = excited(tmp_path, arm(), "--duration", "20", "--slow", "0.4")
    parts = {part["pattern"]: slice(int(1000 * part["start"]), int(1000 * part["end"])) for part in report["parts"]}
    assert set(parts) == {"fourier", "slow", "standstill"}
    for v in log.signals["vcmd"][parts["slow"]].T:
        held = np.abs(np.diff(v)) < 1e-12
        speeds = np.unique(np.round(v[1:][held & (np.abs(v[1:]) > 1e-3)], 6))
        assert len(speeds) == 6  # three, in both directions
        assert sorted(-speeds[speeds < 0]) == pytest.approx(sorted(speeds[speeds > 0]))
        assert held.mean() > 0.5
    assert (log.signals["vcmd"][parts["standstill"]] == 0).all(axis=1).mean() > 0.25


def test_other_joints_than_hinges(tmp_path: Path) -> None:
    urdf = robot(
        *(body(f"l{i}") for i in range(3)),
        body("tip", 0.2),
        joint(
            "slide", "base", "l0", "0 0 1", kind="prismatic", limit='lower="0" upper="0.4" velocity="0.6" effort="200"'
        ),
        joint("turn", "l0", "l1", "0 0 1", kind="continuous", limit='velocity="3" effort="20"'),
        joint("fold", "l1", "l2"),
        joint("copy", "l2", "tip", extra='<mimic joint="fold" multiplier="-1" offset="0.2"/>'),
    )
    report, log = excited(tmp_path, urdf)
    assert log.joints == ("slide", "turn", "fold")
    within(log, report)
    fold = log.signals["qcmd"][:, 2]
    assert (0.2 - fold).max() <= 2
    assert report["units"] == {"slide": "N", "turn": "N·m", "fold": "N·m"}
    assert any(note.startswith("no position limit") and "turn; " in note for note in report["warnings"])


def test_a_belt_and_rotors(tmp_path: Path) -> None:
    report, log = excited(tmp_path, SAMPLES / "belt_arm.urdf")
    within(log, report, 0.9)
    assert report["criteria"]["design"]["d"] < report["criteria"]["random"]["d"]


def test_it_tells_more_than_a_random_motion_and_again_the_same(tmp_path: Path) -> None:
    options = ["--iterations", "25", "--noise", "0.1"]
    report, log = excited(tmp_path, arm(), *options)
    again, same = excited(tmp_path / "b", arm(), *options)
    assert report["criteria"]["design"]["d"] < 0.85 * report["criteria"]["random"]["d"]
    assert np.array_equal(log.signals["qcmd"], same.signals["qcmd"])
    assert again["base_parameters"] == report["base_parameters"]
    other, _ = excited(tmp_path / "c", arm(), *options, "--seed", "1")
    assert other["base_parameters"] != report["base_parameters"]


def errors(report: dict[str, Any]) -> dict[str, float]:
    return {p["name"]: p["standard_error"] for p in report["base_parameters"]}


def test_errors_go_with_the_noise_and_friction_is_told(tmp_path: Path) -> None:
    once, _ = excited(tmp_path, arm(), "--noise", "0.1")
    twice, _ = excited(tmp_path / "b", arm(), "--noise", "0.2")
    assert errors(twice) == pytest.approx({name: 2 * x for name, x in errors(once).items()}, rel=1e-6)
    for name in ("a", "b"):
        assert once["terms"][name]["coulomb"]["standard_error"] == pytest.approx(errors(once)[f"{name} coulomb"])
    assert once["bodies"]["upper"]["standard_error"][0] is None  # a mass on the first joint is told by no motion


@pytest.mark.slow
def test_favoured_parameters_become_sharper(tmp_path: Path) -> None:
    plain, _ = excited(tmp_path, LEG, "--iterations", "15", "--noise", "0.1")
    keen, _ = excited(
        tmp_path / "b", LEG, "--iterations", "15", "--noise", "0.1", "--favour", "abad", "--criterion", "a"
    )
    assert errors(keen)["abad coulomb"] < errors(plain)["abad coulomb"]
    assert errors(keen)["abad viscous"] < 0.9 * errors(plain)["abad viscous"]
    chosen = {p["name"] for p in keen["base_parameters"] if p["favoured"]}
    assert chosen == {"abad viscous", "abad coulomb"}


def test_what_is_logged_counts(tmp_path: Path) -> None:
    report, log = excited(tmp_path, LEG, "--log", TRAIN)
    assert report["noise"]["hip"] == pytest.approx(0.107, rel=0.1)  # what was put into that log
    for p in report["base_parameters"]:
        assert p["standard_error"] < p["logged_standard_error"]
    assert report["criteria"]["design"]["d"] < report["criteria"]["logged"]["d"]
    assert log.joints == ("abad", "hip", "knee")


def test_mcap_by_its_ending_a_page_and_simulate_takes_it(tmp_path: Path) -> None:
    report, log = excited(tmp_path, LEG, "--out", tmp_path / "m.mcap", "--rate", "500")
    assert set(log.signals) == {"q", "v", "qcmd", "vcmd"}
    assert log.dt == pytest.approx(0.002)
    page = Page((tmp_path / "m.html").read_text())
    complete(page)
    assert [row["velocity"] for row in page.table("effort").values()]
    assert len(page.table("± se", first=["base parameter", "motion"])) == len(report["base_parameters"])
    figure = page.figures[1]
    curves = ("position", "velocity", "acceleration", "predicted torque")
    assert figure.names == [name for curve in curves for name in (curve, "limit", "limit")]
    for panel in range(4):
        curve, low, high = (np.array(trace["y"]) for trace in figure.data[3 * panel : 3 * panel + 3])
        assert (low[0] < curve).all()
        assert (curve < high[0]).all()
    seen = idtool("inspect", tmp_path / "m.mcap", "--json")
    assert seen.code == 0
    config = tmp_path / "c.yaml"
    config.write_text(
        (SAMPLES / "leg.yaml").read_text()
        + "controller: {kp: {abad: 900, hip: 900, knee: 900}, kd: {abad: 20, hip: 20, knee: 20}}\n"
    )
    run = idtool(
        "simulate",
        LEG,
        tmp_path / "m.mcap",
        "--track",
        "--config",
        config,
        "--out",
        tmp_path / "s.csv",
        "--json",
        "--quiet",
    )
    assert run.code == 0, run.err
    assert run.json["rmse"]["position"] == {} or run.json["rmse"]["position"]["overall"] < 0.05


def test_an_interrupted_search_gives_the_best_so_far(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    count = 0
    evaluate = Objective.__call__

    def stopped(self: Objective, x: Any) -> Any:
        nonlocal count
        count += 1
        if count > 12:
            raise KeyboardInterrupt
        return evaluate(self, x)

    monkeypatch.setattr(Objective, "__call__", stopped)
    report, log = excited(tmp_path, arm())
    assert report["interrupted"]
    assert "the search was interrupted: this is the best trajectory so far" in report["warnings"]
    within(log, report, 0.9)
    assert report["criteria"]["design"]["d"] < report["criteria"]["random"]["d"]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--favour", "uper"], "--favour: uper is not a body, joint or coefficient; did you mean upper?"),
        (["--favour", "upper.m"], "--favour: the torque does not depend on upper.m: no motion can determine it"),
        (["--noise", "c=1"], "--noise: c is not a moving joint; available: a, b"),
        (["--noise", "-1"], "--noise: -1 is not NUMBER or JOINT=NUMBER, above 0"),
        (["--start", "a=1.95"], "--start: a = 1.95 is not between"),
        (["--start", "1"], "--start: 1 is not JOINT=NUMBER"),
        (["--pattern", "spline"], "--pattern: spline is not a pattern; did you mean bspline?"),
        (["--criterion", "f"], "--criterion: f is not a criterion; available: d, a, e, condition"),
        (["--slow", "1"], "--slow: 1 is not a fraction"),
        (["--duration", "2"], "--duration: 2 is not between 3 and 3600"),
        (["--rate", "50"], "filter.cutoff_hz: 40 Hz is too high for --rate 50"),
        (["--out", "m.bag"], "m.bag: unsupported log format '.bag'"),
        (["--pattern", "shell", "--tip", "hand"], "--tip: hand is not a link"),
    ],
)
def test_errors_a_user_can_act_on(tmp_path: Path, options: list[str], told: str) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(arm())
    (tmp_path / "robot.yaml").write_text("filter: {cutoff_hz: 40}\n")
    done = idtool("excite", path, "--iterations", "1", "--duration", "4", *options, folder=tmp_path)
    assert done.code == 2
    assert told in done.err
    assert done.err.count("\n") == 1
    assert {p.name for p in tmp_path.iterdir()} == {"robot.urdf", "robot.yaml"}


def test_an_arm_too_weak_to_hold_itself_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(
        arm(effort=0.1).replace(
            'lower="-1.5" upper="2" velocity="4" effort="0.1"', 'lower="-0.2" upper="0.2" velocity="4" effort="0.1"'
        )
    )
    done = idtool("excite", path, folder=tmp_path)
    assert done.code == 2
    assert "at the start, gravity alone requires more torque than the limits allow" in done.err


def test_json_and_table_say_the_same(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(arm())
    options = ["excite", path, "--iterations", "3", "--duration", "4", "--noise", "0.1"]
    told = idtool(*options, folder=tmp_path).out
    report = json.loads(idtool(*options, "--json", "--quiet", folder=tmp_path).out)
    for p in report["base_parameters"]:
        assert number(p["standard_error"]) in told
    assert read_log(tmp_path / "robot_idtool" / "excitation.mcap").joints == ("a", "b")
