"""A quadruped in MuJoCo that stands and hangs: fitted and validated with IMU and contacts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ground.logs import RATE, Sensors, config_text, write_csv
from ground.quadruped import JOINTS
from ground.robot import prior_robot, urdf_text
from prescribed_motions import silent
from quadruped_recordings import TRUTH, record_quadruped
from scipy.spatial.transform import Rotation

import idtool
from idtool.api.data import load_experiment
from idtool.common.exceptions import ConfigError, LogError
from idtool.common.safe_yaml import parse_yaml
from idtool.estimation.evaluation.torque_errors import evaluate
from idtool.reporting.pages.robot import robot_view
from idtool.robot.model import BASE_COORDINATES

FORCES = ("unknown", "measured")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("quadruped")
    for kind in ("stand", "hang"):
        write_csv(path / f"{kind}.csv", record_quadruped(kind, 5.0))
        write_csv(path / f"short_{kind}.csv", record_quadruped(kind, 2.0))
    (path / "true.urdf").write_text(urdf_text(TRUTH))
    (path / "prior.urdf").write_text(urdf_text(prior_robot(TRUTH, 0)))
    return path


def settings(forces: str, **changes: Any) -> dict[str, Any]:
    """Configuration in which the forces on the feet are ``unknown`` or ``measured``."""
    content = parse_yaml(Path("quadruped.yaml"), config_text(TRUTH, forces).encode())
    return {**dict(content), **changes}


def true_model(folder: Path, forces: str, **changes: Any) -> idtool.Model:
    """The true robot with its friction."""
    friction = {}
    for joint, viscous, coulomb in zip(JOINTS, TRUTH.viscous, TRUTH.coulomb, strict=True):
        friction[joint] = {"viscous": float(viscous), "coulomb": float(coulomb)}
    return idtool.Model(folder / "true.urdf", config=settings(forces, friction=friction, **changes))


@pytest.mark.parametrize("forces", ["unknown", pytest.param("measured", marks=pytest.mark.slow)])
def test_mass_and_centre_of_mass_are_found(folder: Path, forces: str) -> None:
    """From a prior whose masses are 10 to 30 % off."""
    model = idtool.Model(folder / "prior.urdf", config=settings(forces))
    result = idtool.fit(model, [folder / "stand.csv", folder / "hang.csv"], quick=True)
    robot = result.whole_robot
    assert robot is not None
    assert robot.mass == pytest.approx(TRUTH.mass, rel=5e-3)
    assert np.linalg.norm(np.asarray(robot.com) - TRUTH.center_of_mass) < 2e-3
    assert abs(robot.prior_mass / TRUTH.mass - 1) > 0.04
    coulomb = [result.friction[joint].coulomb for joint in JOINTS]
    np.testing.assert_allclose(coulomb, TRUTH.coulomb, atol=0.03)
    assert set(result.friction) == set(JOINTS)

    result.save(folder / forces)
    again = idtool.validate(folder / forces / "identified.urdf", folder / "stand.csv")
    before = idtool.validate(model, folder / "stand.csv")
    assert again.rms.model["overall"] < 0.3 * before.rms.model["overall"]
    assert "floating_base_not_simulated" in [notice.code for notice in again.notices]


def test_band_ends_where_the_noise_of_the_gyroscope_counts_unless_it_is_given(folder: Path) -> None:
    def prepared(**changes: Any) -> tuple[float, list[str]]:
        model = idtool.Model(folder / "prior.urdf", config=settings("unknown", **changes))
        experiment = load_experiment(model, (), folder / "stand.csv")
        return experiment.band_hz, [notice.code for notice in experiment.notices]

    band, codes = prepared()
    assert 8 <= band < 30
    assert "band_by_gyroscope" in codes
    given, codes = prepared(filter={"cutoff_hz": 40})
    assert given == 40
    assert "band_by_gyroscope" not in codes


@pytest.mark.slow
def test_written_logs_give_the_same_robot(folder: Path, tmp_path: Path) -> None:
    """A log with its sensors, written as CSV and as MCAP."""
    model = idtool.Model(folder / "prior.urdf", config=settings("unknown"))
    first = folder / "short_hang.csv"
    log = idtool.Log(first)
    masses = []
    for path in (first, log.save(tmp_path / "hang.csv"), log.save(tmp_path / "hang.mcap")):
        robot = idtool.fit(model, path, quick=True).whole_robot
        assert robot is not None
        masses.append([robot.mass, *robot.com])
    assert masses[0] == masses[1] == masses[2]


@pytest.mark.parametrize(("kind", "rows"), [("stand", 18 - 12), ("hang", 18 - 6)])
def test_true_robot_leaves_the_noise_of_its_sensors(folder: Path, kind: str, rows: int) -> None:
    """In units of their noise, no more in sum than there are rows less components of unknown forces.

    It is less, since the friction of joints at rest is unknown too.
    """
    in_band = np.sqrt(2 * 40 / RATE)
    noise = dict.fromkeys(JOINTS, Sensors().tau * in_band)
    noise |= dict.fromkeys(BASE_COORDINATES[:3], Sensors().accelerometer * TRUTH.mass * in_band)
    noise |= dict.fromkeys(BASE_COORDINATES[3:], 0.02)
    base = {**settings("unknown")["base"], "noise": {name: float(x) for name, x in noise.items()}}
    model = true_model(folder, "unknown", base=base, filter={"cutoff_hz": 40})
    rms = idtool.validate(model, folder / f"{kind}.csv").rms.model
    in_noise = sum(((rms[name] or 0.0) / noise[name]) ** 2 for name in noise)
    assert 0.4 * rows < in_noise < 1.2 * rows


@pytest.mark.parametrize("forces", FORCES)
def test_joints_in_the_air_are_simulated_with_the_measured_motion_of_the_base(folder: Path, forces: str) -> None:
    prior = idtool.Model(folder / "prior.urdf", config=settings(forces))
    simulation = idtool.validate(true_model(folder, forces), folder / "hang.csv", prior=prior).simulation
    assert simulation is not None
    assert simulation.prior is not None
    assert set(simulation.units) == set(JOINTS)
    assert simulation.position["overall"] < 0.1 * simulation.baseline.position["overall"]
    assert simulation.position["overall"] < 0.1 * simulation.prior.position["overall"]
    assert idtool.validate(true_model(folder, forces), folder / "stand.csv").simulation is None


@pytest.mark.parametrize(
    ("feature", "call"),
    [
        ("idtool excite with logs", lambda model, log, folder: idtool.excite(model, logs=log)),
        (
            "idtool diagnose --against",
            lambda model, log, folder: idtool.diagnose(model, log, against=folder / "stand.csv"),
        ),
        ("idtool reduce", lambda model, log, folder: idtool.reduce(model, log, folder / "hang.idr")),
        ("--cluster", lambda model, log, folder: idtool.fit(model, log, cluster="local:1")),
        ("--cluster", lambda model, log, folder: idtool.diagnose(model, log, cluster="local:1")),
    ],
)
def test_what_needs_a_fixed_base_says_so(folder: Path, feature: str, call: Callable[..., Any]) -> None:
    model = idtool.Model(folder / "prior.urdf", config=settings("unknown"))
    with pytest.raises(ConfigError, match=f"{feature} needs a fixed base"):
        call(model, folder / "hang.csv", folder)


@pytest.mark.slow
def test_motion_is_designed_for_a_held_base(folder: Path) -> None:
    model = idtool.Model(folder / "prior.urdf", config=settings("unknown"))
    result = idtool.excite(model, duration=3, iterations=1)
    assert "base_is_held" in [notice.code for notice in result.notices]
    assert result.log.joints == JOINTS


def test_robot_on_the_page_turns_with_its_imu(folder: Path) -> None:
    experiment = load_experiment(true_model(folder, "unknown"), folder / "stand.csv")
    evaluation = evaluate(experiment, {"model": experiment.equation.prior}, False, silent, angles=True)
    trunk = {"name": "trunk", "masses": None}
    robot = robot_view(experiment.model, [trunk], evaluation.traces)["robot"]
    log = np.genfromtxt(folder / "stand.csv", delimiter=",", names=True)
    samples = np.searchsorted(log["t"], robot["t"])
    of_imu = Rotation.from_quat(np.stack([log[f"imu_q{part}"] for part in "xyzw"], axis=1)[samples])
    expected = of_imu * Rotation.from_euler("z", TRUTH.imu.turn).inv()
    shown = Rotation.from_quat([frames[1][:4] for frames in robot["frames"]])
    assert (expected * shown.inv()).magnitude().max() < 0.02
    assert expected.magnitude().max() > 0.04


def test_missing_sensor_is_named(folder: Path, tmp_path: Path) -> None:
    lines = (folder / "hang.csv").read_text().splitlines()
    path = tmp_path / "renamed.csv"
    path.write_text("\n".join([lines[0].replace("imu_wx", "gyro_x"), *lines[1:2000]]))
    model = idtool.Model(folder / "prior.urdf", config=settings("unknown"))
    with pytest.raises(LogError, match="has no channel imu_wx"):
        idtool.fit(model, path, quick=True)


@pytest.mark.parametrize(("letter", "dead"), [("a", "accelerometer"), ("w", "gyroscope")])
def test_imu_whose_reading_never_changes_is_refused(folder: Path, tmp_path: Path, letter: str, dead: str) -> None:
    header, *lines = [line.split(",") for line in (folder / "hang.csv").read_text().splitlines()[:2000]]
    for line in lines:
        for axis in "xyz":
            line[header.index(f"imu_{letter}{axis}")] = "0"
    path = tmp_path / "dead.csv"
    path.write_text("\n".join(",".join(line) for line in [header, *lines]))
    model = idtool.Model(folder / "prior.urdf", config=settings("unknown"))
    with pytest.raises(LogError, match=f"the {dead} of the IMU has a constant reading"):
        idtool.validate(model, path)


@pytest.fixture(scope="module")
def late_imu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("late") / "stand.csv"
    write_csv(path, record_quadruped("stand", 5.0, sensors=Sensors(imu_delay=6e-3)))
    return path


def notice_codes(folder: Path, log: Path, **imu: Any) -> tuple[list[str], float]:
    """Codes of the notices about the IMU, and its delay as it is used [s]; ``auto`` counts as 0."""
    base = settings("unknown")["base"]
    config = settings("unknown", base={**base, "imu": {**base["imu"], **imu}})
    experiment = load_experiment(idtool.Model(folder / "prior.urdf", config=config), (), [log])
    codes = [notice.code for notice in experiment.notices if notice.code.startswith("imu")]
    delay = experiment.config.base.imu.delay
    return codes, 0.0 if delay == "auto" else float(delay)


def test_delay_of_the_imu_is_found_and_undone(folder: Path, late_imu: Path) -> None:
    """By how the joints turn the base while the feet stand; soft feet account for a millisecond."""
    codes, delay = notice_codes(folder, late_imu)
    assert codes == ["imu_delay"]
    assert delay == pytest.approx(6e-3, abs=1.5e-3)
    assert notice_codes(folder, late_imu, delay=6e-3) == ([], 6e-3)
    assert notice_codes(folder, late_imu, delay=0.0) == (["imu_delay"], 0.0)  # a warning
    assert notice_codes(folder, folder / "stand.csv") == ([], 0.0)
    assert notice_codes(folder, folder / "hang.csv") == ([], 0.0)  # which tells nothing


def test_delay_that_is_no_number_is_refused(folder: Path) -> None:
    with pytest.raises(ConfigError, match="never is not a delay; give auto, or a number in s"):
        notice_codes(folder, folder / "hang.csv", delay="never")


def test_delay_of_a_controller_must_be_given(folder: Path, tmp_path: Path) -> None:
    """Torque by the controller, from commands in place of the logged torque."""
    header, *rows = (folder / "hang.csv").read_text().splitlines()
    (tmp_path / "log.csv").write_text("\n".join([header.replace("tau_", "qcmd_"), *rows]))
    gains = dict.fromkeys(JOINTS, 40.0)
    model = idtool.Model(folder / "prior.urdf", config=settings("unknown", controller={"kp": gains}))
    with pytest.raises(ConfigError, match="is not fitted for a floating base or with contacts; give it in s"):
        idtool.fit(model, tmp_path / "log.csv", quick=True)


def test_row_that_contacts_leave_nothing_of_has_no_error(folder: Path) -> None:
    """The rope takes what the base's rows have; what is left of them is rounding."""
    noise = dict.fromkeys((*JOINTS, *BASE_COORDINATES), 0.1)
    base = {**settings("unknown")["base"], "noise": noise}
    model = true_model(folder, "unknown", base=base, filter={"cutoff_hz": 40})
    hang = idtool.validate(model, folder / "hang.csv", simulation=False)
    assert [name for name, error in hang.rms.model.items() if error is None] == list(BASE_COORDINATES)
    known = [hang.rms.model[name] for name in JOINTS]
    assert hang.rms.model["overall"] == pytest.approx(np.sqrt(np.mean(np.square(known))))
    both = idtool.validate(model, [folder / "hang.csv", folder / "stand.csv"], simulation=False)
    stand = idtool.validate(model, folder / "stand.csv", simulation=False)
    for name in BASE_COORDINATES:
        assert both.rms.model[name] == pytest.approx(stand.rms.model[name])


def test_what_contacts_leave_nothing_of_is_not_determined(folder: Path) -> None:
    """A rope that always holds the trunk, and nothing else: the weight is the rope's."""
    rope = {"name": "rope", "link": "trunk", "kind": "surface"}
    model = idtool.Model(folder / "prior.urdf", config=settings("unknown", contacts=[rope]))
    result = idtool.fit(model, folder / "short_hang.csv", quick=True)
    robot = result.whole_robot
    assert robot is not None
    assert robot.mass_standard_error is None
    assert "the logs do not determine the robot's mass" in " ".join(result.warnings)


def test_what_rounding_alone_determines_has_no_standard_error(folder: Path) -> None:
    """A rope that always holds the trunk, on the ground too: eliminating its force leaves 1e-11 of the weight."""
    content = settings("unknown")
    content["contacts"] = [
        {key: value for key, value in contact.items() if contact["name"] != "rope" or key != "flag"}
        for contact in content["contacts"]
    ]
    model = idtool.Model(folder / "prior.urdf", config=content)
    result = idtool.fit(model, [folder / "short_stand.csv", folder / "short_hang.csv"], quick=True)
    robot = result.whole_robot
    assert robot is not None
    assert robot.mass_standard_error is None
    assert robot.com_standard_error == (None, None, None)
    assert np.isnan(np.array(result.bodies["trunk"].standard_error, dtype=float)).all()
    assert result.foot_compliance is not None
    assert result.foot_compliance.standard_error is None


@pytest.mark.parametrize("contact", [{"link": "FL_hip"}, {"link": "FL_foot", "kind": "surface"}])
def test_only_legs_tell_their_contacts(folder: Path, contact: dict[str, str]) -> None:
    contacts = [{"name": "place", "flag": "auto", **contact}]
    model = idtool.Model(folder / "prior.urdf", config=settings("unknown", contacts=contacts))
    with pytest.raises(ConfigError, match="is for the base, or points on links that at least three joints move"):
        idtool.validate(model, folder / "hang.csv")


def test_support_needs_to_know_when_the_other_contacts_are_closed(folder: Path) -> None:
    contacts = [{"name": "support", "link": "trunk", "flag": "auto"}, {"name": "foot", "link": "FL_foot"}]
    model = idtool.Model(folder / "prior.urdf", config=settings("unknown", contacts=contacts))
    with pytest.raises(ConfigError, match="needs a flag or a measured force of foot"):
        idtool.validate(model, folder / "hang.csv")


def with_column(log: Path, to: Path, name: str, value: str, rows: slice) -> Path:
    """A log with another value in some rows of a column."""
    header, *lines = [line.split(",") for line in log.read_text().splitlines()]
    for line in lines[rows]:
        line[header.index(name)] = value
    to.write_text("\n".join(",".join(line) for line in [header, *lines]))
    return to


def test_one_torque_that_is_not_finite_is_left_out(folder: Path, tmp_path: Path) -> None:
    log = with_column(folder / "hang.csv", tmp_path / "log.csv", f"tau_{JOINTS[0]}", "inf", slice(100, 101))
    model = idtool.Model(folder / "prior.urdf", config=settings("unknown"))
    assert np.isfinite(idtool.validate(model, log).rms.model["overall"])


def test_orientation_of_zeros_is_named(folder: Path, tmp_path: Path) -> None:
    log = folder / "hang.csv"
    for part in "xyzw":
        log = with_column(log, tmp_path / "log.csv", f"imu_q{part}", "0", slice(None))
    model = idtool.Model(folder / "prior.urdf", config=settings("unknown"))
    with pytest.raises(LogError, match=r"the orientation of the IMU .* is zero"):
        idtool.validate(model, log)


def test_short_log_is_refused_in_one_line(folder: Path, tmp_path: Path) -> None:
    lines = (folder / "hang.csv").read_text().splitlines()
    (tmp_path / "log.csv").write_text("\n".join(lines[:100]))
    model = idtool.Model(folder / "prior.urdf", config=settings("unknown"))
    with pytest.raises(LogError, match="long"):
        idtool.fit(model, tmp_path / "log.csv", quick=True)


def test_a_fleet_needs_a_fixed_base(folder: Path) -> None:
    model = idtool.Model(folder / "prior.urdf", config=settings("unknown", pool={"own": "friction"}))
    with pytest.raises(ConfigError, match="pool needs a fixed base"):
        idtool.fit(model, [folder / "stand.csv", folder / "hang.csv"])


def test_tilt_of_gravity_is_for_a_fixed_base(folder: Path) -> None:
    tilt = {"effect": "gravity_tilt", "parameters": {"gravity": [1.0, 0.0, -9.7]}}
    model = idtool.Model(folder / "prior.urdf", config=settings("unknown", effects=[tilt]))
    with pytest.raises(ConfigError, match="gravity_tilt: needs a fixed base"):
        idtool.validate(model, folder / "hang.csv")


def test_gravity_of_the_configuration_is_not_used(folder: Path) -> None:
    """Neither to detect contacts."""
    config = settings("unknown")
    for contact in config["contacts"]:
        if contact["name"] != "rope":
            contact["flag"] = "auto"
    expected = idtool.validate(idtool.Model(folder / "prior.urdf", config=config), folder / "hang.csv")
    model = idtool.Model(folder / "prior.urdf", config={**config, "gravity": [0.0, 0.0, 0.0]})
    assert idtool.validate(model, folder / "hang.csv").rms.model == expected.rms.model
