"""Exciting motions of robots that can hit themselves, and the paper's shell, against Pinocchio's kinematics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from commands import LEG, idtool
from exciting import Array, body, derivatives, excited, joint, robot
from paths import CONFIGS, REAL

from idtool.data.logs import JointLog
from idtool.excitation.patterns.shell import tip_and_jacobian
from idtool.robot.config import parse_config
from idtool.robot.model import build_model
from idtool.robot.urdf.reading import read_robot

PANDA = REAL / "panda" / "panda.urdf"
REACH, BALL = 0.3, 0.1  # m: of each of two links, and the radius of balls at the base and at the tip


def ball(radius: float, x: float = 0.0) -> str:
    return f'<collision><origin xyz="{x} 0 0"/><geometry><sphere radius="{radius}"/></geometry></collision>'


FOLDING = robot(
    body("upper", extra=""),
    body("fore", extra=ball(BALL, REACH)),
    joint("a", "base", "upper", "0 0 1", "0 0 0", limit='lower="-2" upper="2" velocity="4" effort="90"'),
    joint("b", "upper", "fore", "0 0 1", limit='lower="-3.1" upper="3.1" velocity="4" effort="90"'),
).replace('<link name="base"/>', f'<link name="base">{ball(BALL)}</link>')


def tips(urdf: str, log: JointLog, frame: str, offset: float = 0.0) -> Array:
    """Where a link's point on its x axis is along a log's command, by Pinocchio, shape (N, 3)."""
    model = pin.buildModelFromXML(urdf)
    data = model.createData()
    index = [model.joints[model.getJointId(name)].idx_q for name in log.joints]
    found = []
    for row in log.signals["qcmd"]:
        q = pin.neutral(model)
        q[index] = row
        pin.framesForwardKinematics(model, data, q)
        found.append(data.oMf[model.getFrameId(frame)].act(np.array([offset, 0, 0])))
    return np.array(found)


@pytest.mark.parametrize("iterations", [1, 25])  # after one it is the motion drawn, which must be made to fit
def test_links_keep_their_distance(tmp_path: Path, iterations: int) -> None:
    report, log = excited(tmp_path, FOLDING, "--iterations", iterations, "--clearance", "0.03", "--margin", "0")
    clearance = np.linalg.norm(tips(FOLDING, log, "fore", REACH), axis=1) - 2 * BALL
    assert clearance.min() >= 0.03 - 1e-4  # between the instants looked at
    assert report["clearance"]["links"] == ["base", "fore"]
    assert report["clearance"]["distance"] == pytest.approx(clearance.min(), abs=1e-3)
    free, _ = excited(tmp_path / "free", FOLDING.replace(ball(BALL), ""), "--iterations", "25", "--margin", "0")
    assert free["clearance"] is None
    assert any("self-collision was not checked" in note for note in free["warnings"])


def test_without_that_care_they_would_touch(tmp_path: Path) -> None:
    options = ("--iterations", "60", "--margin", "0", "--duration", "30")
    _, log = excited(tmp_path, FOLDING.replace(ball(BALL), ""), *options)
    assert np.linalg.norm(tips(FOLDING, log, "fore", REACH), axis=1).min() < 2 * BALL + 0.03


def test_a_start_in_collision_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(FOLDING)
    done = idtool("excite", path, "--start", "a=0", "--start", "b=2.7", folder=tmp_path)
    assert done.code == 2
    assert "--start: links base and fore are -" in done.err
    assert done.err.count("\n") == 1


def test_the_tips_place_and_jacobian_are_pinocchios(rng: np.random.Generator) -> None:
    model = build_model(read_robot(LEG), parse_config({}, "c"), ["abad", "hip", "knee"])
    reference = pin.buildModelFromUrdf(str(LEG))
    data, frame = reference.createData(), reference.getFrameId("foot")
    q = rng.uniform(-1, 1, (3, 5))
    p, J = tip_and_jacobian(model, 2, np.array([0, 0, -0.345]), q)
    for n in range(5):
        pin.computeJointJacobians(reference, data, q[:, n])
        pin.updateFramePlacements(reference, data)
        assert p[:, n] == pytest.approx(data.oMf[frame].translation)
        world = pin.getFrameJacobian(reference, data, frame, pin.LOCAL_WORLD_ALIGNED)
        assert J[n] == pytest.approx(world[:3])


def test_the_foot_is_on_the_papers_shell(tmp_path: Path) -> None:
    report, log = excited(tmp_path, LEG, "--pattern", "shell", "--slow", "0", "--duration", "12", "--noise", "0.1")
    foot = tips(LEG.read_text(), log, "foot")[3000:-3000]  # past the ways to the shell and back
    # An ellipsoid with axes along the base's: x² a + y² b + z² c + x d + y e + z f = 1.
    A = np.hstack([foot**2, foot])
    shape, *_ = np.linalg.lstsq(A, np.ones(len(foot)), rcond=None)
    assert np.abs(A @ shape - 1).max() < 0.02 * np.abs(A * shape).sum(axis=1).max()
    assert (shape[:3] * shape[0] > 0).all()
    radii = np.sqrt((1 + (shape[3:] ** 2 / shape[:3]).sum() / 4) / shape[:3])
    center = -shape[3:] / shape[:3] / 2
    theta = np.arccos(np.clip((foot[:, 0] - center[0]) / radii[0], -1, 1))
    assert np.ptp(theta) > 1  # it goes round
    a = derivatives(log)[2]
    for j, name in enumerate(log.joints):
        assert np.abs(a[:, j]).max() <= 0.9 * report["limits"][name]["acceleration"] * (1 + 1e-3)


@pytest.mark.skipif(not PANDA.is_file(), reason="the Panda's URDF is not part of this repository")
@pytest.mark.parametrize("pattern", [pytest.param("fourier", marks=pytest.mark.slow), "shell"])
def test_an_arm_of_seven_joints(tmp_path: Path, pattern: str) -> None:
    config = CONFIGS / "panda.yaml"
    report, log = excited(tmp_path, PANDA, "--config", config, "--pattern", pattern, "--iterations", "3")
    _, v, a = derivatives(log)
    assert len(log.joints) == 7
    for j, name in enumerate(log.joints):
        lower, upper = report["limits"][name]["position"]
        assert lower < log.signals["qcmd"][:, j].min() <= log.signals["qcmd"][:, j].max() < upper
        assert np.abs(v[:, j]).max() < report["limits"][name]["velocity"]
        assert np.abs(a[:, j]).max() < report["limits"][name]["acceleration"]
        assert report["use"][name]["effort"] <= 0.8
