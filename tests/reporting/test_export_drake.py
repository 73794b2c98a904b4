"""The identified model as a URDF for Drake."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
from commands import LEG, SAMPLES
from exported import (
    EXACT,
    InMujoco,
    arm,
    balanced,
    mass_and_bias,
    model_of,
    sample,
    state,
    unsupported_parts,
    with_couplings,
)
from lxml import etree
from numpy.typing import NDArray
from reference import Reference
from robots import actuated, random_urdf

from idtool.reporting.export import Export, to_drake, to_mujoco
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

DRAKE = "{http://drake.mit.edu}"


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    """Where a test writes its robot."""
    return tmp_path / "identified.urdf"


def gears(export: Export) -> dict[str, tuple[str, float, float]]:
    """Actuator, rotor inertia and gear ratio by joint, as an XML parser finds them."""
    found = {}
    for transmission in etree.fromstring(export.text).iterfind("transmission"):
        assert transmission.findtext("type") == "transmission_interface/SimpleTransmission"
        actuator = transmission.find("actuator")
        inertia, ratio = (float(actuator.find(DRAKE + name).get("value")) for name in ("rotor_inertia", "gear_ratio"))
        found[transmission.find("joint").get("name")] = (actuator.get("name"), inertia, ratio)
    return found


class InPinocchio:
    """The file as Pinocchio reads it, which knows no rotors, with reflected inertia on the diagonal as Drake has it."""

    def __init__(self, export: Export, joints: list[str]) -> None:
        self.tree = pin.buildModelFromXML(export.text.decode())
        self.data = self.tree.createData()
        self.joints = [self.tree.joints[self.tree.getJointId(name)] for name in joints]
        self.dofs = [j.idx_v for j in self.joints]
        self.reflected = np.diag([inertia * ratio**2 for _, inertia, ratio in (gears(export)[name] for name in joints)])

    def mass_and_bias(self, q: Array, v: Array) -> tuple[Array, Array]:
        """M(q), shape (nv, nv), and h(q, v), shape (nv,)."""
        place, speed = pin.neutral(self.tree), np.zeros(self.tree.nv)
        for j, angle in zip(self.joints, q, strict=True):
            place[j.idx_q : j.idx_q + j.nq] = [angle] if j.nq == 1 else [np.cos(angle), np.sin(angle)]
        speed[self.dofs] = v
        M = pin.crba(self.tree, self.data, place)[np.ix_(self.dofs, self.dofs)]
        M = np.triu(M) + np.triu(M, 1).T
        return M + self.reflected, pin.nonLinearEffects(self.tree, self.data, place, speed)[self.dofs]


def test_a_rotor_across_its_carriers_axis_is_carried_exactly(rng: np.random.Generator, urdf: Path) -> None:
    text = arm(rng, "0 0 1", "0 1 0")
    urdf.write_text(text)
    rotors = {"a": balanced([0, 0, 1], {"j1": 7.0}, "l0"), "b": balanced([0, 1, 0], {"j2": -9.0}, "l1")}
    export = to_drake(model_of(urdf, rotors=rotors))
    assert unsupported_parts(export, "rotor") == []
    assert gears(export)["j2"] == ("j2", pytest.approx(1e-3), -9.0)
    found = InPinocchio(export, ["j1", "j2"])
    reference = Reference(text, ["j1", "j2"], {"gravity": [0, 0, -9.81], "rotors": rotors})
    q, v = state(rng, 2)
    for ours, theirs in zip(found.mass_and_bias(q, v), mass_and_bias(reference, q, v), strict=True):
        np.testing.assert_allclose(ours, theirs, **EXACT)


@pytest.mark.parametrize("robot", ["leg", "belt_arm"])
def test_what_is_lost_is_what_is_said(rng: np.random.Generator, robot: str) -> None:
    urdf = SAMPLES / f"{robot}.urdf"
    config = sample(urdf)
    export = to_drake(model_of(urdf, **config))
    (part,) = unsupported_parts(export, "rotor")
    found = InPinocchio(export, config["joints"])
    reference = Reference(urdf.read_text(), config["joints"], with_couplings(config))
    q, v = state(rng, 3)
    (M, h), (true_M, true_h) = found.mass_and_bias(q, v), mass_and_bias(reference, q, v)
    assert np.abs(M - true_M).max() == pytest.approx(part.value, rel=1e-9)
    np.testing.assert_allclose(np.diag(M), np.diag(true_M), **EXACT)
    np.testing.assert_allclose(h, true_h, **EXACT)


@pytest.mark.parametrize("seed", range(6))
def test_joints_that_are_locked_are_fixed_in_their_place(urdf: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    text = random_urdf(rng, mimic=0.0, massless=0.0)
    urdf.write_text(text)
    every = actuated(read_robot(urdf))
    free = rng.random(len(every)) < 0.5
    free[0] = True
    locked = {name: float(rng.uniform(-1, 1)) for name, moves in zip(every, free, strict=True) if not moves}
    names = [name for name, moves in zip(every, free, strict=True) if moves]
    export = to_drake(model_of(urdf, joints=names, locked_joints=locked))
    found, reference = InPinocchio(export, names), Reference(text, every, {"gravity": [0, 0, -9.81]})
    assert found.tree.nv == len(names)
    q, v = state(rng, len(every))
    q[~free], v[~free] = list(locked.values()), 0.0
    M, h = mass_and_bias(reference, q, v)
    own_M, own_h = found.mass_and_bias(q[free], v[free])
    np.testing.assert_allclose(own_M, M[np.ix_(free, free)], **EXACT)
    np.testing.assert_allclose(own_h, h[free], **EXACT)


ODD = b"""<?xml version='1.0' encoding="iso-8859-1"?>\r
<!-- <transmission/> -->\r
<robot name='r'>\r
\t<link name="a"/><link name="b" note="1 > 0"><inertial><mass value="1"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link><link name="c"/>
  <joint name="H\xfcfte" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper='1' effort="5" velocity="1"/></joint>
  <joint name="revolute"   type='revolute'  ><parent link="b"/><child link="c"/><axis xyz="0 1 0"/>
    <mimic joint="H\xfcfte"/>
    <limit lower="-1" upper='1' effort="0" velocity="1"/></joint>
  <transmission name="t"><type>SimpleTransmission</type><joint name="H\xfcfte"><x/></joint>
    <actuator name="m1"/></transmission>
  <transmission name="t"><type>SimpleTransmission</type><joint name="H\xfcfte"/><actuator name="m2"/></transmission>
  <transmission name="u"><type>Differential</type><joint name="H\xfcfte"/><actuator name="H\xfcfte"/></transmission>
  <gazebo><transmission name="v"><joint name="H\xfcfte"/></transmission></gazebo>
</robot>"""


TRANSMISSION = re.compile(rb'<transmission name="t">.*?</transmission>', re.DOTALL)


def test_all_else_stays_byte_for_byte(urdf: Path) -> None:
    urdf.write_bytes(ODD)
    text = to_drake(model_of(urdf)).text
    written = re.compile(rb"  <transmission name=\"m1_transmission\">.*?</transmission>\r\n", re.DOTALL)
    assert len(written.findall(text)) == 1
    rest = written.sub(b"", text).replace(b' xmlns:drake="http://drake.mit.edu"', b"")
    assert rest == TRANSMISSION.sub(b"", ODD)


def test_drakes_namespace_is_declared_once(urdf: Path) -> None:
    declared = ODD.replace(b"<robot ", b"<robot xmlns:drake='http://drake.mit.edu' ")
    urdf.write_bytes(declared)
    assert to_drake(model_of(urdf)).text.count(b"xmlns:drake") == 1


def test_an_actuator_keeps_its_name_and_a_new_one_takes_none_that_is_there(urdf: Path) -> None:
    urdf.write_bytes(ODD)
    found = etree.fromstring(to_drake(model_of(urdf)).text).findall("transmission")
    assert [t.find("actuator").get("name") for t in found] == ["Hüfte", "m1"]
    urdf.write_bytes(TRANSMISSION.sub(b"", ODD))
    found = etree.fromstring(to_drake(model_of(urdf)).text).findall("transmission")
    assert [t.find("actuator").get("name") for t in found] == ["Hüfte", "Hüfte_"]


def test_a_follower_of_a_locked_joint_is_fixed_where_that_holds_it(rng: np.random.Generator, urdf: Path) -> None:
    mimic = '<mimic joint="j1" multiplier="-2" offset="0.1"/>'
    other = '<mimic joint="j2" multiplier="3" offset="0.2"/>'
    text = arm(rng, "0 0 1", "0 1 0", "1 0 0", "0 1 1")
    mimicking = text.replace('<axis xyz="0 1 0"/>', f'<axis xyz="0 1 0"/>{mimic}')
    urdf.write_text(mimicking.replace('<axis xyz="1 0 0"/>', f'<axis xyz="1 0 0"/>{other}'))
    model = model_of(urdf, joints=["j4"], locked_joints={"j1": 0.4})
    export = to_drake(model)
    assert b"<mimic" not in export.text
    reference = Reference(text, ["j1", "j2", "j3", "j4"], {"gravity": [0, 0, -9.81]})
    M, h = mass_and_bias(reference, np.array([0.4, -0.7, -1.9, 1.1]), np.array([0, 0, 0, 2.0]))
    for found in (InPinocchio(export, ["j4"]), InMujoco(to_mujoco(model), ["j4"])):
        own_M, own_h = found.mass_and_bias(np.array([1.1]), np.array([2.0]))
        np.testing.assert_allclose([own_M[0, 0], own_h[0]], [M[3, 3], h[3]], **EXACT)


def test_a_joint_may_be_called_after_its_type(urdf: Path) -> None:
    urdf.write_bytes(re.sub(rb"<mimic.*?/>", b"", ODD))
    export = to_drake(model_of(urdf, joints=["Hüfte"]))
    assert b"""<joint name="revolute"   type="fixed"  >""" in export.text


def test_a_follower_is_said_to_need_a_discrete_plant(urdf: Path) -> None:
    urdf.write_bytes(ODD)
    assert [part.of for part in unsupported_parts(to_drake(model_of(urdf)), "mimic")] == ["revolute"]


def test_what_drake_has_no_place_for_is_said(urdf: Path) -> None:
    config: dict[str, Any] = {
        **sample(LEG),
        "gravity": [0.0, 1.0, -9.7],
        "friction": {"viscous": 0.3, "coulomb": 0.7, "offset": -0.4},
    }
    export = to_drake(model_of(LEG, **config))
    said = {(part.what, part.of): part for part in export.not_carried}
    assert {("coulomb_friction", "hip"), ("torque_offset", "knee"), ("gravity", "base"), ("fixed_base", "base")} <= set(
        said
    )
    assert (said["coulomb_friction", "hip"].value, said["coulomb_friction", "hip"].unit) == (0.7, "N·m")
    assert "[0, 1, -9.7]" in said["gravity", "base"].detail
    assert read_robot_of(export, urdf).joints["hip"].damping == 0.3


def test_a_joint_without_effort_has_no_actuator_in_drake(urdf: Path) -> None:
    urdf.write_text(LEG.read_text().replace('effort="230"', 'effort="0"'))
    assert len(unsupported_parts(to_drake(model_of(urdf, **sample(LEG))), "actuator")) == 3


def read_robot_of(export: Export, path: Path) -> Any:
    path.write_bytes(export.text)
    return read_robot(path)


def test_links_that_could_not_exist_alone_are_put_together(rng: np.random.Generator, leg: str, urdf: Path) -> None:
    names = ["abad", "hip", "knee"]
    impossible = re.sub(r'(<link name="foot">.*?ixx=")[^"]*', r"\g<1>-1e-5", leg, flags=re.DOTALL)
    urdf.write_text(impossible)
    reference = Reference(impossible, names, {"gravity": [0, 0, -9.81]})
    export = to_drake(model_of(urdf, joints=names, locked_joints={"tail": 0.0}))
    assert etree.fromstring(export.text).find("link[@name='foot']/inertial") is None
    q, v = state(rng, 3)
    found = InPinocchio(export, names)
    for ours, theirs in zip(found.mass_and_bias(q, v), mass_and_bias(reference, q, v), strict=True):
        np.testing.assert_allclose(ours, theirs, **EXACT)


@pytest.mark.parametrize("robot", ["leg", "belt_arm"])
def test_drake_computes_what_is_said(rng: np.random.Generator, robot: str) -> None:
    parsing = pytest.importorskip("pydrake.multibody.parsing", reason="Drake is not installed")
    plant_of = pytest.importorskip("pydrake.multibody.plant").MultibodyPlant
    urdf = SAMPLES / f"{robot}.urdf"
    config = sample(urdf)
    export = to_drake(model_of(urdf, **{**config, "friction": {"coulomb": False, "viscous": 0.2}}))
    plant = plant_of(0.0)
    parsing.Parser(plant).AddModelsFromString(export.text.decode(), "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    dofs = [plant.GetJointByName(name).velocity_start() for name in config["joints"]]
    q, v = state(rng, 3)
    plant.SetPositions(context, q[np.argsort(dofs)])
    plant.SetVelocities(context, v[np.argsort(dofs)])
    M, h = InPinocchio(export, config["joints"]).mass_and_bias(q, v)
    np.testing.assert_allclose(plant.CalcMassMatrix(context)[np.ix_(dofs, dofs)], M, **EXACT)
    bias = plant.CalcBiasTerm(context) - plant.CalcGravityGeneralizedForces(context)
    np.testing.assert_allclose(bias[dofs], h, **EXACT)
    assert plant.num_actuators() == 3
    assert [plant.GetJointByName(name).default_damping() for name in config["joints"]] == [0.2] * 3
