"""An arm in MuJoCo with a sensor of force and moment at a fixed joint."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_arm import CHANNELS, COULOMB, JOINTS, LINKS, SENSOR, urdf_text, write_log

import idtool
from idtool.common.exceptions import ConfigError, LogError

KP = 100.0  # N m/rad
OFFSET = np.array([3.0, -2.0, 5.0, 0.1, 0.2, -0.3])
TRUE_MASS = {link.name: link.mass for link in LINKS}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("arm")
    write_log(path / "arm.csv", 8.0, OFFSET)
    write_log(path / "without_torque.csv", 8.0, OFFSET, with_torque=False)
    (path / "arm.urdf").write_text(urdf_text())
    heavier = urdf_text()
    for mass in TRUE_MASS.values():
        heavier = heavier.replace(f'mass value="{mass}"', f'mass value="{1.3 * mass:g}"')
    (path / "prior.urdf").write_text(heavier)
    return path


def settings(**sensor: Any) -> dict[str, Any]:
    ellipsoids = {link.name: [{"center": [0.1, 0, 0.05], "semi_axes": [0.3, 0.2, 0.2]}] for link in LINKS}
    return {"wrench_sensors": [{"joint": SENSOR, **sensor}], "bounding_ellipsoids": ellipsoids}


def test_sensor_determines_what_it_carries_and_its_own_offset(folder: Path) -> None:
    """The wrench of gravity, turned in all directions, tells the mass, which the joints' torque alone does not."""
    result = idtool.fit(idtool.Model(folder / "prior.urdf", config=settings()), folder / "arm.csv", quick=True)
    carried = result.bodies["upper"].mass + result.bodies["hand"].mass
    assert carried == pytest.approx(TRUE_MASS["upper"] + TRUE_MASS["hand"], rel=0.015)
    sensor = result.wrench_sensors[SENSOR]
    np.testing.assert_allclose(sensor.offset, OFFSET, atol=0.15)
    for name in JOINTS:
        assert result.friction[name].coulomb == pytest.approx(COULOMB, abs=0.01)

    result.save(folder / "out")
    model = idtool.Model(folder / "out" / "identified.urdf", config=folder / "out" / "model.yaml")
    again = idtool.validate(model, folder / "arm.csv").rms.model
    for name in (*JOINTS, f"{SENSOR}_force_x", f"{SENSOR}_moment_z"):
        assert again[name] == pytest.approx(result.rms.validation[name], rel=0.2)


def test_other_sign_and_other_frame_of_the_same_reading(folder: Path) -> None:
    """Given as the wrench on the parent, in the frame of a link that is fixed to the child."""
    log = (folder / "arm.csv").read_text().splitlines()
    names = log[0].split(",")
    table = np.loadtxt(log[1:], delimiter=",")
    first = names.index(f"force_{SENSOR}_x")
    force, moment = table[:, first : first + 3], table[:, first + 3 : first + 6]
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # of the plate in the upper half, a quarter turn
    p = np.array([0.02, 0.0, 0.03])
    on_parent = np.hstack([-force @ R, -(moment - np.cross(p, force)) @ R])
    np.savetxt(
        folder / "plate.csv",
        np.hstack([table[:, :first], on_parent]),
        fmt="%.9g",
        delimiter=",",
        header=",".join(names),
        comments="",
    )
    plate = (
        '<link name="plate"/><joint name="plate_joint" type="fixed">'
        '<origin xyz="0.02 0 0.03" rpy="0 0 1.5707963267949"/>'
        '<parent link="upper"/><child link="plate"/></joint></robot>'
    )
    (folder / "plate.urdf").write_text(urdf_text().replace("</robot>", plate))
    given = settings(sign=-1, frame="plate", offset="none")
    turned = idtool.validate(idtool.Model(folder / "plate.urdf", config=given), folder / "plate.csv").rms.model
    straight = idtool.Model(folder / "arm.urdf", config=settings(offset="none"))
    expected = idtool.validate(straight, folder / "arm.csv").rms.model
    for name, rms in expected.items():
        assert turned[name] == pytest.approx(rms, rel=1e-5)


@pytest.mark.parametrize("sign", [1, -1])
def test_sensor_with_the_opposite_sign_is_named(folder: Path, sign: int) -> None:
    model = idtool.Model(folder / "prior.urdf", config=settings(sign=sign))
    notices = idtool.validate(model, folder / "arm.csv", simulation=False).notices
    found = [(notice.subject, notice.advice) for notice in notices if notice.code == "wrench_sensor_sign"]
    assert found == ([] if sign == 1 else [(SENSOR, "set sign: 1")])


def test_message_about_one_of_several_logs_names_the_sensor(folder: Path) -> None:
    model = idtool.Model(folder / "prior.urdf", config=settings(sign=-1))
    logs = [folder / "arm.csv", folder / "without_torque.csv"]
    notices = idtool.validate(model, logs, simulation=False).notices
    (notice, _) = [one for one in notices if one.code == "wrench_sensor_sign"]
    assert notice.sentence.startswith(f"arm.csv: {SENSOR}: the force of this wrench sensor is opposite")


def test_joints_without_torque_are_left_out(folder: Path) -> None:
    """The sensor alone tells the bodies that it carries; those below it keep their prior."""
    model = idtool.Model(folder / "prior.urdf", config=settings())
    result = idtool.fit(model, folder / "without_torque.csv", quick=True)
    carried = result.bodies["upper"].mass + result.bodies["hand"].mass
    assert carried == pytest.approx(TRUE_MASS["upper"] + TRUE_MASS["hand"], rel=0.015)
    assert result.bodies["shoulder"].mass == pytest.approx(1.3 * TRUE_MASS["shoulder"], rel=1e-3)
    rms = result.rms.train
    assert [name for name, error in rms.items() if error is None] == list(JOINTS)
    known = [error for name, error in rms.items() if error is not None and name != "overall"]
    assert rms["overall"] == pytest.approx(np.sqrt(np.mean(np.square(known))))
    assert "torque_unknown" in [notice.code for notice in result.notices]
    for joint in JOINTS:
        friction = result.friction[joint]
        assert (friction.viscous, friction.coulomb, friction.offset) == (None, None, None)


def test_torque_that_sensors_replace_is_no_fault_of_the_log(folder: Path, tmp_path: Path) -> None:
    """Neither if it was not logged, nor if a driver without a torque sensor wrote zeros."""
    header, *lines = (folder / "without_torque.csv").read_text().splitlines()
    names = ",".join(f"tau_{name}" for name in JOINTS)
    zeros = tmp_path / "zeros.csv"
    zeros.write_text("\n".join([f"{header},{names}", *(f"{line},0,0,0" for line in lines)]))
    for log in (folder / "without_torque.csv", zeros):
        notices = idtool.inspect(log, config=settings()).notices
        assert {one.code for one in notices} == {"missing_velocity", "torque_unknown"}
    model = idtool.Model(folder / "arm.urdf", config=settings())
    diagnosis = idtool.diagnose(model, folder / "without_torque.csv", effects=["payload"])
    assert not diagnosis.data_faults


def test_inspect_lists_the_sensors_that_replace_the_torque(folder: Path) -> None:
    result = idtool.inspect(folder / "without_torque.csv")
    (sensor,) = [one for one in result.sensors if one.name == SENSOR]
    assert (sensor.kind, sensor.channels) == ("wrench", CHANNELS)
    missing = [notice for notice in result.notices if notice.code == "missing_torque"]
    assert [notice.subject for notice in missing] == list(JOINTS)
    assert {(notice.severity, notice.advice) for notice in missing} == {
        ("warning", "a wrench sensor can replace it for the links that it carries: list it under `wrench_sensors`")
    }


def test_notices_are_those_of_a_robot_with_sensors(folder: Path) -> None:
    """The sensor tells a mass, and instrumental variables are refused beside it."""
    text = urdf_text()
    for mass in (TRUE_MASS["upper"], TRUE_MASS["hand"]):
        text = text.replace(f'mass value="{mass}"', f'mass value="{3 * mass:g}"')
    (folder / "heavy.urdf").write_text(text)
    model = idtool.Model(folder / "heavy.urdf", config=settings())
    notices = {one.code: one for one in idtool.fit(model, folder / "without_torque.csv", simulation=False).notices}
    assert notices["total_mass_changed"].message.endswith("kg in the prior")
    unchecked = notices["bias_unchecked"]
    assert unchecked.message.endswith("this needs a fixed base and no wrench sensors")
    assert not unchecked.advice


def test_error_of_a_joint_is_of_the_logs_with_its_torque(folder: Path) -> None:
    model = idtool.Model(folder / "prior.urdf", config=settings())
    alone = idtool.validate(model, folder / "arm.csv", simulation=False)
    both = idtool.validate(model, [folder / "without_torque.csv", folder / "arm.csv"], simulation=False)
    for name in JOINTS:
        assert both.rms.model[name] == pytest.approx(alone.rms.model[name])
        assert both.nrms[name] == pytest.approx(alone.nrms[name])


def test_delay_of_a_controller_is_fitted_beside_a_sensor(folder: Path) -> None:
    """The torque of the log, as the command of a controller."""
    log = (folder / "arm.csv").read_text().splitlines()
    names = log[0].split(",")
    table = np.loadtxt(log[1:], delimiter=",")
    for joint in JOINTS:
        table[:, names.index(f"tau_{joint}")] += table[:, names.index(f"q_{joint}")]  # by a gain of 1 N m/rad
    header = log[0].replace("tau_", "qcmd_")
    np.savetxt(folder / "commands.csv", table, fmt="%.9g", delimiter=",", header=header, comments="")
    controller = {"kp": dict.fromkeys(JOINTS, 1.0)}
    model = idtool.Model(folder / "prior.urdf", config={**settings(), "controller": controller})
    result = idtool.fit(model, folder / "commands.csv", quick=True)
    carried = result.bodies["upper"].mass + result.bodies["hand"].mass
    assert carried == pytest.approx(TRUE_MASS["upper"] + TRUE_MASS["hand"], rel=0.015)
    assert result.controller is not None
    assert result.controller.delay == pytest.approx(0.0, abs=1e-3)


def test_diagnosis_names_friction_beside_a_sensor(folder: Path) -> None:
    """Coulomb friction of one joint that the model lacks, and nothing on the rows of the sensor."""
    friction = {name: {"viscous": True, "coulomb": name != "lift"} for name in JOINTS}
    model = idtool.Model(folder / "arm.urdf", config={**settings(), "friction": friction})
    diagnosis = idtool.diagnose(model, folder / "arm.csv", effects=["coulomb_friction", "torque_offset", "payload"])
    (step,) = diagnosis.steps
    assert (step.effect, step.joint) == ("coulomb_friction", "lift")
    assert step.parameters["coulomb"] == pytest.approx(COULOMB, rel=0.05)


@pytest.mark.parametrize(
    ("sensor", "message"),
    [
        ({"joint": "lift"}, "is not a fixed joint"),
        ({"joint": "uper_ft"}, f"did you mean {SENSOR}"),
        ({"joint": SENSOR, "frame": "lower"}, "moves against link upper"),
        ({"joint": SENSOR, "frame": "plate"}, "is not a link"),
    ],
)
def test_sensor_at_a_wrong_place_is_refused(folder: Path, sensor: dict[str, Any], message: str) -> None:
    model = idtool.Model(folder / "arm.urdf", config={"wrench_sensors": [sensor]})
    with pytest.raises(ConfigError, match=message):
        idtool.validate(model, folder / "arm.csv")


def with_readings(folder: Path, tmp_path: Path, first: int, step: int, reading: str) -> Path:
    """A log with another reading of the sensor in some samples."""
    header, *lines = [line.split(",") for line in (folder / "arm.csv").read_text().splitlines()]
    of_sensor = [header.index(name) for name in CHANNELS]
    for line in lines[first::step]:
        for column in of_sensor:
            line[column] = reading
    (tmp_path / "log.csv").write_text("\n".join(",".join(line) for line in [header, *lines]))
    return tmp_path / "log.csv"


def test_band_is_that_of_a_slow_sensor(folder: Path, tmp_path: Path) -> None:
    """A fifth of its rate, as that of the joints."""
    log = with_readings(folder, tmp_path, 1, 2, "")
    text = log.read_text().splitlines()
    log.write_text("\n".join([text[0], *text[1::5]]))  # joints at 200 Hz, the sensor at 100 Hz
    model = idtool.Model(folder / "arm.urdf", config=settings())
    assert idtool.validate(model, log, simulation=False).band_hz == pytest.approx(20)


def test_reading_that_no_sensor_gives_is_refused(folder: Path, tmp_path: Path) -> None:
    log = with_readings(folder, tmp_path, 3000, 10000, "1e200")
    model = idtool.Model(folder / "arm.urdf", config=settings())
    with pytest.raises(LogError, match="channel force_upper_ft_x reaches 1e"):
        idtool.validate(model, log)


def test_sensor_whose_reading_never_changes_is_refused(folder: Path, tmp_path: Path) -> None:
    """It would be taken for bodies without mass."""
    log = with_readings(folder, tmp_path, 0, 1, "0")
    model = idtool.Model(folder / "arm.urdf", config=settings())
    with pytest.raises(LogError, match="the wrench sensor at upper_ft has a constant reading"):
        idtool.fit(model, log, quick=True)


def found_by_inspection(log: Path) -> list[tuple[str, str, str | None]]:
    """Code, severity and subject of the findings on sensors."""
    notices = idtool.inspect(log, config=settings()).notices
    return [(one.code, one.severity, one.subject) for one in notices if "sensor" in one.code]


def test_inspection_names_what_is_wrong_with_a_sensor(folder: Path, tmp_path: Path) -> None:
    assert found_by_inspection(folder / "arm.csv") == []
    dead = with_readings(folder, tmp_path, 0, 1, "0")
    assert found_by_inspection(dead) == [("wrench_sensor_dead", "problem", SENSOR)]
    empty = with_readings(folder, tmp_path, 0, 1, "")
    assert found_by_inspection(empty) == [("sensor_unusable", "problem", SENSOR)]
    header, *lines = (folder / "arm.csv").read_text().splitlines()
    (tmp_path / "other_name.csv").write_text("\n".join([header.replace(f"_{SENSOR}_", "_wrist_"), *lines]))
    assert found_by_inspection(tmp_path / "other_name.csv") == [("sensor_unusable", "problem", SENSOR)]
    columns = [header.split(",").index(name) for name in CHANNELS]
    for i in range(3000, 3300):
        cells = lines[i].split(",")
        for column in columns:
            cells[column] = "nan"
        lines[i] = ",".join(cells)
    (tmp_path / "gap.csv").write_text("\n".join([header, *lines]))
    assert found_by_inspection(tmp_path / "gap.csv") == [("sensors_missing", "note", SENSOR)]


def test_missing_channel_is_named(folder: Path) -> None:
    model = idtool.Model(folder / "arm.urdf", config=settings(topic="/ft"))
    with pytest.raises(LogError, match="has no channel force_ft_x"):
        idtool.validate(model, folder / "arm.csv")


def test_commands_that_need_joints_alone_refuse_a_sensor(folder: Path) -> None:
    model = idtool.Model(folder / "arm.urdf", config=settings())
    with pytest.raises(ConfigError, match=r"wrench_sensors: are not for idtool diagnose --against"):
        idtool.diagnose(model, folder / "arm.csv", against=folder / "without_torque.csv")


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (
            {"wrench_sensors": [{"joint": SENSOR, "offset": [1, 2, 3]}]},
            r"offset: \[1, 2, 3\] is not an offset",
        ),
        (
            {"wrench_sensors": [{"joint": SENSOR, "offset": 6 * ["x"]}]},
            "give fit, none, or six numbers",
        ),
        ({"base": {"imu": {"delay": 2}}}, "delay: 2 is not a delay; give auto, or a number in s of at most 1"),
        ({"base": {"imu": {"delay": True}}}, "base.imu.delay: True is not a delay"),
        ({"controller": {"kp": {"lift": 1}, "delay": True}}, "controller.delay: True is not a delay"),
        ({"filter": {"cutoff_hz": True}}, "filter.cutoff_hz: true is not a number"),
        ({"contacts": [{"name": "Foot", "link": "hand", "flag": ""}]}, "contacts.0.flag: is empty; give a name"),
        ({"wrench_sensors": [{"joint": SENSOR, "channel": " "}]}, "wrench_sensors.0.channel: is empty"),
        ({"contacts": 2 * [{"name": "Foot", "link": "hand"}]}, "contacts: Foot is listed twice"),
    ],
)
def test_value_that_does_not_fit_is_named(folder: Path, config: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        idtool.validate(idtool.Model(folder / "arm.urdf", config=config), folder / "arm.csv")
