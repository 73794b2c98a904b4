"""Fits to logs of several robots of one type: one model of the bodies, friction of their own, odd robots named."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import LEG, idtool
from figures import assert_same_figures
from fleets import write_logs
from paths import SAMPLES

import idtool as package
from idtool.estimation.dataset.equality_constraints import EqualityConstraints, equality_constraints
from idtool.estimation.dataset.experiment import prepare
from idtool.estimation.dataset.pooled_model import pooled_model
from idtool.estimation.dataset.robots_of_logs import robots_of_logs
from idtool.robot.config import read_config
from idtool.robot.config.pool import Pool
from idtool.robot.urdf.reading import read_robot

FRICTION = {  # viscous and Coulomb, of abad, hip and knee
    "ada": (np.array([0.10, 0.12, 0.15]), np.array([0.30, 0.40, 0.35])),
    "bob": (np.array([0.11, 0.10, 0.14]), np.array([0.28, 0.42, 0.33])),
    "cleo": (np.array([0.10, 0.12, 0.15]), np.array([0.30, 0.90, 0.35])),  # its hip is worn
    "dan": (np.array([0.12, 0.11, 0.15]), np.array([0.31, 0.40, 0.36])),  # it carries a payload
}
JOINTS = ("abad", "hip", "knee")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The leg without rotors, and two logs of each robot in a folder of its own."""
    folder = tmp_path_factory.mktemp("fleet")
    shutil.copy(LEG, folder / "leg.urdf")
    (folder / "leg.yaml").write_text(yaml.safe_dump(settings(own="friction")))
    for i, (name, friction) in enumerate(FRICTION.items()):
        write_logs(folder / name, LEG, friction, (2 * i, 2 * i + 1), payload=0.3 if name == "dan" else 0.0)
    return folder


def settings(**pool: object) -> dict[str, Any]:
    config = yaml.safe_load((SAMPLES / "leg.yaml").read_text())
    del config["rotors"]
    return {**config, "pool": pool}


@pytest.fixture(scope="module")
def fitted(folder: Path) -> package.FitResult:
    return package.fit(folder / "leg.urdf", sorted(folder.glob("*/*.mcap")))


def test_each_robot_has_its_own_friction(fitted: package.FitResult) -> None:
    assert fitted.fleet is not None
    assert set(fitted.fleet.robots) == set(FRICTION)
    for name, (viscous, coulomb) in FRICTION.items():
        if name == "dan":
            continue
        robot = fitted.fleet.robots[name]
        for j, joint in enumerate(JOINTS):
            assert robot.friction[joint].viscous == pytest.approx(viscous[j], abs=2e-3)
            assert robot.friction[joint].coulomb == pytest.approx(coulomb[j], abs=5e-3)
        assert robot.rms < 0.03
    mean = np.mean([robot.friction["hip"].coulomb for robot in fitted.fleet.robots.values()])
    assert fitted.friction["hip"].coulomb == pytest.approx(mean)


def test_robots_that_stand_out_are_named(fitted: package.FitResult) -> None:
    """One by its friction, one by its bodies, which do not spoil those of the others."""
    assert fitted.fleet is not None
    assert {name for name, robot in fitted.fleet.robots.items() if robot.outliers} == {"cleo", "dan"}
    (friction,) = fitted.fleet.robots["cleo"].outliers
    assert friction.startswith("Coulomb friction of hip is 0.9")
    (bodies,) = fitted.fleet.robots["dan"].outliers
    assert bodies.endswith("less error: its bodies probably differ, as with a load")
    subjects = [notice.subject for notice in fitted.notices if notice.code == "robot_stands_out"]
    assert subjects == ["cleo", "dan"]
    prior = read_robot(LEG).links["shank_link"]
    assert prior is not None
    assert fitted.bodies["shank_link"].pi[1:4] == pytest.approx(prior[1:4], abs=2e-3)


def test_standard_errors_are_those_of_each_robot(fitted: package.FitResult) -> None:
    """Friction lies within a few of them; they are larger for the robot with another body."""
    assert fitted.fleet is not None
    errors = {}
    for name, robot in fitted.fleet.robots.items():
        error = robot.friction["hip"].standard_error.coulomb
        assert error is not None
        errors[name] = error
        assert robot.friction["hip"].coulomb == pytest.approx(FRICTION[name][1][1], abs=max(6 * error, 5e-3))
    assert errors["dan"] > 10 * max(errors[name] for name in ("ada", "bob", "cleo"))


def test_models_of_the_robots_are_written(folder: Path, tmp_path: Path) -> None:
    """Each predicts its own logs; the page shows the fleet."""
    logs = sorted(folder.glob("*/*.mcap"))
    run = idtool("fit", folder / "leg.urdf", *logs, "--quick", "--out", tmp_path, "--json")
    assert run.code == 0, run.err
    assert {path.name for path in (tmp_path / "robots").iterdir()} == set(FRICTION)
    for name in ("ada", "cleo"):
        model = tmp_path / "robots" / name / "identified.urdf"
        own = package.validate(model, sorted((folder / name).glob("*.mcap")), simulation=False)
        others = package.validate(model, sorted((folder / "bob").glob("*.mcap")), simulation=False)
        assert own.rms.model["overall"] == pytest.approx(run.json["fleet"]["robots"][name]["rms"], rel=0.3)
        assert others.rms.model["overall"] > 2 * own.rms.model["overall"] or name == "ada"
    assert "Robots of the fleet" in (tmp_path / "report.html").read_text()


def test_robots_by_patterns(folder: Path, tmp_path: Path, fitted: package.FitResult) -> None:
    """The same logs in one folder."""
    patterns: dict[str, list[str]] = {}
    logs = []
    for log in sorted(folder.glob("*/*.mcap")):
        logs.append(Path(shutil.copy(log, tmp_path / f"{log.parent.name}_{log.name}")))
        patterns[log.parent.name] = [f"{log.parent.name}_*"]
    model = package.Model(LEG, settings(own=["friction"], robots=patterns))
    own = package.fit(model, logs)
    assert own.fleet is not None
    assert fitted.fleet is not None
    for name, robot in fitted.fleet.robots.items():
        friction = robot.friction["hip"].coulomb
        assert own.fleet.robots[name].friction["hip"].coulomb == pytest.approx(friction, rel=1e-9)


def test_a_fleet_on_a_cluster_is_that_of_one_process(folder: Path, fitted: package.FitResult) -> None:
    logs = sorted(folder.glob("*/*.mcap"))
    own = package.fit(folder / "leg.urdf", logs, cluster="local:1").to_json()
    expected = fitted.to_json()
    assert_same_figures(own["fleet"]["robots"], expected["fleet"]["robots"], "robots")


BAD = {
    "one robot": ({"own": "friction"}, "pool: all logs are of one robot, ada"),
    "a robot without logs": ({"robots": {"ada": ["run*"], "eve": ["eve*"]}}, "pool.robots: eve: no log is of this"),
    "a log of two": ({"robots": {"a": ["run*"], "b": ["*.mcap"]}}, "pool.robots: the log {log} is of a, b"),
    "a log of none": ({"robots": {"a": ["run0*"]}}, "pool.robots: the log {other} is of none of the robots"),
    "a path": ({"robots": {"../a": ["run0*"], "b": ["run1*"]}}, "pool.robots: ../a: cannot be the name of a folder"),
    "an effect that is not there": (
        {"own": "payload", "robots": {"a": ["run0*"], "b": ["run1*"]}},
        "pool.own: payload: has no parameters in this model",
    ),
    "the bodies": (
        {"own": "rigid_body", "robots": {"a": ["run0*"], "b": ["run1*"]}},
        "pool.own: rigid_body: bodies are what all robots share",
    ),
    "nothing of its own": ({"own": []}, "pool.own: is empty; list friction, or effects"),
    "shared friction": ({"shared": "friction"}, "pool.shared: "),
}


@pytest.mark.parametrize(("pool", "message"), BAD.values(), ids=BAD)
def test_pools_that_cannot_be_used(folder: Path, tmp_path: Path, pool: dict[str, object], message: str) -> None:
    config = tmp_path / "leg.yaml"
    config.write_text(yaml.safe_dump(settings(**pool)))
    logs = sorted((folder / "ada").glob("*.mcap"))
    refused = idtool("fit", LEG, *logs, "--config", config, "--out", tmp_path / "out")
    assert refused.code == 2
    expected = message.format(log=logs[0], other=logs[1])
    assert refused.err.startswith(f"error: {config}: {expected}"), refused.err
    assert refused.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_robots_of_logs() -> None:
    """By folder, or by patterns of the ends of paths."""
    by_folder = [Path("/fleet/a/run1.mcap"), Path("/fleet/b/run1.mcap"), Path("/fleet/a/run2.mcap")]
    assert robots_of_logs(Pool(), by_folder) == ["a", "b", "a"]
    pool = Pool(robots={"first": ("a/*", "run9*"), "second": ("b/run?.mcap",)})
    assert robots_of_logs(pool, by_folder) == ["first", "second", "first"]
    with pytest.raises(package.ConfigError, match="two folders are named bot: /site1/bot and /site2/bot"):
        robots_of_logs(Pool(), [Path("/site1/bot/run.mcap"), Path("/site2/bot/run.mcap")])
    with pytest.raises(package.ConfigError, match=r"the log /run.mcap is in no folder"):
        robots_of_logs(Pool(), [Path("/run.mcap"), Path("/a/run.mcap")])


def test_equalities_hold_for_every_robot() -> None:
    """Copies of bodies are shared; a joint's friction is a copy of another's in every robot."""
    config = read_config(SAMPLES / "leg.yaml")
    config = config.model_copy(
        update={"mirror": package.Model(LEG, {"mirror": [{"joint": "knee", "of": "hip"}]}).settings.mirror}
    )
    experiment = prepare(read_robot(LEG), config, [SAMPLES / "leg_train.mcap"])
    of_one = experiment.equation
    equalities = equality_constraints(config, experiment.model, of_one)
    pooled = pooled_model(of_one, ["a", "b", "c"], ["friction"])
    of_all = pooled.equalities(equalities)
    rng = np.random.default_rng(0)
    theta = of_all.K @ rng.normal(size=of_all.K.shape[1])
    names = [(c.effect, c.owner) for c in of_one.coefficients]
    hip, knee = names.index(("coulomb_friction", "hip")), names.index(("coulomb_friction", "knee"))
    for robot in range(3):
        own = pooled.selection(robot) @ theta
        assert own[hip] == own[knee]
        assert np.array_equal(own[~pooled.is_own], theta[: np.count_nonzero(~pooled.is_own)])
    assert isinstance(of_all, EqualityConstraints)
    assert len({c.key for c in pooled.coefficients}) == len(pooled.coefficients)
    assert pooled.averaging @ theta == pytest.approx(np.mean([pooled.selection(r) @ theta for r in range(3)], axis=0))
