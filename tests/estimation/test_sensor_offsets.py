"""Offsets of a wrench sensor that differ between logs, and that drift: an arm in MuJoCo."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_arm import LINKS, SENSOR, Push, urdf_text, write_log

import idtool
from idtool.common.processes import no_progress
from idtool.estimation.dataset.reduction import Factor
from idtool.estimation.dataset.sensor_offsets import with_offsets_of

OFFSETS = {
    "a.csv": np.array([3.0, -2.0, 5.0, 0.1, 0.2, -0.3]),
    "b.csv": np.array([6.0, -1.0, 2.0, 0.3, -0.2, 0.1]),
    "c.csv": np.array([-1.0, 2.0, 8.0, -0.2, 0.1, 0.4]),
}
SEEDS = dict(zip(OFFSETS, (3, 4, 5), strict=True))
DRIFT = np.array([2.0, -3.0, 2.5, 0.1, -0.1, 0.05])  # N, N m in a log
SECONDS = 8.0
CARRIED = sum(link.mass for link in LINKS if link.name in ("upper", "hand"))
NOISE = 0.1  # N


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("arm")
    heavier = urdf_text()
    for link in LINKS:
        heavier = heavier.replace(f'mass value="{link.mass}"', f'mass value="{1.3 * link.mass:g}"')
    (path / "prior.urdf").write_text(heavier)
    (path / "same").mkdir()
    (path / "drift").mkdir()
    for name, offset in OFFSETS.items():
        write_log(path / name, SECONDS, offset, seed=SEEDS[name])
        log = (path / name).read_text().splitlines()
        table = np.loadtxt(log[1:], delimiter=",")
        first = log[0].split(",").index(f"force_{SENSOR}_x")
        sensor = slice(first, first + 6)
        table[:, sensor] += OFFSETS["a.csv"] - offset
        save(path / "same" / name, log[0], table)
        table[:, sensor] += table[:, :1] / SECONDS * DRIFT
        save(path / "drift" / name, log[0], table)
    return path


def save(path: Path, header: str, table: np.ndarray[Any, Any]) -> None:
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=header, comments="")


def model(folder: Path, **sensor: Any) -> idtool.Model:
    ellipsoids = {link.name: [{"center": [0.1, 0, 0.05], "semi_axes": [0.3, 0.2, 0.2]}] for link in LINKS}
    config = {"wrench_sensors": [{"joint": SENSOR, **sensor}], "bounding_ellipsoids": ellipsoids}
    return idtool.Model(folder / "prior.urdf", config=config)


def fit(folder: Path, logs: Path, validate: Path | None = None, **sensor: Any) -> Any:
    held_out = [validate or logs / "c.csv"]
    return idtool.fit(model(folder, **sensor), [logs / "a.csv", logs / "b.csv"], validate=held_out, quick=True)


def carried_mass(result: Any) -> float:
    return float(result.bodies["upper"].mass + result.bodies["hand"].mass)


def codes(result: Any) -> list[str]:
    return [notice.code for notice in result.notices if notice.code.startswith("wrench_sensor")]


@pytest.fixture(scope="module")
def restarted(folder: Path) -> Any:
    return fit(folder, folder)


@pytest.fixture(scope="module")
def unchanged(folder: Path) -> Any:
    return fit(folder, folder / "same")


def test_each_log_has_its_own_offset(restarted: Any) -> None:
    by_log = restarted.wrench_sensors[SENSOR].by_log
    assert list(by_log) == ["a.csv", "b.csv"]
    for name, own in by_log.items():
        np.testing.assert_allclose(own.offset, OFFSETS[name], atol=0.15)
        assert own.drift is None
        distance = np.abs(np.array(own.offset) - OFFSETS[name])
        assert np.all(distance < 5 * np.array(own.standard_error))
    mean = np.mean([own.offset for own in by_log.values()], axis=0)
    np.testing.assert_allclose(restarted.wrench_sensors[SENSOR].offset, mean, atol=1e-9)
    assert carried_mass(restarted) == pytest.approx(CARRIED, rel=0.015)


def test_offset_of_a_log_for_validation_is_estimated_from_it(folder: Path, restarted: Any, unchanged: Any) -> None:
    estimated = restarted.wrench_sensor_offsets["c.csv"][SENSOR]
    np.testing.assert_allclose(estimated, OFFSETS["c.csv"], atol=0.15)
    assert restarted.rms.validation["overall"] == pytest.approx(unchanged.rms.validation["overall"], rel=0.05)
    assert codes(restarted) == ["wrench_sensor_offset_differs", "wrench_sensor_offset_reestimated"]

    restarted.save(folder / "out")
    identified = idtool.Model(folder / "out" / "identified.urdf", config=folder / "out" / "model.yaml")
    again = idtool.validate(identified, folder / "c.csv", simulation=False)
    assert again.rms.model["overall"] == pytest.approx(restarted.rms.validation["overall"], rel=1e-3)
    np.testing.assert_allclose(again.wrench_sensor_offsets["c.csv"][SENSOR], estimated, atol=1e-3)
    assert codes(again) == ["wrench_sensor_offset_reestimated"]


def test_offsets_of_several_models_are_those_of_each(restarted: Any) -> None:
    fitted = restarted._fit
    equation, noise = fitted.experiment.equation, fitted.estimate.noise
    data = fitted.experiment.reduce(no_progress)
    thetas = np.stack([fitted.estimate.theta, equation.prior, np.zeros(len(equation.prior))])
    together = with_offsets_of(equation, data, noise, thetas)
    assert np.abs(together - thetas).max() > 1.0
    for theta, changed in zip(thetas, together, strict=True):
        np.testing.assert_allclose(with_offsets_of(equation, data, noise, theta), changed, rtol=1e-9, atol=1e-9)


def test_nothing_is_lost_where_the_offset_is_the_same(folder: Path, unchanged: Any) -> None:
    common = fit(folder, folder / "same", common_offset=True)
    assert codes(unchanged) == ["wrench_sensor_offset_reestimated"]
    assert codes(common) == []
    assert common.wrench_sensor_offsets == {}
    assert unchanged.rms.validation["overall"] == pytest.approx(common.rms.validation["overall"], rel=0.05)
    assert carried_mass(unchanged) == pytest.approx(carried_mass(common), rel=0.005)
    for own in common.wrench_sensors[SENSOR].by_log.values():
        np.testing.assert_allclose(own.offset, OFFSETS["a.csv"], atol=0.15)


def test_common_offset_is_that_of_the_model(folder: Path) -> None:
    """A log after a restart then has the error that the offset makes."""
    wrong = fit(folder, folder / "same", folder / "c.csv", common_offset=True)
    change = OFFSETS["c.csv"] - OFFSETS["a.csv"]
    force = [wrong.rms.validation[f"{SENSOR}_force_{axis}"] for axis in "xyz"]
    np.testing.assert_allclose(force, np.abs(change[:3]), atol=2 * NOISE)


def test_logs_of_the_same_file_name_have_offsets_of_their_own(folder: Path) -> None:
    other = folder / "other"
    other.mkdir()
    (other / "a.csv").write_text((folder / "b.csv").read_text())
    result = idtool.fit(model(folder), [folder / "a.csv", other / "a.csv"], quick=True)
    by_log = result.wrench_sensors[SENSOR].by_log
    assert list(by_log) == ["a.csv", "a.csv (2)"]
    np.testing.assert_allclose(by_log["a.csv (2)"].offset, OFFSETS["b.csv"], atol=0.2)


def test_model_of_one_log_is_compared_with_another_by_its_own_offset(folder: Path) -> None:
    """The errors of each log's model on the other do not contain the difference of the offsets."""
    result = idtool.fit(model(folder), [folder / "a.csv", folder / "b.csv"])
    assert np.max(result.repeatability.cross_rms) < 2.0


def test_drift_is_found_and_identified(folder: Path, unchanged: Any) -> None:
    drifting = fit(folder, folder / "drift")
    ignored = fit(folder, folder / "drift", drift=False)
    assert codes(drifting) == ["wrench_sensor_drift", "wrench_sensor_offset_reestimated"]
    assert "wrench_sensor_drift" not in codes(ignored)
    for own in drifting.wrench_sensors[SENSOR].by_log.values():
        np.testing.assert_allclose(own.drift, DRIFT, atol=0.3)
        np.testing.assert_allclose(own.offset, OFFSETS["a.csv"], atol=0.2)
    validation = drifting.rms.validation["overall"]
    assert validation == pytest.approx(unchanged.rms.validation["overall"], rel=0.05)
    assert ignored.rms.validation["overall"] > 2 * validation
    assert carried_mass(drifting) == pytest.approx(CARRIED, rel=0.015)

    drifting.save(folder / "out_drift")
    identified = idtool.Model(folder / "out_drift" / "identified.urdf", config=folder / "out_drift" / "model.yaml")
    again = idtool.validate(identified, folder / "drift" / "c.csv", simulation=False)
    assert again.rms.model["overall"] == pytest.approx(validation, rel=1e-3)


def test_drift_is_estimated_in_the_last_part_of_a_log(folder: Path) -> None:
    drifting = idtool.fit(model(folder), folder / "drift" / "a.csv", quick=True)
    steady = idtool.fit(model(folder), folder / "same" / "a.csv", quick=True)
    assert "wrench_sensor_drift" in codes(drifting)
    assert codes(steady) == []
    assert drifting.rms.validation["overall"] == pytest.approx(steady.rms.validation["overall"], rel=0.1)


def test_offsets_beside_an_unknown_contact_force(folder: Path) -> None:
    """The force on the hand is eliminated, which takes the sensor's offset from its own rows to others."""
    push = Push(np.array([12.0, -8.0, 15.0, 0.0, 0.0, 0.0]), np.array([0.2, 0.01, 0.03]))
    pushed = folder / "pushed"
    pushed.mkdir()
    for name, offset in OFFSETS.items():
        write_log(pushed / name, SECONDS, offset, seed=SEEDS[name], push=push)
    contact = {"name": "tool", "link": "hand", "point": [*push.point], "flag": "contact_tool", "widen": 0.01}
    config = {**model(folder).settings.model_dump(exclude_unset=True), "contacts": [contact]}
    with_contact = idtool.Model(folder / "prior.urdf", config=config)
    logs = [pushed / "a.csv", pushed / "b.csv"]
    result = idtool.fit(with_contact, logs, validate=[pushed / "c.csv"], quick=True)
    assert codes(result) == ["wrench_sensor_offset_differs", "wrench_sensor_offset_reestimated"]
    for name, own in result.wrench_sensors[SENSOR].by_log.items():
        np.testing.assert_allclose(own.offset, OFFSETS[name], atol=0.2)
    np.testing.assert_allclose(result.wrench_sensor_offsets["c.csv"][SENSOR], OFFSETS["c.csv"], atol=0.2)
    train, validation = result.rms.train, result.rms.validation
    for axis in "xyz":
        row = f"{SENSOR}_force_{axis}"
        assert validation[row] == pytest.approx(train[row], rel=0.3)


@pytest.mark.slow
def test_study_compares_on_a_log_with_another_offset(folder: Path) -> None:
    logs = [folder / "a.csv", folder / "b.csv"]
    study = idtool.study(model(folder), logs, validate=[folder / "c.csv"], draws=5)
    same = [folder / "same" / "a.csv", folder / "same" / "b.csv"]
    expected = idtool.study(model(folder), same, validate=[folder / "same" / "c.csv"], draws=5)
    for name, curve in study.learning.curves.items():
        assert curve.median[-1] == pytest.approx(expected.learning.curves[name].median[-1], rel=0.1)


def test_base_parameters_are_as_many_as_with_one_log(folder: Path) -> None:
    """A second log adds an offset of its own, which is no parameter of the robot."""
    one_log = idtool.fit(model(folder), folder / "a.csv")
    two_logs = idtool.fit(model(folder), [folder / "a.csv", folder / "b.csv"])
    assert len(two_logs.base_parameters.parameters) == len(one_log.base_parameters.parameters)


def test_factor_without_columns_is_that_of_rows_without_their_means(rng: np.random.Generator) -> None:
    rows = rng.normal(size=(50, 5))
    with_ones = np.column_stack([rows[:, :2], np.ones(50), rows[:, 2:]])
    left = Factor.from_columns(with_ones.T).without_columns(np.array([2]))
    centred = rows - rows.mean(axis=0)
    np.testing.assert_allclose(left.R.T @ left.R, centred.T @ centred, atol=1e-12)
