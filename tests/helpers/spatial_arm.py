"""A spatial arm with a tool, moved by MuJoCo from rest, and the log of its sensors; made without idtool.

Letters: q, v positions and velocities, tau the actuators' torque; shape (N, nv) in a log. Units: rad, s, N·m.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray
from scipy import signal

from idtool.dynamics.simulation.simulation import simulate
from idtool.dynamics.simulation.windows import Window, split_into_windows
from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.estimation.evaluation.torque_errors import evaluate
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]
Log = dict[str, Array]
Act = Callable[[Any], None]  # applies forces to MuJoCo's data before a step

JOINTS = ("turn", "lift", "roll")
RATE, STEPS = 1000, 4  # samples a second; steps of MuJoCo's a sample
BAND = 40.0  # Hz, idtool's default at this rate
NOISE = 0.02  # N·m, of the torque as logged
RIGID = {"friction": {"viscous": False, "coulomb": False}}


def _link(name: str, com: str, mass: float, moments: Sequence[float]) -> str:
    xx, xy, yy, xz, yz, zz = moments
    return (
        f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>'
        f'<inertia ixx="{xx}" ixy="{xy}" iyy="{yy}" ixz="{xz}" iyz="{yz}" izz="{zz}"/></inertial></link>'
    )


def _joint(name: str, kind: str, parent: str, child: str, origin: str, axis: str = "0 0 1") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin {origin}/>'
        f'<axis xyz="{axis}"/><limit lower="-3" upper="3" effort="100" velocity="20"/></joint>'
    )


# The flange is without inertial; the tool, on it, is turned against it.
ARM = "\n".join(
    [
        '<robot name="arm"><link name="base"/>',
        _link("turret", "0.02 0.01 0.05", 2.0, (0.02, 0.001, 0.02, -0.001, 0, 0.03)),
        _link("upper", "0.12 0.01 0.02", 1.4, (0.01, 0.001, 0.03, 0.002, 0, 0.03)),
        _link("fore", "0.10 -0.02 0.01", 0.9, (0.006, -0.001, 0.012, 0, 0.001, 0.014)),
        '<link name="flange"/>',
        _link("tool", "0.02 0.03 0.01", 0.3, (0.002, 0, 0.001, 0, 0, 0.002)),
        _joint("turn", "revolute", "base", "turret", 'xyz="0 0 0.1" rpy="0.3 -0.2 0.1"'),
        _joint("lift", "revolute", "turret", "upper", 'xyz="0.05 0 0.1" rpy="0.1 0 0"', "0 1 0"),
        _joint("roll", "revolute", "upper", "fore", 'xyz="0.3 0 0.05" rpy="0 0.2 0.4"', "0 0.6 0.8"),
        _joint("end", "fixed", "fore", "flange", 'xyz="0.2 0.05 0" rpy="0.5 0.1 -0.7"'),
        _joint("grip", "fixed", "flange", "tool", 'xyz="0.03 0 0.06" rpy="-0.4 0.8 0.2"'),
        "</robot>",
    ]
)


def spec_of(text: str = ARM) -> Any:
    """A URDF in MuJoCo, all its bodies kept, without limits."""
    spec = mujoco.MjSpec.from_string(text)
    spec.compiler.fusestatic = False
    spec.option.timestep, spec.option.integrator = 1 / (RATE * STEPS), mujoco.mjtIntegrator.mjINT_RK4
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    return spec


def reference(t: float, joints: int = 3) -> Array:
    """Reference position of the arm: at rest at first, then many angles and speeds."""
    k = np.arange(joints)
    begun = min(max(t - 0.05, 0) / 0.5, 1)
    slow, fast = np.sin((0.9 + 0.35 * k) * t + 1.3 * k), np.sin((5.3 + 1.1 * k) * t + k)
    return np.asarray(begun**3 * (10 - 15 * begun + 6 * begun**2) * ((1.1 - 0.1 * k) * slow + (0.25 + 0.05 * k) * fast))


def recorded(
    model: Any,
    seconds: float,
    act: Act = lambda data: None,
    joints: Sequence[str] = JOINTS,
    motors: Mapping[str, tuple[str, float]] | None = None,
    steps: int = STEPS,
    sag: Mapping[str, Callable[[float], float]] | None = None,
) -> Log:
    """The arm follows `reference`: t (N,), q, v and tau (N, nv), a sample being in the middle of its steps.

    The torque is constant in a step; a sample has the mean of its steps'.

    Parameters
    ----------
    model, seconds, joints
        What moves, for how long, and its joints.
    act
        Called before every step; forces in qfrc_applied and xfrc_applied hold for it.
    motors
        Of joints that are measured and driven elsewhere: MuJoCo's joint, and its angle per angle of theirs.
    steps
        A sample.
    sag
        By how much such a joint is behind its motor under a torque, to begin at rest.
    """
    data, every = mujoco.MjData(model), [(motors or {}).get(name, (name, 1.0)) for name in joints]
    at, link = ([int(model.joint(name).dofadr[0]) for name in names] for names in ((m for m, _ in every), joints))
    ratio, behind = np.array([r for _, r in every]), [(sag or {}).get(name, lambda tau: 0.0) for name in joints]
    model.opt.timestep = 1 / (RATE * steps)
    samples = round(seconds * RATE)
    log = {"t": np.arange(samples) / RATE, **{x: np.zeros((samples, len(at))) for x in ("q", "v", "tau")}}
    for _ in range(30):
        mujoco.mj_forward(model, data)
        data.qpos[link] = [-of(tau) for of, tau in zip(behind, data.qfrc_bias[link], strict=True)]
    for k in range(samples * steps):
        q, v = data.qpos[at] / ratio, data.qvel[at] / ratio
        if k % steps == steps // 2:
            log["q"][k // steps], log["v"][k // steps] = q, v
        act(data)
        tau = data.qfrc_bias[link] + 60 * (reference(data.time, len(at)) - q) - 3 * v
        log["tau"][k // steps] += tau / steps
        data.qfrc_applied[at] += tau / ratio
        mujoco.mj_step(model, data)
        data.qfrc_applied[:] = 0
    return log


def written(
    folder: Path, log: Log, joints: Sequence[str] = JOINTS, noise: float = 0.0, text: str = ARM
) -> tuple[Path, Path]:
    """The URDF and the log as CSV, with noise on its torque."""
    folder.mkdir(exist_ok=True)
    urdf, csv = folder / "arm.urdf", folder / "arm.csv"
    urdf.write_text(text)
    tau = log["tau"] + noise * noise_of(log["tau"].shape)
    names = ["t", *(f"{name}_{joint}" for name in ("q", "v", "tau") for joint in joints)]
    table = np.column_stack([log["t"], log["q"], log["v"], tau])
    np.savetxt(csv, table, delimiter=",", header=",".join(names), comments="", fmt="%.12g")
    return urdf, csv


def noise_of(shape: tuple[int, ...]) -> Array:
    """White, of size 1, the same in every log of a length."""
    return np.random.default_rng(5).normal(size=shape)


def in_band(x: Array) -> Array:
    """A signal (N, nv) through the filter that idtool's errors are seen through."""
    sections = signal.butter(4, BAND, fs=RATE, output="sos")
    return np.asarray(signal.sosfiltfilt(sections, x, axis=0))


def experiment(urdf: Path, csv: Path, *entries: Mapping[str, Any], fitted: bool = False, **config: Any) -> Experiment:
    """A log and a configuration with entries under `effects`, all of the log to be fitted or validated."""
    parsed = parse_config({**RIGID, **config, "effects": list(entries)}, "")
    logs = ([csv], []) if fitted else ([], [csv])
    return prepare(read_robot(urdf), parsed, *logs, holdout=0)


def residual(tried: Experiment) -> Array:
    """RMS error of the torque in the band, the URDF taken as true, shape (nv,) [N·m]."""
    found = evaluate(tried, {"model": tried.equation.prior}, True, lambda stage, share: None)
    rms = found.errors["model"].rms(tried.equation.joints)
    return np.array([rms[name] for name in tried.equation.joints])


def residuals(
    folder: Path, log: Log, *entries: Mapping[str, Any], joints: Sequence[str] = JOINTS, text: str = ARM, **config: Any
) -> tuple[Array, Array]:
    """`residual` over the noise's own with the entries and without them, shape (nv,) each."""
    urdf, csv = written(folder, log, joints, NOISE, text)
    noise = np.sqrt(np.mean(np.square(in_band(NOISE * noise_of(log["tau"].shape))), axis=0))
    with_them, without = (residual(experiment(urdf, csv, *some, **config)) / noise for some in (entries, ()))
    return with_them, without


def rolled_out(
    folder: Path,
    log: Log,
    *entries: Mapping[str, Any],
    seconds: float = 1.0,
    joints: Sequence[str] = JOINTS,
    text: str = ARM,
    **config: Any,
) -> Array:
    """Distance of idtool's simulated motion under the logged torque from the logged one, shape (N, nv) [rad]."""
    urdf, csv = written(folder, {name: x[: round(seconds * RATE) + 1] for name, x in log.items()}, joints, 0.0, text)
    tried = experiment(urdf, csv, *entries, **config)
    mechanism = tried.equation.mechanism(tried.model, tried.equation.prior)
    signals, parts = tried.runs[0].signals, tried.runs[0].held_out
    windows = [Window(signals, part) for part in split_into_windows(signals, parts, None)]
    (found,) = simulate(mechanism, windows, lambda share: None)
    return np.asarray(found.q[:, 0].T - log["q"][: found.q.shape[2]])
