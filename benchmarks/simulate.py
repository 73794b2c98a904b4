"""Simulated seconds a wall second, against a Python loop over Pinocchio's forward dynamics.

Run ``python benchmarks/simulate.py [FOLDER]``: the leg under its logged torque, in windows of a second; with FOLDER,
which holds go2.urdf and chirp_7.csv (not part of this repository), also the quadruped closed loop over the whole log.

The loop is what one would write in an afternoon: `pin.aba` with the rotors as armature, friction rounded to
c tanh(v / 0.01), once with a semi-implicit Euler step a millisecond, once with a step of Runge–Kutta's method of order
4. It has neither sticking nor the rotors' gyroscopic torque, nor does it find when friction changes its direction.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import leg
import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
from numpy.typing import NDArray

from idtool.data.signals import Signals
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.simulation.simulation import simulate
from idtool.dynamics.simulation.windows import split_into_windows
from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.robot.config import read_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]
Torque = Callable[[float, Array, Array], Array]

REPETITIONS = 5
STEP = 1e-3  # s
WIDTH = 0.01  # rad/s
CONFIG = Path(__file__).parents[1] / "configs" / "go2.yaml"


def silent(share: float) -> None:
    """No progress to show."""


class Loop:
    """A URDF with armature and rounded friction, stepped in Python."""

    def __init__(self, experiment: Experiment) -> None:
        model = experiment.model
        self.tree = pin.buildModelFromUrdf(str(model.robot.path))
        mechanism = experiment.equation.mechanism(model, experiment.equation.prior)
        place = [self.tree.joints[self.tree.getJointId(name)].idx_v for name in model.names]
        armature, viscous, coulomb = np.zeros((3, self.tree.nv))
        for body, pi in zip(model.bodies, mechanism.pi, strict=True):
            if body.kind == "rotor":
                axial = body.axis @ pin.Inertia.FromDynamicParameters(pi).inertia @ body.axis
                armature[place] += body.ratios**2 * axial
        for coefficient in experiment.equation.coefficients:
            into = {"viscous": viscous, "coulomb": coulomb}.get(coefficient.name)
            if into is not None:
                into[place[model.names.index(coefficient.owner)]] = coefficient.prior
        self.tree.armature = armature
        self.data, self.viscous, self.coulomb = self.tree.createData(), viscous, coulomb
        self.place = place

    def acceleration(self, t: float, q: Array, v: Array, torque: Torque) -> Array:
        """Forward dynamics."""
        friction = self.viscous * v + self.coulomb * np.tanh(v / WIDTH)
        return np.array(pin.aba(self.tree, self.data, q, v, torque(t, q, v) - friction))

    def euler(self, q: Array, v: Array, torque: Torque, seconds: float) -> Array:
        """Semi-implicit steps."""
        for k in range(round(seconds / STEP)):
            v = v + STEP * self.acceleration(k * STEP, q, v, torque)
            q = q + STEP * v
        return q

    def runge_kutta(self, q: Array, v: Array, torque: Torque, seconds: float) -> Array:
        """Classical steps of order 4."""
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


def torques(signals: Signals, window: slice, place: list[int]) -> Torque:
    """The logged torque or the controller's, as the loop sees it."""
    dt, command = signals.log.dt, signals.command
    name = "qcmd" if command.joints.all() else "tau"
    x = np.zeros((window.stop - window.start + 2, len(place)))
    x[:-2, place] = signals.channels.signal(name, window).T
    x[-2:] = x[-3]
    kp, kd = np.zeros((2, len(place)))
    kp[place], kd[place] = command.kp[:, 0], command.kd[:, 0]

    def logged(t: float, q: Array, v: Array) -> Array:
        place = max(t - command.delay, 0.0) / dt
        whole = int(place)
        return np.asarray(x[whole] + (place - whole) * (x[whole + 1] - x[whole]))

    def controlled(t: float, q: Array, v: Array) -> Array:
        return kp * (logged(t, q, v) - q) - kd * v

    return controlled if name == "qcmd" else logged


def compare(name: str, experiment: Experiment, window: float | None) -> None:
    """Time all by turns and print the rates."""
    signals = experiment.runs[0].signals
    windows = split_into_windows(signals, experiment.runs[0].held_out, window)
    seconds = sum(part.stop - part.start for part in windows) * signals.log.dt
    mechanism: Mechanism = experiment.equation.mechanism(experiment.model, experiment.equation.prior)
    loop = Loop(experiment)
    starts = []
    for part in windows:
        q = np.zeros(loop.tree.nv)
        q[loop.place] = signals.channels.signal("q", part)[:, 0]
        starts.append((q, torques(signals, part, loop.place), (part.stop - part.start) * signals.log.dt))

    def ours() -> None:
        for _ in simulate(mechanism, signals, windows, silent):
            pass

    def stepped(method: Callable[..., Array]) -> Callable[[], None]:
        return lambda: [method(q, np.zeros_like(q), torque, span) for q, torque, span in starts] and None

    euler, fourth = stepped(loop.euler), stepped(loop.runge_kutta)
    with np.errstate(all="ignore"):
        taken = leg.medians(REPETITIONS, ours, euler, fourth)
    rates = [seconds / wall for wall in taken]
    print(
        f"{name}: {rates[0]:.0f} simulated seconds a wall second; loop over pin.aba {rates[1]:.0f} (Euler), "
        f"{rates[2]:.0f} (Runge-Kutta): ratio {rates[0] / rates[1]:.2f} and {rates[0] / rates[2]:.2f}"
    )


def main() -> None:
    """The leg and, where its logs are given, the quadruped."""
    compare("leg, 10 windows", prepare(read_robot(leg.URDF), read_config(leg.CONFIG), [], [leg.LOG]), 1.0)
    many = prepare(read_robot(leg.URDF), read_config(leg.CONFIG), [], [leg.LOG])
    compare("leg, 100 windows", many, 0.1)
    if len(sys.argv) > 1:
        folder = Path(sys.argv[1])
        go2 = prepare(read_robot(folder / "go2.urdf"), read_config(CONFIG), [], [folder / "chirp_7.csv"])
        compare("Go2, closed loop", go2, None)


if __name__ == "__main__":
    main()
