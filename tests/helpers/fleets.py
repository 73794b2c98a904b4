"""Logs of several robots of one type, by Pinocchio's inverse dynamics: friction of their own, and one odd body."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from idtool.common.arrays import Array
from idtool.data.logs import make_log, write_log

RATE = 500.0  # Hz
NOISE = {"q": 1e-5, "v": 2e-3, "tau": 0.02}
_SINES = 6


def write_logs(
    folder: Path, urdf: Path, friction: tuple[Array, Array], seeds: tuple[int, ...], payload: float = 0.0
) -> list[Path]:
    """Logs of one robot, 6 s each.

    Parameters
    ----------
    folder
        Where they are written.
    urdf
        The true robot.
    friction
        Viscous and Coulomb friction, shape (nv,) each.
    seeds
        One for each log.
    payload
        Mass at the end of the last link [kg].
    """
    model = pin.buildModelFromUrdf(str(urdf))
    if payload:
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.2]))
        model.appendBodyToJoint(model.njoints - 1, pin.Inertia.FromSphere(payload, 0.03), place)
    data = model.createData()
    viscous, coulomb = friction
    paths = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        t = np.arange(int(6 * RATE)) / RATE
        frequency = 2 * np.pi * rng.uniform(0.2, 2.5, (_SINES, model.nv))
        amplitude = rng.uniform(0.05, 0.2, (_SINES, model.nv))
        phase = frequency * t[:, None, None] + rng.uniform(0, 2 * np.pi, (_SINES, model.nv))
        q = (amplitude * np.sin(phase)).sum(axis=1)
        v = (amplitude * frequency * np.cos(phase)).sum(axis=1)
        a = -(amplitude * frequency**2 * np.sin(phase)).sum(axis=1)
        tau = np.array([pin.rnea(model, data, *sample) for sample in zip(q, v, a, strict=True)])
        tau += viscous * v + coulomb * np.sign(v)
        signals = {"q": q, "v": v, "tau": tau}
        for name, signal in signals.items():
            signal += NOISE[name] * rng.standard_normal(signal.shape)
        folder.mkdir(parents=True, exist_ok=True)
        paths.append(folder / f"run{seed}.mcap")
        write_log(paths[-1], make_log(paths[-1], t, tuple(list(model.names)[1:]), signals))
    return paths
