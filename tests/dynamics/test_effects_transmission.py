"""Joints whose motor is not fast to their link: MuJoCo has it, the entry says so.

A motor is a body with a hinge of its own in MuJoCo, which turns the gear ratio times as far as its joint.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco  # type: ignore[import-untyped]
import numpy as np
import pytest
import yaml
from commands import config_with, fitted, idtool, refuse
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from spatial_arm import (
    RATE,
    RIGID,
    Act,
    Log,
    experiment,
    recorded,
    residuals,
    rolled_out,
    spec_of,
    written,
)

from idtool.dynamics.effects import effect_types, joint_elasticity
from idtool.dynamics.effects.backlash import Backlash, _FreeMotion
from idtool.dynamics.mechanism import Transmission
from idtool.dynamics.regressor import LinearModel
from idtool.robot.model import RobotModel

Array = NDArray[np.float64]
Build = Callable[..., RobotModel]

N = 20.0  # gear ratio
K = 800.0  # N·m/rad
WIDTH = 0.01  # rad
LIFT = (
    '<robot name="r"><link name="turret"/><link name="l1"/><joint name="lift" type="revolute">'
    '<parent link="turret"/><child link="l1"/><axis xyz="0 1 0"/>'
    '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
)
PLACES: dict[str, tuple[str, list[float], list[float], list[float]]] = {
    # joint: the link that carries its motor; where it is there; its axis
    "lift": ("turret", [0.05, 0, 0.1], [0.1, 0, 0], [0, 1, 0]),
    "roll": ("upper", [0.3, 0, 0.05], [0, 0.2, 0.4], [0, 0.6, 0.8]),
}


def entry(effect: str, joint: str, **parameters: Any) -> dict[str, Any]:
    """An entry under `effects`."""
    return {"effect": effect, "joint": joint, "parameters": parameters}


def rotor(joint: str, inertia: float) -> dict[str, Any]:
    """A round motor under `rotors`."""
    parent, xyz, rpy, axis = PLACES[joint]
    inertial = {"mass": 0.2, "inertia": [inertia, 0, inertia, 0, 0, inertia]}
    origin = {"xyz": xyz, "rpy": rpy}
    return {
        "motor": {
            "joint": joint,
            "gear_ratio": N,
            "parent": parent,
            "origin": origin,
            "axis": axis,
            "inertial": inertial,
        }
    }


def with_motor(joint: str, inertia: float) -> Any:
    """The same in MuJoCo, free of its joint."""
    spec = spec_of()
    parent, xyz, rpy, axis = PLACES[joint]
    turn = Rotation.from_euler("xyz", rpy).as_quat(scalar_first=True)
    body = spec.body(parent).add_body(name="motor", pos=xyz, quat=turn, explicitinertial=True, mass=0.2)
    body.ipos, body.fullinertia = [0.0] * 3, [inertia] * 3 + [0.0] * 3
    body.add_joint(name="motor", type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
    return spec


MOTOR = 1e-4  # kg·m²
ELASTICITY = entry("joint_elasticity", "lift", stiffness=K)


@pytest.fixture(scope="module")
def elastic() -> Log:
    """The lift on a spring with a damper of 5 % of what is critical for its motor."""
    spec = with_motor("lift", MOTOR)
    tendon = spec.add_tendon(name="spring", stiffness=K, damping=2 * 0.05 * np.sqrt(K * MOTOR * N**2))
    tendon.wrap_joint("motor", 1 / N)
    tendon.wrap_joint("lift", -1)
    return recorded(spec.compile(), 2.5, motors={"lift": ("motor", N)}, sag={"lift": lambda tau: tau / K})


def test_an_elastic_joint_leaves_only_noise_and_moves_as_it_did(tmp_path: Path, elastic: Log) -> None:
    rotors = rotor("lift", MOTOR)
    with_it, without = residuals(tmp_path, elastic, ELASTICITY, rotors=rotors)
    # Part of the torque's noise is in the deflection, and what is predicted follows it.
    assert ((with_it > 0.8) & (with_it < 1.1)).all()
    assert (without > 3).all()
    assert np.abs(rolled_out(tmp_path, elastic, ELASTICITY, rotors=rotors)).max() < 1e-4
    assert np.abs(rolled_out(tmp_path, elastic, rotors=rotors)).max() > 1e-2


def test_a_rotor_that_is_no_body_turns_with_the_motor_too(tmp_path: Path, elastic: Log) -> None:
    inertia = entry("rotor_inertia", "lift", inertia=MOTOR * N**2)
    with_it, _ = residuals(tmp_path, elastic, inertia, ELASTICITY)
    assert (with_it[1:] < 1.2).all()  # the first joint turns the mass of the motor too


RUBBING = 6.0  # N·m·s/rad at the joint


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_friction_on_the_motors_side_does_not_twist_the_spring(tmp_path: Path, share: float) -> None:
    spec, rotors = with_motor("lift", MOTOR), rotor("lift", MOTOR)
    tendon = spec.add_tendon(name="spring", stiffness=K, damping=2 * 0.05 * np.sqrt(K * MOTOR * N**2))
    tendon.wrap_joint("motor", 1 / N)
    tendon.wrap_joint("lift", -1)
    model = spec.compile()
    for name, damping in (("motor", share * RUBBING / N**2), ("lift", (1 - share) * RUBBING)):
        model.dof_damping[model.joint(name).dofadr] = damping
    log = recorded(model, 2.5, motors={"lift": ("motor", N)}, sag={"lift": lambda tau: tau / K})
    friction = entry("viscous_friction", "lift", viscous=RUBBING)
    there, elsewhere = (
        entry("joint_elasticity", "lift", stiffness=K, **given) for given in ({"motor_friction": share}, {})
    )
    for one, least, most in ((there, 0.8, 1.15), (elsewhere, 1.3, np.inf)):
        left = residuals(tmp_path, log, friction, one, rotors=rotors)[0][1]
        assert least < left < most
        moved = np.abs(rolled_out(tmp_path, log, friction, one, rotors=rotors)).max()
        assert (moved < 2e-4) == (one is there)


def test_the_deflection_is_that_of_the_torque_that_the_spring_carries(tmp_path: Path, elastic: Log) -> None:
    """Its first two derivatives too, while the motor's inertia takes part of the torque."""
    urdf, csv = written(tmp_path, elastic)
    tried = experiment(urdf, csv, ELASTICITY, rotors=rotor("lift", MOTOR))
    (batch,) = tried.runs[0].signals.batches(every_sample=True)
    seen, inner = batch.motion, slice(300, -300)
    link = tried.equation.effects[-1].correct_motion(seen)
    carried = seen.tau[1] - MOTOR * N**2 * seen.a[1]
    deflection = seen.q[1] - link.q[1]
    np.testing.assert_allclose(deflection[inner], carried[inner] / K, atol=1e-4)
    assert np.ptp(deflection[inner]) > 0.02
    for x, dx in ((seen.q - link.q, seen.v - link.v), (seen.v - link.v, seen.a - link.a)):
        np.testing.assert_allclose(np.gradient(x[1], seen.dt)[inner], dx[1, inner], atol=2e-3 * np.ptp(dx[1]))
        np.testing.assert_array_equal(dx[[0, 2]], 0)


def test_what_lies_within_a_band_is_continued_over_gaps() -> None:
    """Tones up to two thirds of the band, with errors of ten times their size about the motor's reversals."""
    dt = 1e-3
    t = dt * np.arange(4000)
    tones = sum(np.sin(2 * np.pi * f * t + f) for f in (1.0, 4.7, 9.0, 13.0))
    gap = np.zeros(len(t), dtype=bool)
    for reversal in range(300, 3700, 170):
        gap[reversal - 3 : reversal + 3] = True
    broken = np.where(gap, tones + 40.0, tones)
    continued = joint_elasticity._fill_gaps(broken, gap, joint_elasticity._low_pass(20.0, dt))
    np.testing.assert_array_equal(continued[~gap], tones[~gap])
    np.testing.assert_allclose(continued[gap], tones[gap], atol=0.06)


def test_samples_whose_deflection_is_not_known_do_not_count(tmp_path: Path, elastic: Log) -> None:
    urdf, csv = written(tmp_path, elastic)
    tried = experiment(urdf, csv, ELASTICITY, rotors=rotor("lift", MOTOR))
    (batch,) = tried.runs[0].signals.batches()
    link = tried.equation.true_motion(batch.motion)
    masks = tried.equation.effects[-1].invalid_mask(link)
    assert sorted(masks) == [0, 1, 2]
    for joint, mask in masks.items():
        inner = np.flatnonzero(~mask)
        assert 20 < inner[0] < 200  # some milliseconds of a filter at 14 Hz
        assert len(mask) - 1 - inner[-1] == inner[0]
        reverses = np.flatnonzero(link.v[1, 1:] * link.v[1, :-1] < 0)
        near = np.abs(np.arange(len(mask))[:, None] - reverses).min(axis=1) < 8  # ms
        assert mask[near].all() if joint == 1 else not mask[inner[0] : inner[-1] + 1].any()


BACKLASH = entry("backlash", "roll", width=WIDTH)


def toothed(model: Any, width: float) -> tuple[Act, float]:
    """Teeth on which motor and link would swing at 200 Hz, half critically damped, which push and do not pull.

    With them comes their stiffness: 1 / the relative acceleration that a pair of torques gives the two at the start,
    times the square of that rate.
    """
    motor, link = (int(model.joint(name).dofadr[0]) for name in ("motor", "roll"))
    data, M = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, M)
    pair = np.zeros(model.nv)
    pair[motor], pair[link] = 1 / N, -1
    rate, inertia = 2 * np.pi * 200, 1 / (pair @ np.linalg.solve(M, pair))
    stiffness, damping = inertia * rate**2, inertia * rate

    def act(data: Any) -> None:
        gap, closing = (x[motor] / N - x[link] for x in (data.qpos, data.qvel))
        beyond = gap - np.clip(gap, -width / 2, width / 2)
        push = stiffness * beyond + damping * closing if beyond else 0.0
        push = push if push * beyond > 0 else 0.0
        data.qfrc_applied[motor] -= push / N
        data.qfrc_applied[link] += push

    return act, stiffness


@pytest.mark.parametrize("inertia", [1e-5, 1e-3])
def test_a_joint_with_backlash_moves_as_it_did(tmp_path: Path, inertia: float) -> None:
    """Behind a motor that is lighter than the link, and one that is far heavier."""
    log, rotors = loose(inertia), rotor("roll", inertia)
    assert np.abs(rolled_out(tmp_path, log, BACKLASH, rotors=rotors)).max() < 1e-4
    assert np.abs(rolled_out(tmp_path, log, rotors=rotors)).max() > 4e-3


def loose(inertia: float) -> Log:
    """The roll's motor plays in its gear."""
    model = with_motor("roll", inertia).compile()
    act, stiffness = toothed(model, WIDTH)
    sag = {"roll": lambda tau: tau / stiffness + np.sign(tau) * WIDTH / 2}
    return recorded(model, 1.05, act, motors={"roll": ("motor", N)}, steps=20, sag=sag)


@pytest.mark.parametrize("stiffness", [1e5, 5e6])
def test_what_is_as_good_as_stiff_moves_as_what_is_stiff(tmp_path: Path, stiffness: float) -> None:
    log, rotors = recorded(spec_of().compile(), 1.05), rotor("lift", 1e-5)
    stiff = rolled_out(tmp_path, log, rotors=rotors)
    elastic = rolled_out(tmp_path, log, entry("joint_elasticity", "lift", stiffness=stiffness), rotors=rotors)
    np.testing.assert_allclose(elastic, stiff, atol=0.03 * K / stiffness + 1e-4)


def test_backlash_explains_blips_and_what_it_does_not_is_left_out(tmp_path: Path) -> None:
    """While teeth fly and clash in MuJoCo, half of what they do is predicted; elsewhere nothing is left either way."""
    model = with_motor("roll", 1e-5).compile()
    (act, stiffness), gaps = toothed(model, WIDTH), []
    motor, link = (int(model.joint(name).dofadr[0]) for name in ("motor", "roll"))

    def noted(data: Any) -> None:
        gaps.append(data.qpos[motor] / N - data.qpos[link])
        act(data)

    sag = {"roll": lambda tau: tau / stiffness + np.sign(tau) * WIDTH / 2}
    log = recorded(model, 1.05, noted, motors={"roll": ("motor", N)}, steps=20, sag=sag)
    apart = (np.abs(gaps) < 0.49 * WIDTH).reshape(-1, 20).any(axis=1)
    urdf, csv = written(tmp_path, log)
    found = [experiment(urdf, csv, *some, rotors=rotor("roll", 1e-5)) for some in ((BACKLASH,), ())]
    (batch,) = found[0].runs[0].signals.batches(every_sample=True)
    with_it, without = (
        batch.filter(batch.motion.tau - tried.equation.torque(batch.motion, tried.equation.prior)) for tried in found
    )
    at = np.round(batch.t * RATE).astype(int)
    seen, kept = apart[at], found[0].equation.valid_samples(batch)
    assert 0.05 < seen.mean() < 0.3
    for one, other, keep in zip(with_it, without, kept, strict=True):
        assert np.square(one).sum() < 0.3 * np.square(other).sum()
        assert np.square(one[seen]).sum() < 0.25 * np.square(other[seen]).sum()
        assert not keep[seen].any()
        assert np.square(other[keep]).sum() < 1e-4 * np.square(other).sum()
        away = np.abs(np.subtract.outer(np.flatnonzero(~keep), np.flatnonzero(seen))).min(axis=1)
        assert away.max() < 150  # ms from where teeth are apart


def test_while_friction_holds_the_link_in_the_play_the_motor_does_not_overcome_it(tmp_path: Path) -> None:
    """The torque of the measured motion has the friction of a link that moves; MuJoCo's rests, or moves otherwise."""
    friction = 2.0  # N·m: more than the link's weight
    spec = with_motor("roll", 1e-5)
    spec.joint("roll").frictionloss = friction
    model = spec.compile()
    act, stiffness = toothed(model, WIDTH)
    sag = {"roll": lambda tau: tau / stiffness + np.sign(tau) * WIDTH / 2}
    log = recorded(model, 3.0, act, motors={"roll": ("motor", N)}, steps=20, sag=sag)
    urdf, csv = written(tmp_path, log)
    dry = entry("coulomb_friction", "roll", coulomb=friction)
    squares = []
    for effects in ((BACKLASH, dry), (dry,)):
        tried = experiment(urdf, csv, *effects, rotors=rotor("roll", 1e-5))
        (batch,) = tried.runs[0].signals.batches(every_sample=True)
        residual = batch.filter(batch.motion.tau - tried.equation.torque(batch.motion, tried.equation.prior))
        squares.append(np.square(residual).sum(axis=1))
    with_play, without = squares
    assert (with_play < 0.4 * without).all()


class RigidJoint:
    """What a play asks of the model without it: of a joint whose motor moves at a given velocity."""

    def __init__(self, velocity: Array, load: float, inertia: float, dry: float, viscous: float = 0.0) -> None:
        self.motion: Any = SimpleNamespace(
            t=np.arange(len(velocity)) / RATE, q=np.zeros((1, len(velocity))), v=velocity[None], dt=1 / RATE
        )
        self._load = load
        self._inertia = np.full(len(velocity), inertia)
        self._dry_friction = dry * np.sign(velocity)
        self._dry_friction_level = np.full(len(velocity), dry)
        self._viscous_friction = viscous * velocity

    def friction_torque(self, joint: int) -> Array:
        return self._dry_friction + self._viscous_friction

    def dry_friction(self, joint: int) -> tuple[Array, Array]:
        return self._dry_friction, self._dry_friction_level

    def link_load(self, motion: Any, joint: int) -> tuple[Array, Array]:
        return self._load + self.friction_torque(joint), self._inertia


def test_only_when_the_teeth_may_have_met_is_a_slow_crossing_left_out(build: Build) -> None:
    """Friction holds the link. At 3 widths per second, contact is uncertain by about 15 % of a third of a second."""
    t = np.arange(3000) / RATE
    reversal = 1.5
    velocity = np.where(t < reversal, 3 * WIDTH, -3 * WIDTH)
    model: Any = RigidJoint(velocity, load=0.5, inertia=0.1, dry=2.0)
    play = effect_types()["backlash"](lift(build), 0, {"width": WIDTH, "motor_friction": 0.0})
    play.set_operating_point(lambda motion: model, np.zeros(0))
    mask = play.invalid_mask(model.motion)[0]
    since = t - reversal
    assert not mask[(since > 0.05) & (since < 0.25)].any()
    assert mask[(since > 0.29) & (since < 0.38)].all()
    assert not mask[since > 0.45].any()


def test_in_the_play_the_link_moves_where_its_friction_balances_its_load() -> None:
    """5 N·m of load against 1 N·m and 1 N·m·s of friction: 4 rad/s, 3 faster than the motor."""
    model: Any = RigidJoint(np.ones(100), load=-5.0, inertia=1e-3, dry=1.0, viscous=1.0)
    free = _FreeMotion(model.motion, 0, 0.0, model)
    displacements, friction_corrections = free.until_contact(separation=0, width=100.0)
    assert np.diff(displacements)[-1] * RATE == pytest.approx(-3.0)
    assert friction_corrections[-1] == pytest.approx(3.0)


def test_the_widths_that_are_tried_are_those_of_the_kind_of_joint(build: Build) -> None:
    prismatic = LIFT.replace("revolute", "prismatic")
    largest = []
    for text in (LIFT, prismatic):
        summary: Any = SimpleNamespace(model=build(text, ["lift"]))
        largest.append(max(values["width"] for values in Backlash.trial_values(summary, 0)))
    assert largest == pytest.approx([0.12, 0.01])  # rad, m


def lift(build: Build) -> RobotModel:
    """A joint with the lift's motor."""
    return build(LIFT, ["lift"], rotors=rotor("lift", MOTOR))


def gears(build: Build, *entries: dict[str, Any]) -> dict[int, Transmission]:
    """What entries make of a joint with the lift's motor."""
    model = lift(build)
    effects = [effect_types()[e["effect"]](model, 0, e["parameters"]) for e in entries]
    return LinearModel(("lift",), tuple(effects)).mechanism(model, np.zeros(0)).transmissions


def test_a_gear_may_give_and_play(build: Build) -> None:
    play = entry("backlash", "lift", width=0.02)
    for entries in ((ELASTICITY, play), (play, ELASTICITY)):
        assert gears(build, *entries) == {0: Transmission(K, 0.05, 0.02)}
    assert gears(build, ELASTICITY) == {0: Transmission(K, 0.05, 0.0)}
    assert gears(build, play) == {0: Transmission(np.inf, 0.5, 0.02)}


@pytest.mark.parametrize("given", [ELASTICITY, BACKLASH], ids=lambda given: given["effect"])
def test_without_a_rotor_it_cannot_be_simulated(tmp_path: Path, elastic: Log, given: dict[str, Any]) -> None:
    urdf, csv = written(tmp_path, {name: x[:600] for name, x in elastic.items()})
    config = config_with(tmp_path / "arm.yaml", **RIGID, effects=[given])
    refuse(
        tmp_path,
        "simulate",
        urdf,
        csv,
        "--out",
        "out/a.csv",
        naming="cannot be simulated: a joint has zero or negative inertia",
    )
    inertia = entry("rotor_inertia", given["joint"], inertia=0.04)
    config_with(config, **RIGID, effects=[inertia, given])
    assert idtool("simulate", urdf, csv, "--out", tmp_path / "a.csv", "--quiet").code == 0


def test_without_a_rotor_it_can_be_fitted(tmp_path: Path, elastic: Log) -> None:
    urdf, csv = written(tmp_path, {name: x[:600] for name, x in elastic.items()})
    config_with(tmp_path / "arm.yaml", **RIGID, effects=[ELASTICITY])
    said = fitted(tmp_path / "fitted", urdf, csv, simulated=True)["warnings"]
    assert any("cannot be simulated" in warning for warning in said)


def test_every_command_takes_the_entries_and_the_model_keeps_them(tmp_path: Path, elastic: Log) -> None:
    entries = [ELASTICITY, entry("backlash", "lift", width={"value": 0.002, "standard_error": 1e-4})]
    urdf, csv = written(tmp_path, {name: x[:1000] for name, x in elastic.items()})
    config = config_with(tmp_path / "given.yaml", **RIGID, rotors=rotor("lift", MOTOR), effects=entries)
    done = idtool("fit", urdf, csv, "--config", config, "--out", tmp_path / "out", "--quiet", "--no-simulation")
    assert done.code == 0, done.err
    model = tmp_path / "out" / "model.yaml"
    assert yaml.safe_load(model.read_text())["effects"] == entries
    for command, out in ((["validate", "--no-simulation"], "again"), (["simulate"], "simulated.csv")):
        identified = tmp_path / "out" / "identified.urdf"
        done = idtool(*command, identified, csv, "--config", model, "--out", tmp_path / out, "--quiet")
        assert done.code == 0, done.err


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no stiffness": (
        entry("joint_elasticity", "lift", stiffness=0),
        "joint_elasticity: stiffness of 0 is out of range",
    ),
    "a spring that pushes": (entry("joint_elasticity", "lift", stiffness=-5), "stiffness of -5 is out of range"),
    "an unknown joint": (
        entry("joint_elasticity", "lit", stiffness=5),
        "lit is not a moving joint; did you mean lift?",
    ),
    "no width": (entry("backlash", "lift", width=0), "backlash: width of 0 is out of range"),
    "a list": (entry("backlash", "lift", width=[0.1]), "backlash: width is not a number"),
}


@pytest.mark.parametrize(("bad", "message"), BAD.values(), ids=BAD)
def test_a_bad_entry_is_refused(tmp_path: Path, bad: dict[str, Any], message: str) -> None:
    rest = {"t": np.arange(300) / RATE, **{name: np.zeros((300, 3)) for name in ("q", "v", "tau")}}
    urdf, csv = written(tmp_path, rest)
    config_with(tmp_path / "arm.yaml", effects=[bad])
    refuse(tmp_path, "fit", urdf, csv, "--out", "out", naming=message)
