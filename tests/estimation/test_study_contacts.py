"""`study` and `adapt` of robots that touch something, in MuJoCo."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ground.logs import config_text, write_csv
from ground.quadruped import JOINTS as QUADRUPED_JOINTS
from ground.robot import prior_robot
from ground.robot import urdf_text as quadruped_urdf
from prescribed_motions import silent
from quadruped_recordings import TRUTH, record_quadruped
from sensor_arm import COULOMB, JOINTS, LINKS, SENSOR, Push, urdf_text, write_log

import idtool
from idtool.api.data import load_experiment
from idtool.common.exceptions import ConfigError
from idtool.common.safe_yaml import parse_yaml
from idtool.estimation.dataset.experiment import Experiment
from idtool.estimation.evaluation.torque_errors import evaluate
from idtool.estimation.study.learning import gather, held_out, rms
from idtool.robot.model import BASE_COORDINATES

PUSH = Push(np.array([12.0, -8.0, 15.0, 0.0, 0.0, 0.0]), np.array([0.2, 0.01, 0.03]))
TOOL = {"name": "tool", "link": "hand", "point": [*PUSH.point], "flag": "contact_tool", "widen": 0.01}
HAND = LINKS[-1]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("robots")
    write_log(path / "touched.csv", 8.0, np.zeros(6), push=PUSH)
    write_log(path / "without_torque.csv", 8.0, np.zeros(6), with_torque=False)
    for kind in ("stand", "hang"):
        write_csv(path / f"{kind}.csv", record_quadruped(kind, 4.0))
    lighter = urdf_text()
    for link in LINKS:
        lighter = lighter.replace(f'mass value="{link.mass}"', f'mass value="{0.8 * link.mass:g}"')
    (path / "arm.urdf").write_text(lighter)
    (path / "quadruped.urdf").write_text(quadruped_urdf(prior_robot(TRUTH, 0)))
    return path


def arm(folder: Path, **config: Any) -> idtool.Model:
    ellipsoids = {link.name: [{"center": [0.1, 0, 0.05], "semi_axes": [0.3, 0.2, 0.2]}] for link in LINKS}
    return idtool.Model(folder / "arm.urdf", config={"bounding_ellipsoids": ellipsoids, **config})


def quadruped(folder: Path, logs: Sequence[str], validate: Sequence[str]) -> Experiment:
    content = parse_yaml(Path("quadruped.yaml"), config_text(TRUTH, "unknown").encode())
    model = idtool.Model(folder / "quadruped.urdf", config=dict(content))
    return load_experiment(model, [folder / log for log in logs], [folder / log for log in validate])


@pytest.mark.slow
def test_study_of_an_arm_that_is_touched(folder: Path) -> None:
    """Its sets see the rows behind the elimination of the force; without this, all of them would be wrong."""
    study = idtool.study(arm(folder, contacts=[TOOL]), folder / "touched.csv", draws=5)
    fit = idtool.fit(arm(folder, contacts=[TOOL]), folder / "touched.csv", quick=True)
    assert fit.rms.validation is not None
    for name, entry in study.sets.items():
        assert entry.rms.validation["overall"] == pytest.approx(fit.rms.validation["overall"], rel=0.1), name
    curves = study.learning.curves
    assert set(curves) == {"none", "semi", "full", "ellipsoid"}
    for name, curve in curves.items():
        last = curve.median[-1]
        assert last == pytest.approx(study.sets[name].rms.validation["overall"], rel=0.05)
        assert curve.median[0] is not None
        assert curve.median[0] > 5 * last
    assert study.adaptation.error["ellipsoid"][-1] < 0.5
    assert not [notice for notice in study.notices if "simulated" in notice.message]
    ignored = idtool.study(arm(folder), folder / "touched.csv", draws=5)
    assert ignored.sets["none"].rms.validation["overall"] > 10 * study.sets["none"].rms.validation["overall"]


@pytest.mark.slow
def test_study_leaves_out_joints_without_torque(folder: Path) -> None:
    model = arm(folder, wrench_sensors=[{"joint": SENSOR}])
    study = idtool.study(model, folder / "without_torque.csv", draws=5)
    for entry in study.sets.values():
        errors = entry.rms.validation
        assert all(errors[joint] is None for joint in JOINTS)
        assert errors[f"{SENSOR}_force_x"] is not None
        assert errors["overall"] == pytest.approx(study.learning.curves["none"].median[-1], rel=0.05)


@pytest.mark.parametrize(("log", "is_compared"), [("stand.csv", True), ("hang.csv", False)])
def test_held_out_rows_of_a_floating_base_are_those_of_the_evaluation(
    folder: Path, log: str, is_compared: bool
) -> None:
    """While the robot hangs, the rope takes the whole of the rows of the base."""
    experiment = quadruped(folder, ["stand.csv"], [log])
    equation = experiment.equation
    found = rms(held_out(experiment, silent), equation.active(), equation.prior)
    errors = evaluate(experiment, {"model": equation.prior}, True, silent).errors["model"].rms(equation.joints)
    np.testing.assert_allclose(found, list(errors.values()), rtol=0.03)
    base = dict(zip(equation.joints, found, strict=False))
    assert all(np.isfinite(base[name]) == is_compared for name in BASE_COORDINATES)


def test_samples_of_a_floating_base_are_all_of_the_training_data(folder: Path) -> None:
    experiment = quadruped(folder, ["stand.csv", "hang.csv"], ["hang.csv"])
    total, pool = gather(experiment, silent)
    expected = experiment.reduce(silent)
    drawn = pool.reduction(np.arange(len(pool)))
    assert pool.are_all
    for data in (total, drawn):
        for own, theirs in zip(data, expected, strict=True):
            assert own.rows == pytest.approx(theirs.rows)
            scale = np.sqrt(np.diag(theirs.R.T @ theirs.R).clip(1e-30))
            difference = (own.R.T @ own.R - theirs.R.T @ theirs.R) / scale / scale[:, None]
            assert np.abs(difference).max() < 1e-8


def test_study_needs_held_out_rows(folder: Path) -> None:
    """A wrench on the hand explains the torque of three joints."""
    model = arm(folder, contacts=[{**TOOL, "kind": "surface"}])
    header, *rows = (folder / "touched.csv").read_text().splitlines()
    column = header.split(",").index("contact_tool")
    lines = [header]
    for row in rows:
        cells = row.split(",")
        cells[column] = "1"
        lines.append(",".join(cells))
    (folder / "always.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(ConfigError, match="--holdout: in the held-out data, unknown contact forces can explain all"):
        idtool.study(model, folder / "touched.csv", validate=folder / "always.csv", draws=5)


def test_adapt_finds_the_arm_in_spite_of_the_touch(folder: Path) -> None:
    result = idtool.adapt(arm(folder, contacts=[TOOL]), folder / "touched.csv", forgetting=np.inf)
    hand = result.final.bodies["hand"]
    assert hand.mass * hand.com[0] == pytest.approx(HAND.mass * HAND.com[0], rel=0.02)
    for joint in JOINTS:
        assert result.final.friction[joint].coulomb == pytest.approx(COULOMB, abs=0.006)
    misled = idtool.adapt(arm(folder), folder / "touched.csv", forgetting=np.inf)
    assert misled.prediction_rms["overall"] > 10 * (result.prediction_rms["overall"] or np.nan)


def test_adapt_finds_what_a_wrench_sensor_carries_without_torque(folder: Path) -> None:
    model = arm(folder, wrench_sensors=[{"joint": SENSOR}])
    result = idtool.adapt(model, folder / "without_torque.csv", forgetting=np.inf)
    carried = result.final.bodies["upper"].mass + result.final.bodies["hand"].mass
    assert carried == pytest.approx(sum(link.mass for link in LINKS[2:]), rel=0.02)
    assert all(result.prediction_rms[joint] is None for joint in JOINTS)
    assert set(result.final.friction) == set(JOINTS)


def test_adapt_weighs_a_robot_on_its_feet(folder: Path) -> None:
    content = parse_yaml(Path("quadruped.yaml"), config_text(TRUTH, "measured").encode())
    model = idtool.Model(folder / "quadruped.urdf", config=dict(content))
    result = idtool.adapt(model, folder / "stand.csv", forgetting=np.inf)
    mass = sum(body.mass for body in result.final.bodies.values())
    assert mass == pytest.approx(TRUTH.mass, rel=0.01)
    assert set(result.final.friction) == set(QUADRUPED_JOINTS)
    assert all(body.realizable for body in result.final.bodies.values())
