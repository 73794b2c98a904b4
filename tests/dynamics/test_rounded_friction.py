"""Friction as simulators round it off, MuJoCo within some 10 ms of a reversal, others over a range of speeds.

That is no effect, and not unknown.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import mujoco  # type: ignore[import-untyped]
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from sentences import sentences

import idtool
from idtool.diagnosis.diagnose import Options, diagnose
from idtool.diagnosis.records import Candidate, Diagnosis
from idtool.diagnosis.words import removal_sentence
from idtool.estimation.dataset.experiment import prepare
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

JOINTS = ("shoulder", "elbow")
SECONDS, STEP, NOISE = 16.0, 5e-4, 0.05  # s, s, N·m
LENGTH, MASS, ARMATURE = (0.3, 0.25), (2.2, 1.1), (0.15, 0.06)  # m, kg, kg·m²
DAMPING, DRY = (0.8, 0.3), (1.4, 0.6)  # N·m·s/rad, N·m
KP, KD = np.array([500.0, 200.0]), np.array([15.0, 5.0])
LEAD = 0.02 * 0.95 / 2  # s: of MuJoCo's default solref and solimp
STIFFNESS, REST = 8.0, 0.35  # N·m/rad, rad
ROUNDING, SHARP = 0.05, 0.005  # rad/s, of c tanh(v / rounding)


def link_inertia(k: int) -> Array:
    """Of a rod about its centre [kg·m²]."""
    long = MASS[k] * (3 * 0.05**2 + LENGTH[k] ** 2) / 12
    return np.array([long, long, MASS[k] * 0.05**2 / 2])


def mjcf(stiffness: float, rounding: float) -> str:
    """Two links in a vertical plane, on the first a spring; with a rounding, dry friction is applied from outside."""
    bodies = ""
    for k, name in enumerate(JOINTS):
        spring = f'stiffness="{stiffness}" springref="{REST}"' if k == 0 else ""
        inertia = " ".join(map(str, link_inertia(k)))
        bodies += (
            f'<body pos="0 0 {LENGTH[0] * k}"><inertial pos="0 0 {LENGTH[k] / 2}" mass="{MASS[k]}" '
            f'diaginertia="{inertia}"/><joint name="{name}" axis="0 1 0" damping="{DAMPING[k]}" '
            f'frictionloss="{0 if rounding else DRY[k]}" armature="{ARMATURE[k]}" {spring}/>'
        )
    motors = "".join(f'<motor joint="{name}"/>' for name in JOINTS)
    option = f'<option timestep="{STEP}" integrator="implicitfast"/><compiler angle="radian"/>'
    tree = f"<worldbody>{bodies}</body></body></worldbody>"
    return f"<mujoco>{option}{tree}<actuator>{motors}</actuator></mujoco>"


def urdf() -> str:
    """The same by a designer who is 12 to 15 % off."""
    text = '<robot name="arm"><link name="l0"/>'
    for k, name in enumerate(JOINTS):
        xx, yy, zz = 1.15 * link_inertia(k)
        text += (
            f'<link name="l{k + 1}"><inertial><origin xyz="0 0 {0.54 * LENGTH[k]}"/><mass value="{0.88 * MASS[k]}"/>'
            f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{name}" type="continuous"><parent link="l{k}"/><child link="l{k + 1}"/>'
            f'<origin xyz="0 0 {LENGTH[0] * k}"/><axis xyz="0 1 0"/></joint>'
        )
    return text + "</robot>"


@cache
def log(stiffness: float, rounding: float) -> dict[str, Array]:
    """Joints that a PD controller leads along Fourier series, at 1 kHz."""
    rng, model = np.random.default_rng(2), mujoco.MjModel.from_xml_string(mjcf(stiffness, rounding))
    data, t = mujoco.MjData(model), np.arange(0, SECONDS, 1e-3)
    w = 2 * np.pi * 0.15 * np.arange(1, 11)
    a, b = rng.normal(size=(2, 2, 10)) / w
    q = (a @ np.sin(np.outer(w, t)) + b @ (np.cos(np.outer(w, t)) - 1)) * 1.4
    qcmd, rows = q / np.abs(q).max(axis=1, keepdims=True) * 1.2, []
    vcmd = np.gradient(qcmd, 1e-3, axis=1)
    for k in range(len(t)):
        tau = KP * (qcmd[:, k] - data.qpos) + KD * (vcmd[:, k] - data.qvel)
        rows.append([*data.qpos, *data.qvel, *tau])
        data.ctrl[:] = tau
        for _ in range(2):
            if rounding:
                data.qfrc_applied[:] = -np.array(DRY) * np.tanh(data.qvel / rounding)
            mujoco.mj_step(model, data)
    x = np.array(rows) + rng.normal(size=(len(t), 6)) * np.repeat([2e-5, 2e-3, NOISE], 2)
    names = [f"{signal}_{joint}" for signal in ("q", "v", "tau") for joint in JOINTS]
    return {"t": t} | dict(zip(names, x.T, strict=True))


def diagnosed(folder: Path, stiffness: float, rounding: float = 0.0) -> Diagnosis:
    """What idtool makes of it, the motors' inertia being known as effects."""
    columns = log(stiffness, rounding)
    lines = [",".join(columns), *(",".join(f"{x:.9g}" for x in row) for row in zip(*columns.values(), strict=True))]
    (folder / "log.csv").write_text("\n".join(lines))
    (folder / "arm.urdf").write_text(urdf())
    rotors = [
        {"effect": "rotor_inertia", "joint": name, "parameters": {"inertia": 0.9 * inertia}}
        for name, inertia in zip(JOINTS, ARMATURE, strict=True)
    ]
    config = parse_config({"effects": rotors}, "")
    tried = prepare(read_robot(folder / "arm.urdf"), config, [folder / "log.csv"])
    return diagnose(tried, Options(simulate=False), lambda stage, share: None)


def is_the_spring(found: Diagnosis) -> None:
    """The spring alone was named, as it is."""
    (step,) = found.steps
    assert (step.chosen.effect, step.chosen.joint) == ("parallel_spring", "shoulder")
    assert step.parameters["stiffness"] == pytest.approx(STIFFNESS, rel=0.05)
    assert step.parameters["rest_position"] == pytest.approx(REST, abs=0.02)


@pytest.mark.slow
def test_friction_that_is_rounded_off_in_time_is_no_disagreement(tmp_path: Path) -> None:
    found = diagnosed(tmp_path, 0.0)
    assert (found.verdict, found.steps) == ("no_disagreement", ())
    notes = sentences(found.notices)
    assert len(notes) == 2
    for name, note in zip(("shoulder", "elbow"), notes, strict=True):
        assert note.startswith(f"{name}: friction changes its sign gradually around zero speed")
        (lead,) = re.findall(r"lead ([0-9.]+)", note)
        assert float(lead) == pytest.approx(LEAD, abs=0.002 if name == "shoulder" else 0.01)  # less friction


@pytest.mark.slow
def test_what_it_would_hide_is_found(tmp_path: Path) -> None:
    """A spring, as it is: with the rounding in the rows its rest position was 0.1 rad off."""
    is_the_spring(diagnosed(tmp_path, STIFFNESS))


@pytest.mark.slow
def test_friction_that_is_rounded_off_in_speed_is_no_disagreement(tmp_path: Path) -> None:
    """It is fitted along, and the model is as it was."""
    found = diagnosed(tmp_path, 0.0, ROUNDING)
    assert (found.verdict, found.steps, found.last) == ("no_disagreement", (), found.first)
    notes = [note for note in sentences(found.notices) if "changes its sign gradually around zero speed" in note]
    assert [note.split(":")[0] for note in sorted(notes)] == ["elbow", "shoulder"]


@pytest.mark.slow
def test_what_that_would_hide_is_found(tmp_path: Path) -> None:
    is_the_spring(diagnosed(tmp_path, STIFFNESS, ROUNDING))


def test_nothing_is_left_aside_where_friction_is_sharp(tmp_path: Path) -> None:
    found = diagnosed(tmp_path, 0.0, SHARP)
    assert (found.verdict, found.steps, sentences(found.notices)) == ("no_disagreement", (), ())


def test_why_a_step_was_taken_out_is_said_in_known_words() -> None:
    spring, drag, rounded = (
        Candidate(name, "j1", None, 0.5, 0.01, 1) for name in ("parallel_spring", "quadratic_drag", "rounded_friction")
    )
    text = "Parallel spring on j1 was removed again: "
    assert removal_sentence(spring, drag) == f"{text}with quadratic drag on j1, it no longer explains enough"
    found = removal_sentence(spring, rounded)
    assert found.startswith(f"{text}because on j1 friction changes its sign")
    assert "rounded_friction" not in found


def test_its_simulation_is_that_of_an_integrator(tmp_path: Path) -> None:
    """A bar on a hinge under a known torque, against scipy's integrator."""
    inertia, coulomb, velocity = 0.2, 0.5, 0.1
    t = np.arange(0, 4, 2e-3)

    def torque(time: Array | float) -> Array:
        return np.asarray(1.5 * np.sin(2.0 * np.asarray(time)) + 0.4 * np.cos(7.0 * np.asarray(time)))

    def derivative(time: float, state: Array) -> list[float]:
        return [state[1], float(torque(time) - coulomb * np.tanh(state[1] / velocity)) / inertia]

    found = solve_ivp(derivative, (0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-10)
    (tmp_path / "bar.urdf").write_text(
        '<robot name="bar"><link name="base"/><link name="bar"><inertial><mass value="1"/>'
        f'<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="hinge" type="continuous"><parent link="base"/><child link="bar"/>'
        '<axis xyz="0 0 1"/></joint></robot>'
    )
    entry = {"effect": "rounded_friction", "joint": "hinge", "parameters": {"coulomb": coulomb, "velocity": velocity}}
    config = {"effects": [entry], "friction": {"viscous": False, "coulomb": False}, "filter": {"cutoff_hz": 50}}
    log = idtool.Log.from_arrays(
        "run", t, ["hinge"], q=found.y[0][:, None], v=found.y[1][:, None], tau=torque(t)[:, None]
    )
    simulated = idtool.simulate(idtool.Model(tmp_path / "bar.urdf", config), log, window=0)
    assert np.ptp(found.y[0]) > 1
    assert simulated.rmse.position["hinge"] < 1e-3


def test_it_stands_in_place_of_coulomb_friction_without_a_coefficient(tmp_path: Path) -> None:
    """An entry with the velocity alone: the coefficient is fitted, from 0."""
    coulomb, velocity = 0.5, 0.1
    t = np.arange(0, 8, 2e-3)
    q = np.sin(2.0 * t) + 0.3 * np.cos(7.0 * t)
    v = 2.0 * np.cos(2.0 * t) - 2.1 * np.sin(7.0 * t)
    a = -4.0 * np.sin(2.0 * t) - 14.7 * np.cos(7.0 * t)
    tau = 0.2 * a + coulomb * np.tanh(v / velocity)
    (tmp_path / "bar.urdf").write_text(
        '<robot name="bar"><link name="base"/><link name="bar"><inertial><mass value="1"/>'
        '<inertia ixx="0.2" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="hinge" type="continuous"><parent link="base"/><child link="bar"/>'
        '<axis xyz="0 0 1"/></joint></robot>'
    )
    entry = {"effect": "rounded_friction", "joint": "hinge", "parameters": {"velocity": velocity}}
    config = {"effects": [entry], "friction": {"hinge": {"coulomb": False}}}
    log = idtool.Log.from_arrays("run", t, ["hinge"], q=q[:, None], v=v[:, None], tau=tau[:, None])
    model = idtool.Model(tmp_path / "bar.urdf", config)
    result = idtool.fit(model, log, quick=True)
    assert result.friction["hinge"].coulomb is None
    (effect,) = result.effects
    assert effect.parameters["coulomb"] == pytest.approx(coulomb, rel=0.02)
    (written,) = result.model.config["effects"]
    assert written["parameters"]["coulomb"]["value"] == pytest.approx(coulomb, rel=0.02)
    started = idtool.validate(model, log, simulation=False)
    assert started.rms.model["hinge"] == pytest.approx(coulomb, rel=0.1)  # its prior is 0
