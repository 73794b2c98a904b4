"""The paper's leg in MuJoCo, in closed loop along a commanded motion, with realistic sensors.

An independent witness: nothing of idtool takes part but its `JointLog`. The leg's true bodies and friction are those of
sample_logs/truth.yaml (`TRUTH`), or drawn anew (`draw_truth`); what its designer believed is in sample_logs/leg.*.

>>> motion = fourier(seed=3, seconds=10.0)
>>> log = run_leg(motion.q, motion.v, seed=3, acmd=motion.a)
>>> theta = true_theta(experiment)

A joint PD controller with a feed-forward follows the command. It knows only what the sensors read, so that their noise
and steps go round the loop into torque and motion, and its feed-forward knows only the prior. The motions are in
leg_motions.py, the truth in leg_truth.py, the simulated leg in leg_plants.py; all of it is to be had from here.

Letters: q [rad], v [rad/s], a [rad/s^2] of the joints abad, hip and knee; tau [N m] at the joint output; each (N, 3),
at 1 kHz.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import mujoco  # type: ignore[import-untyped]
import numpy as np
from leg_motions import RATE, Motion, fourier, position_limits, shell
from leg_plants import Plant, elastic, inverse_dynamics, rigid
from leg_truth import GEAR_RATIO, JOINTS, PAPER, SAMPLES, TRUTH, URDF, Truth, draw_truth, prior_truth, true_theta
from numpy.typing import NDArray
from scipy.signal import lfilter
from two_mass import Friction, Run

from idtool.data.logs import JointLog, make_log

__all__ = ["GENTLE", "JOINTS", "PERFECT", "RATE", "SAMPLES", "TRUTH", "URDF", "Controller", "LegRun", "LegSensors"]
__all__ += ["Friction", "Motion", "Truth", "as_log", "draw_truth", "encoder_step", "fourier", "inverse_dynamics"]
__all__ += ["position_limits", "prior_truth", "run_leg", "run_shell", "shell", "track_leg", "true_theta"]

Array = NDArray[np.float64]

_LOST = 0.7  # rad from the command: the loop is unstable
_SMOOTH = 0.01  # rad/s over which the friction feed-forward changes its sign


@dataclass(frozen=True)
class LegSensors:
    """Sensors of the drives. The defaults are those of the sample logs.

    Attributes
    ----------
    position_step
        Encoder resolution at the joint [rad]; zero: none. See `encoder_step`.
    position_noise
        Standard deviation of white noise on the position before it is rounded [rad].
    velocity_lag
        By how much the velocity, differenced from the rounded position and smoothed by a first-order low-pass, lags
        [s]; half a sample of it is the backward difference's own. The controller uses this velocity.
    velocity_noise
        None: that velocity is logged. Else the log's and the controller's is the true one with white noise of this
        standard deviation, as of a tachometer or gyroscope [rad/s].
    torque_noise
        Standard deviation of white noise on the logged torque [N m].
    coloured_noise, coloured_time
        Standard deviation [N m] and correlation time [s] of first-order autoregressive noise on top of it.
    acting_share
        Share of the torque errors' variance that acts on the leg: the drive delivers less torque than it logs, which
        changes the motion. The rest is on the log only. With 0, the motion is the same for every seed.
    logs_velocity
        True if the log has v.
    """

    position_step: float = PAPER.SENSORS.position_step
    position_noise: float = 0.0
    velocity_lag: float = PAPER.SENSORS.velocity_lag
    velocity_noise: float | None = None
    torque_noise: float = PAPER.SENSORS.torque_noise
    coloured_noise: float = 0.0
    coloured_time: float = 0.2
    acting_share: float = 0.0
    logs_velocity: bool = True

    def torque_errors(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
        """Errors of the measured torque [N m]."""
        white = self.torque_noise * rng.normal(size=shape)
        if not self.coloured_noise:
            return white
        keep = np.exp(-1 / (RATE * self.coloured_time))
        drive = rng.normal(size=shape) * np.sqrt(1 - keep**2)
        drive[0] /= np.sqrt(1 - keep**2)
        return white + self.coloured_noise * np.asarray(lfilter([1], [1, -keep], drive, axis=0))


PERFECT = LegSensors(position_step=0.0, velocity_lag=0.5e-3, velocity_noise=0.0, torque_noise=0.0)


def encoder_step(bits: int, on_motor: bool = True) -> float:
    """Resolution at the joint [rad] of an encoder of so many bits a turn, on the motor or at the joint."""
    return float(2 * np.pi / 2**bits / (GEAR_RATIO if on_motor else 1.0))


@dataclass(frozen=True)
class Controller:
    """A joint PD controller with a feed-forward that knows the prior only.

    tau = feed-forward + kp (qcmd - q) + kd (vcmd - v), of what the sensors read a millisecond before.

    Attributes
    ----------
    kp, kd
        Of every joint [N m/rad, N m s/rad]. A differenced velocity jumps by step / (0.5 ms + velocity_lag): a coarse
        encoder wants a small kd and a longer velocity_lag.
    feedforward
        ``none``; ``friction``, the prior's friction at the commanded velocity; ``model``, the prior's inverse dynamics
        along the command too.
    coulomb
        Coulomb friction of the feed-forward [N m]; default: the prior's, a third too little for abad, which then
        sticks for up to 40 ms at its reversals. With `TRUTH`'s, as if tuned by hand, for half as long.
    """

    kp: Sequence[float] = (600.0, 600.0, 300.0)
    kd: Sequence[float] = (12.0, 12.0, 6.0)
    feedforward: Literal["none", "friction", "model"] = "model"
    coulomb: Sequence[float] | None = None


GENTLE = Controller(kp=(75.0, 75.0, 37.5), kd=(3.0, 3.0, 1.5))  # for encoders of 10 bits, with a lag of 5 to 10 ms


@dataclass(frozen=True)
class LegRun:
    """A log and the true motion, a `two_mass.Run` with a, tau and friction averaged over each sample's millisecond."""

    log: JointLog
    true: Run


def run_leg(qcmd: Array, vcmd: Array, seed: int, **options: Any) -> JointLog:
    """Run the leg along a command and log q, v, tau, qcmd and vcmd; as `track_leg`, without the true motion."""
    return track_leg(qcmd, vcmd, seed, **options).log


def track_leg(
    qcmd: Array,
    vcmd: Array,
    seed: int,
    *,
    acmd: Array | None = None,
    truth: Truth = TRUTH,
    sensors: LegSensors | None = None,
    controller: Controller | None = None,
    gears: Literal["rigid", "elastic"] = "rigid",
) -> LegRun:
    """Run the leg along a command.

    Parameters
    ----------
    qcmd, vcmd
        Commanded positions and velocities at 1 kHz, (N, 3); the leg starts on them.
    seed
        Of the sensors' noise.
    acmd
        Commanded acceleration, for the feed-forward; default: the derivative of vcmd.
    truth
        The leg.
    sensors, controller
        Default: the sample logs' sensors, and a stiff controller with a feed-forward.
    gears
        ``elastic`` is the simulation of the sample logs, a rotor behind an elastic gear; it takes twice as long.

    Raises
    ------
    RuntimeError
        If a joint departs from its command by more than 0.7 rad: the loop is unstable.
    """
    sensors, controller = sensors or LegSensors(), controller or Controller()
    acmd = np.gradient(vcmd, 1 / RATE, axis=0) if acmd is None else acmd
    rng = np.random.default_rng(seed)
    command = Motion(qcmd, vcmd, acmd)
    fed = _feedforward(controller, command)
    missing = np.zeros_like(qcmd)
    if sensors.acting_share:
        missing = np.sqrt(sensors.acting_share) * sensors.torque_errors(rng, qcmd.shape)
    plant = rigid(truth) if gears == "rigid" else elastic(truth)
    run, read = _loop(plant, truth, command, (fed, missing), controller, sensors, rng)
    error = missing + np.sqrt(1 - sensors.acting_share) * sensors.torque_errors(rng, qcmd.shape)
    signals = {"q": read[0], "v": read[1], "tau": run.tau + error}
    if not sensors.logs_velocity:
        del signals["v"]
    t = np.arange(len(qcmd)) / RATE
    return LegRun(as_log(t, signals | {"qcmd": qcmd, "vcmd": vcmd}), run)


def as_log(t: Array, signals: Mapping[str, Array]) -> JointLog:
    """Signals of the leg, each (N, 3), as a log."""
    return make_log(Path("leg_run.mcap"), t, JOINTS, signals)


def run_shell(seed: int, *, seconds: float = 10.0, start: float | None = None, **options: Any) -> JointLog:
    """Run the leg along the paper's motion; ``options`` as for `run_leg`.

    Parameters
    ----------
    seed
        Of the noise and, without ``start``, of where in the motion the log begins.
    seconds, start
        Length of the log, and where in the motion it begins [s].
    """
    motion = shell(seconds, np.random.default_rng([seed, 1]).uniform(2.5, 60) if start is None else start)
    return run_leg(motion.q, motion.v, seed, acmd=motion.a, **options)


def _loop(
    plant: Plant,
    truth: Truth,
    command: Motion,
    torques: tuple[Array, Array],
    controller: Controller,
    sensors: LegSensors,
    rng: np.random.Generator,
) -> tuple[Run, Array]:
    """True motion, and measured q and v, (2, N, 3). Each sample is in the middle of its torque's millisecond.

    ``torques`` are the feed-forward, and the torque by which the drives fall short.
    """
    fed, missing = torques
    model, data, steps = plant.model, mujoco.MjData(plant.model), plant.steps
    data.qpos[:], data.qvel[:] = plant.started @ command.q[0], plant.started @ command.v[0]
    links, qpos, qvel = plant.links, data.qpos, data.qvel
    kp, kd = np.array(controller.kp), np.array(controller.kd)
    noise = rng.normal(size=(2, *command.q.shape))
    reader = _Reader(sensors, command.q[0], command.v[0], noise)
    stribeck = np.array([truth.stribeck.get(name, 0.0) for name in JOINTS])
    coulomb, viscous = model.dof_frictionloss[links].copy(), model.dof_damping[links]
    true = np.zeros((5, *command.q.shape))  # as the fields of Run
    read = np.zeros((2, *command.q.shape))
    asked = fed[0]
    for k in range(len(command.q)):
        if stribeck.any():
            rest = np.exp(-np.square(qvel[links] / truth.stribeck_velocity))
            model.dof_frictionloss[links] = coulomb + stribeck * rest
        tau = asked - missing[k]
        data.qfrc_applied[plant.driven] = plant.to_driven @ tau
        v_before = qvel[links]
        friction = np.zeros(3)
        for step in range(steps):
            if step == steps // 2:
                true[0, k], true[1, k] = q, v = qpos[links], qvel[links]
            mujoco.mj_step(model, data)
            friction += viscous * qvel[links] - data.qfrc_constraint[links]
        true[2, k], true[3, k], true[4, k] = (qvel[links] - v_before) * RATE, tau, friction / steps
        read[:, k] = q, v = reader.read(k, q, v)
        if np.abs(q - command.q[k]).max() > _LOST:
            raise RuntimeError(f"a joint lost its command after {k / RATE:.2f} s: {q - command.q[k]} rad; lower kd?")
        asked = fed[min(k + 1, len(fed) - 1)] + kp * (command.q[k] - q) + kd * (command.v[k] - v)
    return Run(*true), read


class _Reader:
    """Sensors in the loop; noise (2, N, 3) is standard normal."""

    def __init__(self, sensors: LegSensors, q: Array, v: Array, noise: Array) -> None:
        self._step, self._lag = sensors.position_step, sensors.velocity_lag
        self._q_noise = sensors.position_noise * noise[0]
        self._v_noise = None if sensors.velocity_noise is None else sensors.velocity_noise * noise[1]
        self._keep = 1 / (0.5 + self._lag * RATE)  # a first-order low-pass lags by 1 / keep - 1 samples
        self._q, self._v = self._rounded(q - v / RATE), v

    def _rounded(self, q: Array) -> Array:
        return np.asarray(np.round(q / self._step) * self._step) if self._step else q

    def read(self, k: int, q: Array, v: Array) -> tuple[Array, Array]:
        """Sample k of position and velocity, once each, in turn."""
        read = self._rounded(q + self._q_noise[k])
        self._v = self._v + self._keep * ((read - self._q) * RATE - self._v)
        self._q = read
        return read, self._v if self._v_noise is None else v + self._v_noise[k]


def _feedforward(controller: Controller, command: Motion) -> Array:
    """Torque of the prior model, shape (N, 3)."""
    if controller.feedforward == "none":
        return np.zeros_like(command.q)
    prior = prior_truth()
    viscous, coulomb = np.transpose([(prior.friction[name].viscous, prior.friction[name].coulomb) for name in JOINTS])
    coulomb = coulomb if controller.coulomb is None else np.array(controller.coulomb)
    friction = viscous * command.v + coulomb * np.tanh(command.v / _SMOOTH)
    return friction + inverse_dynamics(prior, command) if controller.feedforward == "model" else np.asarray(friction)
