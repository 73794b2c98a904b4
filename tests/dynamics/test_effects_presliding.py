"""Friction that builds up along the path: MuJoCo's arm has it, the entry says so, the amplitude is found."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import config_with, refuse
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from spatial_arm import NOISE, RATE, STEPS, Act, Log, experiment, recorded, residuals, rolled_out, spec_of, written

from idtool.data.signals import Motion
from idtool.dynamics.effects.presliding_hysteresis import PreslidingHysteresis
from idtool.estimation.fit import fit
from idtool.reporting.fit_report import model_config
from idtool.robot.model import RobotModel

Array = NDArray[np.float64]
Build = Callable[..., RobotModel]

AMPLITUDE, DISPLACEMENT, DAMPING = 1.0, 0.01, 0.01  # N·m, rad, s


def entry(effect: str, joint: str, **parameters: Any) -> dict[str, Any]:
    """An entry under `effects`."""
    return {"effect": effect, "joint": joint, "parameters": parameters}


def dahl(model: Any, damping: float = 0.0) -> Act:
    """Dahl's friction on the lift, its state in the middle of every step; with a damping of the bristles, LuGre's."""
    lift = int(model.joint("lift").dofadr[0])
    state = {"z": 0.0, "q": 0.0}

    def moved(z: float, way: float) -> float:
        return float(solve_dahl(z, np.sign(way), abs(way)))

    def act(data: Any) -> None:
        q, v = data.qpos[lift], data.qvel[lift]
        state["z"] = moved(state["z"], q - state["q"])
        state["q"] = q
        z = moved(state["z"], v / (2 * RATE * STEPS))
        data.qfrc_applied[lift] -= AMPLITUDE * (z + damping * v / DISPLACEMENT * (1 - z * np.sign(v)))

    return act


def solve_dahl(z: float, s: float, way: float) -> float:
    """dz/dx = (1 − s z) s / displacement by a Runge–Kutta step, exact to 1e-9 for such ways."""
    h = way / DISPLACEMENT

    def slope(z: float) -> float:
        return s * (1 - s * z)

    k1 = slope(z)
    k2 = slope(z + h / 2 * k1)
    k3 = slope(z + h / 2 * k2)
    return z + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(z + h * k3))


@pytest.fixture(scope="module")
def hysteretic() -> Log:
    """The lift with Dahl's friction."""
    model = spec_of().compile()
    return recorded(model, 2.2, dahl(model))


def test_hysteresis_leaves_only_noise_and_moves_as_it_did(tmp_path: Path, hysteretic: Log) -> None:
    given = entry("presliding_hysteresis", "lift", amplitude=AMPLITUDE, displacement=DISPLACEMENT)
    with_it, without = residuals(tmp_path, hysteretic, given)
    np.testing.assert_allclose(with_it, 1, atol=0.06)
    assert without[1] > 20
    coulomb = residuals(tmp_path, hysteretic, entry("coulomb_friction", "lift", coulomb=AMPLITUDE))[0]
    assert coulomb[1] > 20
    assert np.abs(rolled_out(tmp_path, hysteretic, given)).max() < 1e-4
    assert np.abs(rolled_out(tmp_path, hysteretic, seconds=0.5)).max() > 1e-2


def test_damped_bristles_leave_only_noise_and_move_as_they_did(tmp_path: Path) -> None:
    log = recorded(spec_of().compile(), 2.2, dahl(spec_of().compile(), DAMPING))
    plain = entry("presliding_hysteresis", "lift", amplitude=AMPLITUDE, displacement=DISPLACEMENT)
    given = {**plain, "parameters": {**plain["parameters"], "damping": DAMPING}}
    with_it, without = (residuals(tmp_path, log, one)[0] for one in (given, plain))
    np.testing.assert_allclose(with_it, 1, atol=0.06)
    assert without[1] > 3
    moved, undamped = (np.abs(rolled_out(tmp_path, log, one)).max() for one in (given, plain))
    assert moved < min(5e-4, 0.2 * undamped)


@pytest.mark.parametrize("jitter", [0.0, 1e-5, 1e-4])
def test_the_amplitude_is_found_whatever_the_encoders_noise(tmp_path: Path, hysteretic: Log, jitter: float) -> None:
    """At rest, too, where noise goes a long way to and fro, the state stays as it was."""
    q = hysteretic["q"] + jitter * np.random.default_rng(3).normal(size=hysteretic["q"].shape)
    urdf, csv = written(tmp_path, {**hysteretic, "q": q, "v": np.gradient(q, 1 / RATE, axis=0)}, noise=NOISE)
    given = entry("presliding_hysteresis", "lift", amplitude=0.0, displacement=DISPLACEMENT)
    done = fit(experiment(urdf, csv, given, fitted=True), lambda stage, share: None)
    (found,) = model_config(done)["effects"]
    amplitude = found["parameters"]["amplitude"]
    assert amplitude["value"] == pytest.approx(AMPLITUDE, abs=0.02)
    assert 0 < amplitude["standard_error"] < 0.03
    assert found["parameters"]["displacement"] == DISPLACEMENT


ONE = (
    '<robot name="r"><link name="a"/><link name="b"/><joint name="x" type="continuous">'
    '<parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>'
)


def along(q: Array) -> Motion:
    """Samples of one joint's position."""
    dt = 1e-3
    x, nothing = q[None], np.zeros((1, len(q)))
    v = np.gradient(x, dt, axis=1)
    return Motion(np.arange(len(q)) * dt, x, v, nothing, nothing, nothing, np.array([3e-3]), dt)


def test_the_state_follows_dahls_equation(build: Build) -> None:
    """Against scipy's integration of it; from a joint that moves at its first sample, thus fully turned."""
    effect = PreslidingHysteresis(build(ONE, ["x"]), 0, 1.0, {"displacement": 0.05})
    t = np.arange(3000) * 1e-3
    q = 0.2 * np.sin(4 * t) + 0.1 * np.cos(11 * t)

    def slope(t: float, z: Array) -> Array:
        v = 0.8 * np.cos(4 * t) - 1.1 * np.sin(11 * t)
        return np.asarray(v / 0.05 * (1 - z * np.sign(v)))

    expected = solve_ivp(slope, (0, t[-1]), [1.0], t_eval=t, max_step=1e-3, rtol=1e-8, atol=1e-10).y[0]
    assert np.ptp(expected) > 1.5
    np.testing.assert_allclose(effect.column(along(q)), expected, atol=3e-3)
    undefined = effect.invalid_mask(along(q))[0]
    first = int(np.argmin(undefined))
    assert np.abs(np.diff(q[: first + 1])).sum() == pytest.approx(4 * 0.05, abs=2e-3)
    assert not undefined[first:].any()
    assert undefined[: first - 1].all()


def test_where_a_loop_began_is_forgotten_to_and_fro(build: Build) -> None:
    """A joint whose whole travel is less than four displacements: scipy's integration from either end of the loop."""
    displacement = 0.12
    effect = PreslidingHysteresis(build(ONE, ["x"]), 0, 1.0, {"displacement": displacement})
    t = np.arange(4000) * 1e-3
    q = 0.15 * np.sin(3 * t)

    def slope(t: float, z: Array) -> Array:
        v = 0.45 * np.cos(3 * t)
        return np.asarray(v / displacement * (1 - z * np.sign(v)))

    first, other = (
        solve_ivp(slope, (0, t[-1]), [z], t_eval=t, max_step=1e-3, rtol=1e-8, atol=1e-10).y[0] for z in (1.0, -1.0)
    )
    assert np.ptp(q) < 4 * displacement
    undefined = effect.invalid_mask(along(q))[0]
    assert not undefined[-1]
    assert np.abs(first - other)[~undefined].max() == pytest.approx(2 * np.exp(-4), rel=0.02)


def test_the_state_of_a_joint_at_rest_does_not_fade_in_noise(build: Build) -> None:
    effect = PreslidingHysteresis(build(ONE, ["x"]), 0, 1.0, {"displacement": 1e-3})
    q = np.minimum(np.arange(4000) * 1e-4, 0.05) + 2e-6 * np.random.default_rng(0).normal(size=4000)
    assert effect.column(along(q))[-1] > 0.99


def test_a_displacement_that_no_motion_of_the_log_tells_is_refused(tmp_path: Path, hysteretic: Log) -> None:
    urdf, csv = written(tmp_path, hysteretic, noise=NOISE)
    given = entry("presliding_hysteresis", "lift", amplitude=AMPLITUDE, displacement=1e3)
    config_with(tmp_path / "arm.yaml", effects=[given])
    part = "the part of the logs that is used for the fit"
    said = f"joint lift hardly moves in {part}, or only where one of the effects (presliding_hysteresis) is not"
    refuse(tmp_path, "fit", urdf, csv, "--out", "out", naming=said)


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no displacement": (
        entry("presliding_hysteresis", "lift", amplitude=1, displacement=0),
        "presliding_hysteresis: displacement of 0 is out of range",
    ),
    "friction that drives": (
        entry("presliding_hysteresis", "lift", amplitude=-1, displacement=0.1),
        "presliding_hysteresis: amplitude of -1 is out of range; give 0 or more",
    ),
    "damping that drives": (
        entry("presliding_hysteresis", "lift", amplitude=1, displacement=0.1, damping=-0.1),
        "presliding_hysteresis: damping of -0.1 is out of range; give a value from 0 to 0.5",
    ),
    "one of two": (
        entry("presliding_hysteresis", "lift", amplitude=1),
        "presliding_hysteresis: needs the parameters amplitude, displacement; add displacement",
    ),
}


@pytest.mark.parametrize(("bad", "message"), BAD.values(), ids=BAD)
def test_a_bad_entry_is_refused(tmp_path: Path, bad: dict[str, Any], message: str) -> None:
    rest = {"t": np.arange(300) / RATE, **{name: np.zeros((300, 3)) for name in ("q", "v", "tau")}}
    urdf, csv = written(tmp_path, rest)
    config_with(tmp_path / "arm.yaml", effects=[bad])
    refuse(tmp_path, "fit", urdf, csv, "--out", "out", naming=message)
