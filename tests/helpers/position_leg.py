"""The leg of sample_logs in MuJoCo under position-controlled drives that act late on what they are commanded.

The drives' own loop is on their true position and velocity, at each step of the simulation; the log has no torque.

Letters: q [rad], v [rad/s] of the joints abad, hip and knee, each (N, 3), at 1 kHz.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco  # type: ignore[import-untyped]
import numpy as np
from leg_motions import RATE, Motion
from leg_plants import rigid
from leg_runs import as_log
from leg_truth import JOINTS, TRUTH
from numpy.typing import NDArray

from idtool.data.logs import JointLog

Array = NDArray[np.float64]

KP, KD = np.array([300.0, 300.0, 300.0]), np.array([6.0, 6.0, 6.0])
GAINS = {"kp": dict(zip(JOINTS, KP.tolist(), strict=True)), "kd": dict(zip(JOINTS, KD.tolist(), strict=True))}
_STEPS = 10  # of the simulation, a sample
_NOISE = {"q": 1e-5, "v": 2e-3}  # rad, rad/s


def position_controlled(motion: Motion, delay: float, *, held: bool = False) -> JointLog:
    """Run the leg along a command; what is logged has no noise.

    Parameters
    ----------
    motion
        The command; the drives have its velocity too.
    delay
        Until they act on it [s]; before, they hold the first one.
    held
        Whether the drives hold each command until the next one arrives; else they interpolate.
    """
    plant = rigid(TRUTH)
    model, data = plant.model, mujoco.MjData(plant.model)
    model.opt.timestep = 1 / (RATE * _STEPS)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    links = plant.links
    data.qpos[links], data.qvel[links] = motion.q[0], 0.0
    sampled = np.arange(len(motion.q)) / RATE
    t = np.arange(len(motion.q) * _STEPS) / (RATE * _STEPS) - delay
    t = np.floor(t * RATE + 1e-6) / RATE if held else t + 0.5 / (RATE * _STEPS)  # the middle of a step
    q_wanted, v_wanted = (np.transpose([np.interp(t, sampled, x) for x in signal.T]) for signal in motion[:2])
    v_wanted[t < 0] = 0.0
    read = np.zeros((2, *motion.q.shape))
    for k in range(len(t)):
        q, v = data.qpos[links], data.qvel[links]
        if k % _STEPS == 0:
            read[:, k // _STEPS] = q, v
        data.qfrc_applied[links] = KP * (q_wanted[k] - q) + KD * (v_wanted[k] - v)
        mujoco.mj_step(model, data)
    return as_log(sampled, {"q": read[0], "v": read[1], "qcmd": motion.q, "vcmd": motion.v})


def noisy(log: JointLog, seed: int, louder: float = 1.0) -> JointLog:
    """The same with noise of the sensors, of whose usual size it may be a multiple."""
    rng = np.random.default_rng(seed)
    signals = dict(log.signals)
    for name, size in _NOISE.items():
        signals[name] = signals[name] + louder * size * rng.normal(size=signals[name].shape)
    return replace(log, signals=signals)
