"""Speed of the simulation, compared with a Python loop over Pinocchio's forward dynamics.

Run ``python benchmarks/simulate.py [FOLDER]``: the leg under its logged torque, in windows of a second; with FOLDER,
which holds go2.urdf and chirp_7.csv (not part of this repository), also the quadruped in closed loop over all of it.

The loop is simple: `pin.aba` with the rotors as armature, and friction rounded to c tanh(v / 0.01). It takes steps of a
millisecond, once of semi-implicit Euler, once of the Runge-Kutta method of order 4. It has neither stiction nor the
rotors' gyroscopic torque, and it does not find the times at which friction changes its direction.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import sample_leg
from comparison import Comparison, compare, version_text
from numpy.typing import NDArray

from idtool.data.signals import Signals
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.simulation.simulation import simulate
from idtool.dynamics.simulation.windows import Window, split_into_windows
from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.robot.config import read_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]
TorqueFunction = Callable[[float, Array, Array], Array]  # of t, q, v

REPETITIONS = 5
STEP = 1e-3  # s
FRICTION_WIDTH = 0.01  # rad/s
LOOP_REMARK = "The loop has no stiction, no gyroscopic torque of rotors and no exact times of friction reversals."
CONFIG = Path(__file__).parents[1] / "configs" / "go2.yaml"


def silent(share: float) -> None:
    """Ignore the progress."""


class PythonLoop:
    """Forward dynamics of a URDF with armature and rounded friction, stepped in Python."""

    def __init__(self, experiment: Experiment) -> None:
        model = experiment.model
        self.tree = pin.buildModelFromUrdf(str(model.robot.path))
        mechanism = experiment.equation.mechanism(model, experiment.equation.prior)
        dofs = [self.tree.joints[self.tree.getJointId(name)].idx_v for name in model.names]
        armature, viscous, coulomb = np.zeros((3, self.tree.nv))
        for body, pi in zip(model.bodies, mechanism.pi, strict=True):
            if body.kind == "rotor":
                axial = body.axis @ pin.Inertia.FromDynamicParameters(pi).inertia @ body.axis
                armature[dofs] += body.ratios**2 * axial
        for coefficient in experiment.equation.coefficients:
            if coefficient.name in ("viscous", "coulomb"):
                dof = dofs[model.names.index(coefficient.owner)]
                values = viscous if coefficient.name == "viscous" else coulomb
                values[dof] = coefficient.prior
        self.tree.armature = armature
        self.data = self.tree.createData()
        self.viscous, self.coulomb = viscous, coulomb
        self.dofs = dofs

    def acceleration(self, t: float, q: Array, v: Array, torque: TorqueFunction) -> Array:
        """Acceleration by forward dynamics."""
        friction = self.viscous * v + self.coulomb * np.tanh(v / FRICTION_WIDTH)
        return np.array(pin.aba(self.tree, self.data, q, v, torque(t, q, v) - friction))

    def euler(self, q: Array, v: Array, torque: TorqueFunction, seconds: float) -> Array:
        """Position after steps of semi-implicit Euler."""
        for k in range(round(seconds / STEP)):
            v = v + STEP * self.acceleration(k * STEP, q, v, torque)
            q = q + STEP * v
        return q

    def runge_kutta(self, q: Array, v: Array, torque: TorqueFunction, seconds: float) -> Array:
        """Position after steps of the classical Runge-Kutta method of order 4."""
        for k in range(round(seconds / STEP)):
            t, h = k * STEP, STEP
            a1 = self.acceleration(t, q, v, torque)
            v2 = v + h / 2 * a1
            a2 = self.acceleration(t + h / 2, q + h / 2 * v, v2, torque)
            v3 = v + h / 2 * a2
            a3 = self.acceleration(t + h / 2, q + h / 2 * v2, v3, torque)
            v4 = v + h * a3
            a4 = self.acceleration(t + h, q + h * v3, v4, torque)
            q = q + h / 6 * (v + 2 * v2 + 2 * v3 + v4)
            v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        return q


def input_torque(signals: Signals, window: slice, dofs: list[int]) -> TorqueFunction:
    """The logged torque, or the controller's, as a function of the loop's state."""
    dt, command = signals.log.dt, signals.controller
    name = "qcmd" if command.joints.all() else "tau"
    x = np.zeros((window.stop - window.start + 2, len(dofs)))
    x[:-2, dofs] = signals.channels.signal(name, window).T
    x[-2:] = x[-3]
    kp, kd = np.zeros((2, len(dofs)))
    kp[dofs], kd[dofs] = command.kp[:, 0], command.kd[:, 0]

    def logged(t: float, q: Array, v: Array) -> Array:
        sample = max(t - command.delay, 0.0) / dt
        k = int(sample)
        return np.asarray(x[k] + (sample - k) * (x[k + 1] - x[k]))

    def controlled(t: float, q: Array, v: Array) -> Array:
        return kp * (logged(t, q, v) - q) - kd * v

    return controlled if name == "qcmd" else logged


def comparisons_of(name: str, experiment: Experiment, window: float | None) -> list[Comparison]:
    """Time idtool's simulation by turns with each of the loops."""
    signals = experiment.runs[0].signals
    parts = split_into_windows(signals, experiment.runs[0].held_out, window)
    windows = [Window(signals, part) for part in parts]
    mechanism: Mechanism = experiment.equation.mechanism(experiment.model, experiment.equation.prior)
    loop = PythonLoop(experiment)
    starts = []
    for part in parts:
        q = np.zeros(loop.tree.nv)
        q[loop.dofs] = signals.channels.signal("q", part)[:, 0]
        starts.append((q, input_torque(signals, part, loop.dofs), (part.stop - part.start) * signals.log.dt))

    def ours() -> None:
        for _ in simulate(mechanism, windows, silent):
            pass

    def euler() -> None:
        for q, torque, span in starts:
            loop.euler(q, np.zeros_like(q), torque, span)

    def runge_kutta() -> None:
        for q, torque, span in starts:
            loop.runge_kutta(q, np.zeros_like(q), torque, span)

    seconds = sum(map(len, windows)) * signals.log.dt
    task = f"simulation of {seconds:.3g} s, {name}"
    peer = f"loop over aba of {version_text('pin')}"
    with np.errstate(all="ignore"):
        ours()
        return [
            compare(task, f"{peer}, Runge-Kutta", ours, runge_kutta, REPETITIONS, remark=LOOP_REMARK),
            compare(task, f"{peer}, Euler", ours, euler, REPETITIONS, remark=f"{LOOP_REMARK} It is of order 1."),
        ]


def comparisons() -> list[Comparison]:
    """The leg under its logged torque, in windows of 1 s and of 0.1 s."""
    leg = prepare(read_robot(sample_leg.URDF), read_config(sample_leg.CONFIG), [], [sample_leg.LOG])
    return [*comparisons_of("leg, 10 windows", leg, 1.0), *comparisons_of("leg, 100 windows", leg, 0.1)]


def main() -> None:
    """The leg and, where its logs are given, the quadruped."""
    compared = comparisons()
    if len(sys.argv) > 1:
        folder = Path(sys.argv[1])
        go2 = prepare(read_robot(folder / "go2.urdf"), read_config(CONFIG), [], [folder / "chirp_7.csv"])
        compared += comparisons_of("Go2, closed loop", go2, None)
    for comparison in compared:
        print(comparison)


if __name__ == "__main__":
    main()
