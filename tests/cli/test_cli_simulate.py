"""`idtool simulate` as a user runs it: what is written, what drives it, what is refused, and that nothing is lost."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import LEG, config_with, csv_text, files, idtool, refuse, sample_table
from numpy.typing import NDArray

from idtool.data.logs import JointLog, make_log, read_log, write_log

Array = NDArray[np.float64]

LEG_YAML = LEG.with_suffix(".yaml")
JOINTS = ("abad", "hip", "knee")
KP, KD, DELAY = (60.0, 50.0, 40.0), (3.0, 2.0, 1.0), 0.0035
CONTROLLER = {
    "kp": dict(zip(JOINTS, KP, strict=True)),
    "kd": dict(zip(JOINTS, KD, strict=True)),
    "delay": DELAY,
}
ROWS = 1500


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A second and a half of the leg's log."""
    path = tmp_path_factory.mktemp("logs") / "log.csv"
    path.write_text(csv_text(sample_table(ROWS)))
    return path


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The leg's configuration and a controller."""
    return config_with(tmp_path_factory.mktemp("config") / "leg.yaml", LEG_YAML, controller=CONTROLLER)


def trajectory(path: Path, velocity: bool = True, seconds: float = 2.0, rate: float = 500.0) -> Path:
    """A motion that nobody measured."""
    t = 100 + np.arange(round(seconds * rate)) / rate
    phase = 2 * np.pi * np.stack([0.5 * t, 0.7 * t, 0.9 * t], axis=1)
    signals = {"q": 0.3 * np.sin(phase)}
    if velocity:
        signals["v"] = 0.3 * 2 * np.pi * np.array([0.5, 0.7, 0.9]) * np.cos(phase)
    write_log(path, make_log(path, t, JOINTS, signals))
    return path


def simulated(*arguments: object, folder: Path) -> dict[str, Any]:
    """The result of a simulation that succeeds."""
    done = idtool("simulate", *arguments, "--json", "--quiet", folder=folder)
    assert (done.code, done.err) == (0, ""), done
    return done.json


def differences(measured: Path, written: Path) -> Array:
    """Of positions, shape (N, nv)."""
    before, after = read_log(measured).signals["q"], read_log(written).signals["q"]
    return np.asarray(after - before[: len(after)])


def controlled(log: JointLog) -> Array:
    """What the controller makes of a log's command, late, and motion; from the first sample that has all."""
    late = (log.t - log.t[0]) - DELAY
    q, v, qcmd, vcmd = (log.signals[name] for name in ("q", "v", "qcmd", "vcmd"))
    torque = np.empty_like(q)
    for j in range(q.shape[1]):
        commands = (np.interp(late, log.t - log.t[0], x[:, j]) for x in (qcmd, vcmd))
        torque[:, j] = KP[j] * (next(commands) - q[:, j]) + KD[j] * (next(commands) - v[:, j])
    return torque


def test_open_loop_writes_a_log_that_reads_back(short: Path, tmp_path: Path) -> None:
    result = simulated(LEG, short, "--out", "deep/er/out.csv", folder=tmp_path)
    assert list(result)[:2] == ["idtool", "schema"]
    assert set(files(tmp_path)) == {"deep/er/out.csv"}
    before, after = read_log(short), read_log(tmp_path / "deep/er/out.csv")
    assert len(after) in (ROWS - 1, ROWS)  # the measured velocity is late and read later, so the last one is not known
    assert (after.joints, after.segments, after.notices) == (JOINTS, (slice(0, len(after)),), ())
    np.testing.assert_array_equal(after.t, before.t[: len(after)])
    assert set(after.signals) == {"q", "v", "tau"}
    # what acted between the samples: the logged torque, its noise at the sampling rate smoothed
    noise = after.signals["tau"] - before.signals["tau"][: len(after)]
    assert np.sqrt(np.mean(noise**2)) < 0.5
    assert np.abs(noise.mean(axis=0)).max() < 1e-3
    assert (result["file"], result["kind"], result["window"], result["rollouts"]) == (
        "deep/er/out.csv",
        "open_loop",
        1,
        2,
    )
    assert (result["samples"], result["lost"]) == (len(after), 0)
    assert result["seconds"] == pytest.approx(1.5, abs=2e-3)
    assert 0 < result["wall_seconds"] < 60


def test_the_rmse_is_that_of_the_two_logs(short: Path, tmp_path: Path) -> None:
    result = simulated(LEG, short, "--out", "out.csv", folder=tmp_path)
    off = differences(short, tmp_path / "out.csv")
    squares = np.mean(np.delete(off, [0, 1000], axis=0) ** 2, axis=0)  # not where it was started
    assert [result["rmse"]["position"][name] for name in JOINTS] == pytest.approx(np.sqrt(squares), rel=1e-9)
    assert result["rmse"]["position"]["overall"] == pytest.approx(np.sqrt(squares.mean()), rel=1e-9)
    assert 0 < result["rmse"]["velocity"]["overall"] < 5


def test_mcap_holds_what_csv_holds(short: Path, config: Path, tmp_path: Path) -> None:
    """Stamps are rounded to nanoseconds, values are not."""
    logs = []
    for name in ("out.csv", "out.mcap"):
        simulated(LEG, short, "--track", "--config", config, "--out", name, folder=tmp_path)
        logs.append(read_log(tmp_path / name))
    assert logs[0].joints == logs[1].joints
    np.testing.assert_allclose(logs[0].t, logs[1].t, atol=1e-9)
    assert logs[0].signals.keys() == logs[1].signals.keys() == {"q", "v", "tau", "qcmd", "vcmd"}
    for name, values in logs[0].signals.items():
        np.testing.assert_array_equal(values, logs[1].signals[name])


@pytest.mark.parametrize(("window", "starts"), [("0", [0]), ("0.5", [0, 500, 1000]), (None, [0, 1000])])
def test_a_window_starts_from_the_measured_state(
    short: Path, tmp_path: Path, window: str | None, starts: list[int]
) -> None:
    result = simulated(LEG, short, "--out", "out.csv", *(["--window", window] if window else []), folder=tmp_path)
    assert (result["rollouts"], result["window"]) == (len(starts), {"0": None, "0.5": 0.5, None: 1.0}[window])
    far = np.abs(differences(short, tmp_path / "out.csv")).max(axis=1)
    assert far[starts].max() < 1e-3
    assert all(far[start - 1] > 10 * far[start] for start in starts[1:])  # the prior drifts until it is started again


def test_it_tracks_a_trajectory(config: Path, tmp_path: Path) -> None:
    path = trajectory(tmp_path / "wave.csv")
    result = simulated(LEG, path, "--track", "--config", config, "--out", "out.csv", folder=tmp_path)
    assert (result["kind"], result["window"], result["rollouts"]) == ("closed_loop", None, 1)
    assert result["warnings"] == []
    wanted, got = read_log(path), read_log(tmp_path / "out.csv")
    np.testing.assert_array_equal(got.t, wanted.t)
    np.testing.assert_array_equal(got.signals["qcmd"], wanted.signals["q"])
    np.testing.assert_array_equal(got.signals["vcmd"], wanted.signals["v"])
    np.testing.assert_allclose(got.signals["q"][0], wanted.signals["q"][0], atol=1e-5)
    np.testing.assert_allclose(got.signals["v"][0], wanted.signals["v"][0], atol=1e-3)
    np.testing.assert_allclose(got.signals["tau"], controlled(got), atol=1e-9)
    off = np.sqrt(np.mean((got.signals["q"] - wanted.signals["q"])[1:] ** 2))
    assert 1e-3 < off < 0.1  # a leg has weight, and the controller no integral part
    assert result["rmse"]["position"]["overall"] == pytest.approx(off, rel=1e-9)


def test_a_trajectory_need_not_have_velocities(config: Path, tmp_path: Path) -> None:
    path = trajectory(tmp_path / "wave.csv", velocity=False)
    simulated(LEG, path, "--track", "--config", config, "--out", "out.csv", folder=tmp_path)
    other = trajectory(tmp_path / "with.csv")
    simulated(LEG, other, "--track", "--config", config, "--out", "with_out.csv", folder=tmp_path)
    logs = [read_log(tmp_path / name).signals for name in ("out.csv", "with_out.csv")]
    np.testing.assert_allclose(logs[0]["vcmd"][1:-1], logs[1]["vcmd"][1:-1], atol=1e-3)
    np.testing.assert_allclose(logs[0]["q"], logs[1]["q"], atol=1e-3)


def test_a_recorded_command_is_the_trajectory(config: Path, tmp_path: Path) -> None:
    """Of a log with a command, that is tracked, and not the motion that came of it."""
    path = trajectory(tmp_path / "wave.csv")
    log = read_log(path)
    moved = {"q": log.signals["q"] + 0.2, "qcmd": log.signals["q"], "vcmd": log.signals["v"]}
    write_log(tmp_path / "log.csv", make_log(path, log.t, JOINTS, moved))
    for name in ("wave.csv", "log.csv"):
        simulated(LEG, name, "--track", "--config", config, "--out", f"of_{name}", folder=tmp_path)
    first, second = (read_log(tmp_path / f"of_{name}").signals for name in ("wave.csv", "log.csv"))
    np.testing.assert_allclose(first["q"], second["q"], atol=1e-9)


def test_a_log_of_its_own_is_what_it_does_again(config: Path, tmp_path: Path) -> None:
    """By its command alone, without its torque column, and under its torque, each from the measured first state."""
    path = trajectory(tmp_path / "wave.csv")
    simulated(LEG, path, "--track", "--config", config, "--out", "own.csv", folder=tmp_path)
    own = read_log(tmp_path / "own.csv")
    signals = {name: x for name, x in own.signals.items() if name != "tau"}
    write_log(tmp_path / "bare.csv", make_log(path, own.t, JOINTS, signals))
    for name, options, kind in (
        ("own.csv", ["--closed-loop"], "closed_loop"),
        ("bare.csv", [], "closed_loop"),
        ("own.csv", [], "open_loop"),
    ):
        result = simulated(LEG, name, *options, "--config", config, "--out", "again.csv", folder=tmp_path)
        assert result["kind"] == kind
        again = read_log(tmp_path / "again.csv")
        assert ("qcmd" in again.signals) is (kind == "closed_loop")
        assert result["rmse"]["position"]["overall"] < 2e-3
        np.testing.assert_allclose(again.signals["q"], own.signals["q"], atol=2e-2 if kind == "open_loop" else 1e-4)


def test_a_gap_stays_one_and_each_stretch_has_its_start(config: Path, tmp_path: Path) -> None:
    path = trajectory(tmp_path / "wave.csv")
    log = read_log(path)
    kept = np.r_[0:400, 600:1000]
    write_log(path, make_log(path, log.t[kept], JOINTS, {name: x[kept] for name, x in log.signals.items()}))
    result = simulated(LEG, path, "--track", "--config", config, "--out", "out.csv", folder=tmp_path)
    got = read_log(tmp_path / "out.csv")
    assert result["rollouts"] == 2
    assert got.segments == (slice(0, 400), slice(400, 800))
    np.testing.assert_allclose(got.signals["q"][[0, 400]], log.signals["q"][[0, 600]], atol=1e-5)


def test_what_it_says(short: Path, config: Path, tmp_path: Path) -> None:
    done = idtool("simulate", LEG, short, folder=tmp_path)
    assert (done.code, done.err) == (0, "")
    assert "open loop under the logged torque, 1 s at a time: 1.5 s simulated in " in done.out
    assert "rad RMS from the measured positions: abad " in done.out
    assert done.out.endswith("written: leg_idtool/simulated.mcap\n")
    assert set(files(tmp_path)) == {"leg_idtool/simulated.mcap"}
    done = idtool("simulate", LEG, short, "--track", "--config", config, folder=tmp_path)
    assert "closed loop under the controller, never restarted: " in done.out
    assert " from the trajectory: " in done.out
    assert idtool("simulate", LEG, short, "--quiet", folder=tmp_path).out == ""


def test_jumps_and_a_motion_that_runs_away_are_named(short: Path, config: Path, tmp_path: Path) -> None:
    codes = {}
    for options in ((), ("--window", "0"), ("--track", "--config", config)):
        result = simulated(LEG, short, *options, "--out", "out.csv", folder=tmp_path)
        codes[options[:1]] = [notice["code"] for notice in result["notices"]]
    assert codes == {(): ["simulation_restarted"], ("--window",): [], ("--track",): []}
    (tmp_path / "free.yaml").write_text("friction: {viscous: false, coulomb: false}\n")
    result = simulated(LEG, short, "--config", "free.yaml", "--window", "0", "--out", "out.csv", folder=tmp_path)
    (notice,) = [notice for notice in result["notices"] if notice["code"] == "simulation_ran_away"]
    assert re.search(r"differs by \d[\d.e+]* rad RMS, and the joints move by 0\.\d+ rad RMS", notice["message"])
    assert "use --closed-loop, --track or a short --window" in notice["advice"]


@pytest.fixture
def lighter_leg(tmp_path: Path) -> Callable[[float], None]:
    """A leg with links that are lighter by a factor, without rotors and friction."""

    def write(factor: float) -> None:
        def lighter(entry: re.Match[str]) -> str:
            return f'{entry[1]}="{factor * float(entry[2])!r}"'

        (tmp_path / "leg.urdf").write_text(re.sub(r'(mass value|i[xyz]{2})="([^"]+)"', lighter, LEG.read_text()))
        (tmp_path / "leg.yaml").write_text("friction: {viscous: false, coulomb: false}\n")

    return write


def test_rollouts_that_run_away_end_where_they_did(
    short: Path, tmp_path: Path, lighter_leg: Callable[[float], None]
) -> None:
    lighter_leg(1e-3)
    done = idtool("simulate", "leg.urdf", short, "--out", "out.csv", "--json", folder=tmp_path)
    assert done.code == 0
    assert done.json["lost"] > 0
    assert f"{done.json['lost']} of 2 rollouts diverged; each ends where it diverged" in done.json["warnings"]
    log = read_log(tmp_path / "out.csv")
    assert len(log) == done.json["samples"] < ROWS
    assert all(np.isfinite(x).all() for x in log.signals.values())


def test_rollouts_that_run_away_at_once_are_no_log(
    short: Path, tmp_path: Path, lighter_leg: Callable[[float], None]
) -> None:
    lighter_leg(1e-5)
    done = idtool("simulate", "leg.urdf", short, "--out", "out.csv", folder=tmp_path)
    assert done.code == 2
    assert done.err == "error: leg.urdf: diverges as soon as it is simulated; its inertias are too small\n"
    assert not (tmp_path / "out.csv").exists()


REFUSED = {
    "tracking without a controller": (["--track"], "controller"),
    "closed loop without a controller": (["--closed-loop"], "controller"),
    "both": (["--track", "--closed-loop"], "--track"),
    "a window of less than nothing": (["--window", "-1"], "--window"),
    "a window that is not a number": (["--window", "nan"], "--window"),
    "an ending that is not a log's": (["--out", "out/log.txt"], "use .csv or .mcap"),
    "onto what is read": (["--out", "log.csv"], "is an input file"),
    "a folder that is a file": (["--out", "log.csv/out.csv"], "log.csv: is a file, but a folder is needed"),
}


@pytest.mark.parametrize(("options", "naming"), REFUSED.values(), ids=REFUSED)
def test_what_is_refused(tmp_path: Path, options: list[str], naming: str) -> None:
    (tmp_path / "log.csv").write_text(csv_text(sample_table(300)))
    (tmp_path / "folder.csv").mkdir()
    refuse(tmp_path, "simulate", LEG, "log.csv", *options, naming=naming)


def test_logs_that_do_not_say_what_drives_them(tmp_path: Path, config: Path) -> None:
    trajectory(tmp_path / "wave.csv")
    refuse(
        tmp_path, "simulate", LEG, "wave.csv", "--config", config, naming="use --track to let the controller follow q"
    )
    done = idtool("simulate", LEG, "wave.csv", "--closed-loop", "--config", config, folder=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert "wave.csv: contains no command" in done.err


def test_a_model_that_cannot_move_loses_nothing(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(csv_text(sample_table(300)))
    (tmp_path / "leg.urdf").write_text(LEG.read_text().replace("<inertial>", "<!--").replace("</inertial>", "-->"))
    (tmp_path / "former.csv").write_text("the former")
    refuse(tmp_path, "simulate", "leg.urdf", "log.csv", "--out", "former.csv", naming="leg.urdf: cannot be simulated")


@pytest.mark.parametrize("target", ["idtool.estimation.evaluation.simulated_log.simulate", "mcap.writer.Writer.finish"])
def test_stopped_by_the_user_it_leaves_what_was_there(
    short: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, target: str
) -> None:
    def stop(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    (tmp_path / "former.mcap").write_text("the former")
    monkeypatch.setattr(target, stop)
    done = idtool("simulate", LEG, short, "--out", "former.mcap", folder=tmp_path)
    assert done.code == 130
    assert files(tmp_path) == {"former.mcap": b"the former"}


def test_joints_that_only_the_log_has_and_joints_that_it_lacks(tmp_path: Path) -> None:
    """What is simulated is the model's joints that the log has."""
    table = sample_table(600)
    names = [name.replace("abad", "tail") for name in table[0]]
    (tmp_path / "log.csv").write_text(csv_text([names, *table[1:]]))
    config = config_with(tmp_path / "c.yaml")
    result = simulated(LEG, "log.csv", "--config", config, "--out", "o.csv", folder=tmp_path)
    assert result["joints"] == ["hip", "knee"]
    assert read_log(tmp_path / "o.csv").joints == ("hip", "knee")
