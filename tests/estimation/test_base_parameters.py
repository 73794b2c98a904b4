"""Base parameters: counts that are published, combinations by hand, and Pinocchio's regressor on random trees."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from paths import REAL
from reference import Reference
from robots import actuated, random_rotors, random_urdf
from tables import GANTRY, PANDA, PUMA, RX90, SCARA, STANFORD, UR5, Row, rooted, table_urdf

from idtool.common import linear_algebra
from idtool.dynamics.effects import build_effects
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.equality_constraints import equality_constraints
from idtool.estimation.uncertainty import base_parameters as module
from idtool.estimation.uncertainty.base_parameters import BaseParameters, base_parameters, structural_base_parameters
from idtool.robot.config import parse_config
from idtool.robot.inertia import PARAMETER_NAMES, PI_SIZE
from idtool.robot.model import RobotModel, build_model
from idtool.robot.urdf.reading import Robot, read_robot

Array = NDArray[np.float64]
ReadRobot = Callable[[str | bytes], Robot]

P = np.pi / 2
UP, ACROSS, NONE = (0.0, 0.0, -9.81), (0.0, -9.81, 0.0), (0.0, 0.0, 0.0)
RIGID = {"friction": {"viscous": False, "coulomb": False}}


class Arm(NamedTuple):
    """A table of joints, gravity in the root's frame, the number of base parameters, and who says so."""

    rows: tuple[Row, ...]
    gravity: tuple[float, float, float]
    count: int
    source: str


SEVEN_EACH = (
    "7 n − 6 of revolute joints, the first along gravity, the second not; 7 n − 4 where the first is not along it"
)
ARMS = {
    "pendulum": Arm(PUMA[:1], ACROSS, 3, "by hand: its inertia and two first moments"),
    "turntable": Arm(PUMA[:1], UP, 1, "by hand: its inertia"),
    "PUMA 560": Arm(PUMA, UP, 36, "Gautier & Khalil 1990"),
    "PUMA 560, on a wall": Arm(PUMA, ACROSS, 38, SEVEN_EACH),
    "PUMA 560, in space": Arm(
        PUMA, NONE, 34, "link 2's h_x and h_y, its frame on joint 1's axis, are then in I_xz and I_yz"
    ),
    "RX-90": Arm(RX90, UP, 36, "Khalil & Dombre 2002: 40 with the inertias of rotors 3 to 6"),
    "UR5": Arm(UR5, UP, 36, SEVEN_EACH),
    "Panda": Arm(PANDA, UP, 43, "Gaz, Cognetti, Oliva, Robuffo Giordano & De Luca 2019"),
    "wrist": Arm(((0, 0, 0, 0), *PUMA[4:]), UP, 15, SEVEN_EACH),
    "wrist, on a wall": Arm(((0, 0, 0, 0), *PUMA[4:]), ACROSS, 17, SEVEN_EACH),
    "Stanford arm": Arm(
        STANFORD, UP, 33, "Gautier & Khalil's rules: 1, 7 with the slide's inertia, the slide's 4, 7 each"
    ),
    "SCARA": Arm(SCARA, UP, 8, "by hand: I_1; I_2, h_2; m_3; I_4, h_4"),
    "SCARA, on a wall": Arm(SCARA, ACROSS, 10, "by hand: the first link's first moments as well"),
    "gantry": Arm(GANTRY, UP, 3, "by hand: what each slide carries"),
}


def equation_of(robot: Robot, **config: Any) -> tuple[RobotModel, LinearModel]:
    """The rigid bodies' equation, and whatever effects a configuration adds."""
    read = parse_config(RIGID | config, "arm.yaml")
    model = build_model(robot, read, actuated(robot))
    return model, LinearModel(model.names, build_effects(model, read))


def states(reference: Reference, bodies: Sequence[str], rng: np.random.Generator, count: int) -> Array:
    """Pinocchio's regressor at random states, one below the other, shape (count nv, 10 bodies)."""
    nv = len(reference.names)
    return np.concatenate([reference.regressor(bodies, *rng.normal(size=(3, nv))) for _ in range(count)])


def assert_same_space(base: BaseParameters, Y: Array) -> None:
    """The rows of B span those of Y, whose singular values say how many there are; and Y = Y_own B."""
    size = np.linalg.norm(Y, axis=0)
    size[size < 1e-9] = 1.0
    s, Vt = np.linalg.svd(Y / size)[1:]
    rank = int(np.sum(s > 1e-7 * s[0]))
    assert rank == len(s) or s[rank] < 1e-4 * s[rank - 1]  # no doubt about it
    assert len(base) == rank
    rows = base.B / size
    assert np.abs(rows @ Vt[rank:].T).max(initial=0) < 1e-7 * np.abs(rows).max()
    np.testing.assert_allclose(Y[:, base.own] @ base.B, Y, rtol=0, atol=1e-9 * np.abs(Y).max())
    np.testing.assert_allclose(base.B[:, base.own], np.eye(len(base)), rtol=0, atol=1e-12)


def check(robot: Robot, rng: np.random.Generator, **config: Any) -> BaseParameters:
    """The base parameters of rigid bodies, the same space as Pinocchio's.

    Exactly so where nothing is taken for rounding; what is, is not felt.
    """
    model, equation = equation_of(robot, **config)
    base = structural_base_parameters(model, equation)
    if len(model.names) == 1:
        return base  # whose regressor Pinocchio gives as a vector
    reference = Reference(robot.text.decode(), model.names, {"gravity": UP} | config)
    bodies = [body.name for body in model.bodies]
    Y = states(reference, bodies, rng, 3 + 30 * len(bodies) // len(model.names))
    with pytest.MonkeyPatch.context() as strict:
        strict.setattr("idtool.estimation.uncertainty.base_parameters._RANK", 1e-9)
        strict.setattr("idtool.estimation.uncertainty.base_parameters._ZERO", 1e-12)
        exact = structural_base_parameters(model, equation)
    assert_same_space(exact, Y)
    assert len(base) == len(exact)
    felt = np.linalg.norm(Y, axis=0) * [c.scale or 1.0 for c in equation.coefficients]
    missed = np.linalg.norm(Y - Y[:, base.own] @ base.B, axis=0) * [c.scale or 1.0 for c in equation.coefficients]
    assert missed.max() < 1e-3 * felt.max()
    return base


def combinations(model: RobotModel, base: BaseParameters) -> dict[str, dict[str, float]]:
    """Each base parameter's name and the coefficients in it."""
    names = [f"{body.name}.{name}" for body in model.bodies for name in PARAMETER_NAMES]
    rows = ({names[k]: row[k] for k in np.flatnonzero(row)} for row in base.B)
    return dict(zip((names[k] for k in base.own), rows, strict=True))


@pytest.mark.parametrize("name", ARMS)
def test_counts_of_known_arms(name: str, robot_of: ReadRobot, rng: np.random.Generator) -> None:
    arm = ARMS[name]
    base = check(robot_of(rooted(table_urdf(arm.rows, rng))), rng, gravity=list(arm.gravity))
    assert len(base) == arm.count, arm.source


@pytest.mark.parametrize("gravity", [UP, ACROSS])
def test_a_planar_arm_by_hand(gravity: Sequence[float], robot_of: ReadRobot, rng: np.random.Generator) -> None:
    """The second link's mass is felt as one at its joint, at x, y; gravity along the axes hides what only it sees."""
    x, y = 0.35, -0.2
    text = rooted(table_urdf(((0, 0, 0.1, 0), (0, x, 0, 0)), rng)).replace(f'xyz="{x} 0.0 0.0"', f'xyz="{x} {y} 0.0"')
    robot = robot_of(text)
    base = check(robot, rng, gravity=list(gravity))
    found = combinations(equation_of(robot, gravity=list(gravity))[0], base)
    expected = {
        "link1.mc_x": {"link1.mc_x": 1, "link2.m": x},
        "link1.mc_y": {"link1.mc_y": 1, "link2.m": y},
        "link1.I_zz": {"link1.I_zz": 1, "link2.m": x**2 + y**2},
        "link2.mc_x": {"link2.mc_x": 1},
        "link2.mc_y": {"link2.mc_y": 1},
        "link2.I_zz": {"link2.I_zz": 1},
    }
    if gravity == UP:
        del expected["link1.mc_x"], expected["link1.mc_y"]
    assert list(found) == list(expected)
    for name, row in expected.items():
        assert found[name] == pytest.approx(row, rel=1e-9), name


def test_a_slide_on_a_turntable_by_hand(robot_of: ReadRobot, rng: np.random.Generator) -> None:
    """The slide, along x, is felt by its mass and, turning with the table, by I_zz, h_x and, when it moves, h_y."""
    text = rooted(table_urdf(((0, 0, 0, 0), (0, 0, 0, 0, "prismatic")), rng))
    head, _, tail = text.rpartition('xyz="0 0 1"')
    robot = robot_of(f'{head}xyz="1 0 0"{tail}')
    base = check(robot, rng)
    found = combinations(equation_of(robot)[0], base)
    assert found == {
        "link1.I_zz": pytest.approx({"link1.I_zz": 1, "link2.I_zz": 1}, rel=1e-9),
        "link2.m": {"link2.m": pytest.approx(1)},
        "link2.mc_x": {"link2.mc_x": pytest.approx(1)},
        "link2.mc_y": {"link2.mc_y": pytest.approx(1)},
    }


def test_branches_count_as_arms_of_their_own(robot_of: ReadRobot, rng: np.random.Generator) -> None:
    """Khalil & Bennis 1994. Four legs on a trunk held still: 7 n − 4 each. Two arms on a waist: its 1, 7 a joint."""
    leg = ((P, 0.2, 0, 0), (P, 0, 0.1, 0.7), (0, 0.21, 0, 0))
    legs = [table_urdf(leg, rng, prefix=f"leg{i}_") for i in range(4)]
    assert len(check(robot_of(rooted(*legs)), rng)) == 4 * (7 * 3 - 4)
    waist = table_urdf(((0, 0, 0.3, 0),), rng, prefix="waist_")
    arms = [table_urdf(leg, rng, "waist_link1", f"arm{i}_") for i in range(2)]
    assert len(check(robot_of(rooted(waist, *arms)), rng)) == 1 + 2 * 7 * 3


def test_rotor_inertias_of_an_rx90(robot_of: ReadRobot, rng: np.random.Generator) -> None:
    """40 with a rotor inertia for each joint (Khalil & Dombre 2002): those of joints 1 and 2 are in the links'."""
    effects = [{"effect": "rotor_inertia", "joint": f"joint{i}", "parameters": {"inertia": 0.1}} for i in range(1, 7)]
    model, equation = equation_of(robot_of(rooted(table_urdf(RX90, rng))), effects=effects)
    base = structural_base_parameters(model, equation)
    assert len(base) == 40
    rotors = np.flatnonzero([c.effect == "rotor_inertia" for c in equation.coefficients])
    alone = [int(np.flatnonzero(row)[0]) for row in base.B if len(np.flatnonzero(row)) == 1]
    assert set(rotors[2:]) <= set(alone)
    assert not set(rotors[:2]) & set(alone)


def test_friction_is_a_parameter_of_its_own(robot_of: ReadRobot, rng: np.random.Generator) -> None:
    friction = {"viscous": True, "coulomb": True, "offset": True}
    model, equation = equation_of(robot_of(rooted(table_urdf(PUMA, rng))), friction=friction)
    base = structural_base_parameters(model, equation)
    assert len(base) == 36 + 3 * 6
    others = base.B[:, PI_SIZE * len(model.bodies) :]
    assert np.abs(others).sum() == pytest.approx(3 * 6)


def test_copies_are_told_once(robot_of: ReadRobot, rng: np.random.Generator) -> None:
    """A leg's mirror image adds nothing, and no combination names it."""
    leg = ((P, 0.2, 0, 0), (P, 0, 0.1, 0.7), (0, 0.21, 0, 0))
    robot = robot_of(rooted(*(table_urdf(leg, rng, prefix=prefix) for prefix in ("left_", "right_"))))
    mirror = [{"body": f"right_link{i}", "of": f"left_link{i}", "plane": "xz"} for i in (1, 2, 3)]
    read = parse_config(RIGID | {"mirror": mirror}, "legs.yaml")
    model, equation = equation_of(robot)
    base = structural_base_parameters(model, equation, equality_constraints(read, model, equation))
    assert not base.B[:, 3 * PI_SIZE :].any()
    assert len(base) < len(structural_base_parameters(model, equation)) == 2 * 17


def test_little_memory_gives_the_same(
    robot_of: ReadRobot, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From fewer samples, fewer than a joint has columns, and from the triangular factor of all rows."""
    robot = robot_of(rooted(table_urdf(PANDA, rng)))
    monkeypatch.setattr(module, "_SAMPLES", (40, 1500))
    monkeypatch.setattr(module, "_BYTES", 0)
    monkeypatch.setattr(linear_algebra, "_MAX_ROWS_PER_COLUMN", 1)
    assert len(check(robot, rng)) == 43


@pytest.mark.parametrize("seed", range(12))
def test_random_trees(seed: int, robot_of: ReadRobot) -> None:
    """Of every kind of joint, some of which follow others; gravity from anywhere."""
    rng = np.random.default_rng(seed)
    robot = robot_of(random_urdf(rng, size=8))
    if len(actuated(robot)) > 1:
        check(robot, rng, gravity=(5 * rng.normal(size=3)).tolist())


@pytest.mark.parametrize("seed", range(4))
def test_rotors_are_bodies_of_their_own(seed: int, robot_of: ReadRobot) -> None:
    rng = np.random.default_rng(seed)
    robot = robot_of(random_urdf(rng, size=5, kinds=("revolute", "continuous"), mimic=0.0))
    plain = check(robot, rng)
    rotors = random_rotors(rng, robot)
    assert len(check(robot, rng, rotors=rotors)) > len(plain)


def test_rounded_angles_are_what_they_stand_for(robot_of: ReadRobot, rng: np.random.Generator) -> None:
    """A slide turned by 3.141593, and a first axis off gravity by 1.5708 less a quarter turn, add no parameters."""
    scara = rooted(table_urdf((*SCARA[:2], (3.141593, 0.25, 0, 0, "prismatic"), SCARA[3]), rng))
    puma = rooted(table_urdf(((1.5708 - P, 0, 0, 0), *PUMA[1:]), rng))
    for text, count in ((scara, 8), (puma, 36)):
        assert len(structural_base_parameters(*equation_of(robot_of(text)))) == count


@pytest.mark.skipif(not REAL.is_dir(), reason=f"the real robots are not in {REAL}")
@pytest.mark.parametrize(("name", "joints", "count"), [("panda", 7, 43), ("go2", 12, 4 * (7 * 3 - 4))])
def test_counts_of_real_robots(name: str, joints: int, count: int) -> None:
    robot, read = read_robot(REAL / name / f"{name}.urdf"), parse_config(RIGID, f"{name}.yaml")
    model = build_model(robot, read, actuated(robot)[:joints])
    assert len(structural_base_parameters(model, LinearModel(model.names, build_effects(model, read)))) == count


def test_nothing_felt_is_no_parameter() -> None:
    base = base_parameters(np.zeros((5, 3)), np.arange(3))
    assert len(base) == 0
    assert base.B.shape == (0, 3)
