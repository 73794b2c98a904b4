"""What acts on the joints of an exported file in MuJoCo, and that it moves as in idtool."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from commands import SAMPLES
from exported import EXACT, InMujoco, arm, mass_and_bias, model_of, sample, state, with_couplings
from numpy.typing import NDArray
from reference import Reference

from idtool.dynamics.effects import build_effects
from idtool.dynamics.regressor import LinearModel
from idtool.dynamics.simulation.rollouts import Rollouts
from idtool.reporting.export import IdentifiedModel, to_mujoco

Array = NDArray[np.float64]


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    """Where a test writes its robot."""
    return tmp_path / "identified.urdf"


TERMS: dict[str, Any] = {
    "friction": {"viscous": {"value": 0.3}, "coulomb": {"value": 0.7}, "offset": {"value": -0.4}},
    "effects": [
        {"effect": "parallel_spring", "joint": "hip", "parameters": {"stiffness": 5.0, "rest_position": 0.6}},
        {"effect": "coulomb_friction", "joint": "knee", "parameters": {"coulomb": 1.1}},
    ],
}


def test_what_acts_on_a_joint_acts_in_mujoco(rng: np.random.Generator) -> None:
    urdf = SAMPLES / "leg.urdf"
    config = {**sample(urdf), **TERMS}
    export = to_mujoco(model_of(urdf, **config))
    assert export.not_carried == ()
    found = InMujoco(export, config["joints"])
    reference = Reference(urdf.read_text(), config["joints"], with_couplings(config))
    for _ in range(10):
        q = np.array([0.3, 0.5, -1.5]) + rng.uniform(-0.5, 0.5, 3)
        v = rng.choice([-1, 1], 3) * rng.uniform(2, 5, 3)
        tau = rng.uniform(-5, 5, 3)
        M, h = mass_and_bias(reference, q, v)
        acts = 0.3 * v + np.array([0.7, 0.7, 1.1]) * np.sign(v) - 0.4 + np.array([0, 5.0, 0]) * (q - 0.6)
        expected = np.linalg.solve(M, tau - h - acts)
        np.testing.assert_allclose(found.acceleration(q, v, tau), expected, rtol=1e-6, atol=1e-4)


def test_friction_holds_what_is_below_its_level() -> None:
    urdf = SAMPLES / "leg.urdf"
    config = {**sample(urdf), "friction": {"viscous": 0.1, "coulomb": 3.0}}
    found = InMujoco(to_mujoco(model_of(urdf, **config)), config["joints"])
    q = np.array([0.2, 0.4, -1.0])
    load = found.mass_and_bias(q, np.zeros(3))[1]
    assert 0.5 < np.abs(load).max() < 3.0
    for _ in range(1000):
        mujoco.mj_step(found.model, found.data)
    assert np.abs(found.state[0] - q).max() < 1e-5


KP, KD, STEPS = np.array([60.0, 60.0, 40.0]), np.array([1.5, 1.5, 1.0]), 1500


def swinging(t: Array, middle: Array) -> Array:
    """A motion that turns round often, shape (len(t), 3)."""
    return np.asarray(middle + np.array([0.4, 0.6, 0.6]) * np.sin(2 * np.pi * np.outer(t, [0.8, 1.1, 1.4])))


def idtools_rollout(identified: IdentifiedModel, target: Array) -> Array:
    """Positions at every millisecond under a sampled controller, shape (steps, nv)."""
    equation = LinearModel(identified.model.names, build_effects(identified.model, identified.config))
    mechanism = equation.mechanism(identified.model, equation.prior)
    start, held = target[0][:, None], (KP * 0)[:, None]
    rollout = Rollouts(mechanism, np.zeros(1), start, np.zeros_like(start), lambda t, q, v, lanes: held, step=5e-4)
    out = []
    for k, goal in enumerate(target, 1):
        out.append(rollout.q[:, 0])
        held = (KP * (goal - rollout.q[:, 0]) - KD * rollout.v[:, 0])[:, None]
        rollout.advance(np.array([k * 1e-3]))
    return np.array(out)


def mujocos_rollout(found: InMujoco, target: Array, step: float = 1e-3) -> Array:
    """The same in MuJoCo, as the file is but for the step."""
    found.model.opt.timestep = step
    found.set(target[0], np.zeros(3))
    out = []
    for goal in target:
        q, v = found.state
        out.append(q.copy())
        found.data.ctrl[found.motors] = KP * (goal - q) - KD * v
        mujoco.mj_step(found.model, found.data, round(1e-3 / step))
    return np.array(out)


@pytest.mark.parametrize(("robot", "middle"), [("leg", [0.0, 0.0, -1.2]), ("belt_arm", [0.0, -0.3, 0.8])])
def test_mujoco_gives_idtools_rollout_under_the_same_controller(robot: str, middle: list[float]) -> None:
    urdf = SAMPLES / f"{robot}.urdf"
    identified = model_of(urdf, **{**sample(urdf), "friction": {"viscous": 0.1, "coulomb": 0.8}})
    target = swinging(1e-3 * np.arange(STEPS), np.array(middle))
    ours = idtools_rollout(identified, target)
    export = to_mujoco(identified)
    error = [
        np.sqrt(((mujocos_rollout(InMujoco(export, identified.model.names), target, step) - ours) ** 2).mean())
        for step in (1e-3, 2.5e-4)
    ]
    assert np.sqrt(((ours - target) ** 2).mean()) > 0.03  # the controller is soft enough for the model to matter
    assert error[0] < 2e-3
    assert error[1] < error[0] / 2.5  # what is left is MuJoCo's step


def test_followers_follow(rng: np.random.Generator, urdf: Path) -> None:
    mimic = '<mimic joint="j1" multiplier="-0.5" offset="0.2"/>'
    urdf.write_text(
        arm(rng, "0 0 1", "0 1 0", "0 1 0").replace('<axis xyz="0 1 0"/>', f'<axis xyz="0 1 0"/>{mimic}', 1)
    )
    export = to_mujoco(model_of(urdf))
    assert [part.of for part in export.carried if part.what == "mimic"] == ["j2"]
    spinning = {"j2": (np.array([-0.5, 0.0]), 0.2)}
    found = InMujoco(export, ["j1", "j3"], spinning)
    reference = Reference(urdf.read_text(), ["j1", "j3"], {"gravity": [0, 0, -9.81]})
    q, v = state(rng, 2)
    for ours, theirs in zip(found.mass_and_bias(q, v), mass_and_bias(reference, q, v), strict=True):
        np.testing.assert_allclose(ours, theirs, **EXACT)
    M, h = mass_and_bias(reference, q, v)
    tau = rng.uniform(-5, 5, 2)
    np.testing.assert_allclose(found.acceleration(q, v, tau), np.linalg.solve(M, tau - h), rtol=1e-3, atol=1e-2)
    for _ in range(300):
        mujoco.mj_step(found.model, found.data)
    place = dict(zip(("j1", "j2", "j3"), found.data.qpos, strict=True))
    assert abs(place["j1"] - q[0]) > 0.1
    assert place["j2"] == pytest.approx(0.2 - 0.5 * place["j1"], abs=1e-4)
