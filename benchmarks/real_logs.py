"""Benchmark of `idtool diagnose` on logs of real robots, into which effects are added by computation.

Run ``python benchmarks/real_logs.py FOLDER [--robots panda,go2] [--effects ...] [--seeds 0-2] [--pairs] [--jobs N]
[--inertia refit]``, where FOLDER holds ``panda/`` and ``go2/`` with URDFs and logs (not part of this repository);
``--keep DIR`` keeps all files.

Logs are changed as if the robot had an effect more: torque is added along the logged motion, or the logged positions
are changed. `idtool diagnose --inertia fixed` starts from a model that was identified from unchanged logs, and
``--inertia refit`` from the URDF. Everything else in these logs is real: friction, noise, cables, flexible links. What
the model lacks without any added effect is named in the first line of each robot, and does not count. Torque is
computed with Pinocchio and with the formulas of ``benchmarks/hidden_effects``, which share no code with idtool.

Coefficients are such that the added torque is 5 times the model's RMS error at the joint, times a random factor of 0.7
to 1.4, but at most a quarter of the joint's RMS torque. Each case is one line: ``=`` marks those in which nothing but
the hidden effects is named, ``+`` those in which something else is too, and ``?`` those in which the hidden effects
increase the held-out error of no joint by more than a tenth, so that hardly anything can be found.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import yaml
from hidden_effects.case_list import NEED_FIXED_INERTIA, parse_numbers
from hidden_effects.effects import FRICTION_LEVELS, SMOOTH_TORQUES, saturated_torque
from hidden_effects.friction import advance_bristle
from hidden_effects.plant import JointState
from numpy.typing import NDArray
from scipy.ndimage import shift
from scipy.signal import butter, sosfiltfilt

from idtool.data.logs import read_log, write_log
from idtool.data.logs.log import JointLog, make_log

Array = NDArray[np.float64]
Parameters = dict[str, Any]

CONFIGS = Path(__file__).parents[1] / "configs"
RATE = 1000.0  # Hz, at which the motion is evaluated
SIZE = 5.0  # of the added torque, in units of the model's error
MAX_SHARE = 0.25  # of the added torque, of the joint's rms torque
MIN_INCREASE = 0.1  # of a joint's error, by effects that can be found
TIMEOUT = 900.0  # s
FRICTION_EFFECTS = ("stribeck_friction", "load_dependent_friction")


@dataclass(frozen=True)
class RealRobot:
    """A robot and its logs.

    Attributes
    ----------
    urdf, config
        URDF, in the folder of the logs, and configuration.
    model_logs
        Logs from which the model is identified.
    logs
        Logs that are changed: one to diagnose and, if there is a second one, one to validate.
    bandwidth
        Of the low-pass that smooths the motion along which torque is computed [Hz].
    loaded_links
        Links that may carry a payload or be pushed.
    payload
        Its mass [kg].
    push
        Force of a push [N].
    gains
        Proportional and derivative gain of a joint's controller, by a part of its name; empty: torque was logged.
    delay
        From the command to its torque [s].
    """

    urdf: str
    config: str
    model_logs: tuple[str, ...]
    logs: tuple[str, ...]
    bandwidth: float
    loaded_links: tuple[str, ...]
    payload: float
    push: float
    gains: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    delay: float = 0.0


ROBOTS = {
    "panda": RealRobot(
        urdf="panda/panda.urdf",
        config="panda.yaml",
        model_logs=("panda/excitation.mcap",),
        logs=("panda/excitation.mcap",),
        bandwidth=20.0,
        loaded_links=("panda_link5", "panda_link7"),
        payload=2.0,
        push=15.0,
    ),
    "go2": RealRobot(
        urdf="go2/go2.urdf",
        config="go2.yaml",
        model_logs=("go2/chirp_4.csv", "go2/chirp_5.csv"),
        logs=("go2/chirp_6.csv", "go2/chirp_7.csv"),
        bandwidth=10.0,
        loaded_links=("FL_calf", "RR_calf"),
        payload=0.35,
        push=6.0,
        gains={"hip": (20.0, 1.0), "thigh": (20.0, 1.0), "calf": (40.0, 2.0)},
        delay=0.0106,
    ),
}


@dataclass
class Situation:
    """Everything that an effect depends on.

    Attributes
    ----------
    robot
        The robot.
    model
        Identified rigid bodies, with the log's joints in its order.
    state
        Smoothed motion and torque of the joints in all logs, one after the other, each from time 0; shape (n, N).
    j
        Index of the joint.
    error
        RMS error of the identified model at each joint, shape (n,) [N m].
    rng
        Source of what is random.
    """

    robot: RealRobot
    model: pin.Model
    state: JointState
    j: int
    error: Array
    rng: np.random.Generator

    @property
    def travel(self) -> float:
        """Travel of the joint [rad]."""
        return float(np.ptp(self.state.q[self.j]))

    def coefficient(self, column: Array) -> float:
        """Coefficient with which a column's torque has the size of an effect."""
        size = SIZE * float(np.exp(self.rng.uniform(-0.35, 0.35))) * self.error[self.j]
        size = min(size, MAX_SHARE * _rms(self.state.tau[self.j]))
        return size / _rms(np.broadcast_to(column, self.state.tau[self.j].shape))

    def random_sign(self) -> float:
        """1 or −1."""
        return float(self.rng.choice([-1.0, 1.0]))

    def torque(self, model: pin.Model) -> Array:
        """Torque that a model needs for the motion, shape (n, N)."""
        data = model.createData()
        motion = zip(self.state.q.T, self.state.v.T, self.state.a.T, strict=True)
        return np.stack([pin.rnea(model, data, *state) for state in motion], axis=1)


@dataclass
class Change:
    """What an effect changes in the log.

    Attributes
    ----------
    target
        Joint or link; None: all.
    parameters
        The effect's parameters, for comparison.
    torque, position
        Added to the logged torque and position, shape (n, N).
    """

    target: str | None
    parameters: Parameters
    torque: Array | float = 0.0
    position: Array | float = 0.0


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def _at_joint(s: Situation, torque: Array) -> Array:
    """A torque on the situation's joint, shape (n, N)."""
    added = np.zeros_like(s.state.tau)
    added[s.j] = torque
    return added


def _unit_parameters(s: Situation, effect: str) -> tuple[str, Parameters]:
    """Name of the coefficient, and parameters with a coefficient of 1, of a smooth torque or a friction."""
    q, t = s.state.q[s.j], np.asarray(s.state.t)
    low_velocity = float(np.quantile(np.abs(s.state.v[s.j]), 0.25))
    position = float(np.quantile(q, 0.85))
    neighbours = [k for k in (s.j - 1, s.j + 1) if 0 <= k < len(s.state.q)]
    forms: dict[str, tuple[str, Parameters]] = {
        "stribeck_friction": ("stribeck", {"velocity": low_velocity}),
        "load_dependent_friction": ("coefficient", {}),
        "quadratic_drag": ("drag", {}),
        "torque_ripple": (
            "amplitude",
            {"periods": float(np.ceil(s.rng.uniform(3, 6) * 2 * np.pi / s.travel)), "phase": s.rng.uniform(-3, 3)},
        ),
        "parallel_spring": ("stiffness", {"rest_position": float(np.mean(q) + s.rng.uniform(-0.3, 0.3) * s.travel)}),
        "end_stop": ("stiffness", {"position": position, "side": 1.0}),
        "transmission_coupling": ("coefficient", {"source_index": int(s.rng.choice(neighbours))}),
        "friction_drift": ("viscous", {"time_constant": float(0.3 * np.ptp(t))}),
    }
    coefficient, parameters = forms[effect]
    return coefficient, {coefficient: 1.0, **parameters}


def _scaled_torque(s: Situation, effect: str) -> Change:
    """Smooth torque or friction that is linear in one coefficient."""
    name, unit = _unit_parameters(s, effect)
    if effect in FRICTION_EFFECTS:
        column = FRICTION_LEVELS[effect](unit, s.j, s.state) * np.sign(s.state.v[s.j])
    else:
        column = SMOOTH_TORQUES[effect](unit, s.j, s.state)
    coefficient = s.coefficient(column)
    return Change(s.model.names[s.j + 1], {**unit, name: coefficient}, _at_joint(s, coefficient * column))


def _presliding_hysteresis(s: Situation) -> Change:
    displacement = 0.02 * s.travel
    deflection = np.zeros_like(s.state.q[s.j])
    z = 0.0
    for k, v in enumerate(s.state.v[s.j]):
        _, z = advance_bristle(z, v, displacement, 1 / RATE)
        deflection[k] = z
    amplitude = s.coefficient(deflection)
    parameters = {"amplitude": amplitude, "displacement": displacement}
    return Change(s.model.names[s.j + 1], parameters, _at_joint(s, amplitude * deflection))


def _torque_gain(s: Situation) -> Change:
    gain = 1 + s.random_sign() * s.coefficient(s.state.tau[s.j])
    return Change(s.model.names[s.j + 1], {"gain": gain}, _at_joint(s, (gain - 1) * s.state.tau[s.j]))


def _torque_saturation(s: Situation) -> Change:
    tau = s.state.tau[s.j]
    peak = float(np.abs(tau).max())
    level = 0.4 * peak
    missing = 0.15 * peak  # of the measured torque, at the peak
    bend = 2 * missing / (peak - level - missing) ** 2
    return Change(
        s.model.names[s.j + 1], {"level": level, "bend": bend}, _at_joint(s, saturated_torque(tau, level, bend) - tau)
    )


def _rotor_inertia(s: Situation) -> Change:
    inertia = s.coefficient(s.state.a[s.j])
    return Change(s.model.names[s.j + 1], {"inertia": inertia}, _at_joint(s, inertia * s.state.a[s.j]))


def _time_delay(s: Situation) -> Change:
    delay = float(s.rng.uniform(0.004, 0.010))
    tau = s.state.tau[s.j]
    delayed = shift(tau, delay * RATE, order=1, mode="nearest")
    return Change(s.model.names[s.j + 1], {"delay": delay}, _at_joint(s, delayed - tau))


def _encoder_offset(s: Situation) -> Change:
    offset = s.random_sign() * float(s.rng.uniform(0.04, 0.1))
    return Change(
        s.model.names[s.j + 1], {"offset": offset}, position=_at_joint(s, np.full(s.state.q.shape[1], -offset))
    )


def _joint_elasticity(s: Situation) -> Change:
    data = s.model.createData()
    inertia = pin.crba(s.model, data, np.median(s.state.q, axis=1))[s.j, s.j]
    stiffness = (2 * np.pi * s.rng.uniform(5, 8)) ** 2 * float(inertia)
    deflection = s.state.tau[s.j] / stiffness
    return Change(s.model.names[s.j + 1], {"stiffness": stiffness}, position=_at_joint(s, deflection))


def _gravity_tilt(s: Situation) -> Change:
    angle, direction = np.deg2rad(s.rng.uniform(2, 5)), s.rng.uniform(-np.pi, np.pi)
    horizontal = np.sin(angle) * np.array([np.cos(direction), np.sin(direction)])
    gravity = np.array([*(9.81 * horizontal), -9.81 * np.cos(angle)])
    tilted = s.model.copy()
    tilted.gravity.linear = gravity
    return Change(None, {"gravity": gravity.tolist()}, s.torque(tilted) - s.torque(s.model))


def _payload(s: Situation) -> Change:
    link = str(s.rng.choice(s.robot.loaded_links))
    mass = s.robot.payload * float(s.rng.uniform(0.7, 1.4))
    center = s.rng.uniform(-0.05, 0.05, 3)
    loaded = s.model.copy()
    frame = loaded.frames[loaded.getFrameId(link)]
    loaded.appendBodyToJoint(
        frame.parentJoint, pin.Inertia(mass, center, mass * 0.05**2 * 0.4 * np.eye(3)), frame.placement
    )
    return Change(link, {"mass": mass, "com": center.tolist()}, s.torque(loaded) - s.torque(s.model))


def _external_contact(s: Situation) -> Change:
    link = str(s.rng.choice(s.robot.loaded_links))
    force = s.rng.normal(size=3)
    force *= s.robot.push / np.linalg.norm(force)
    t = np.asarray(s.state.t)
    is_first_log = np.arange(len(t)) <= np.argmax(np.diff(t, append=0.0) < 0)
    starts = np.ptp(t) * (np.array([0.12, 0.4, 0.75]) + s.rng.uniform(0, 0.05, 3))
    windows = [(start, start + s.rng.uniform(0.6, 1.2)) for start in starts]
    data = s.model.createData()
    frame = s.model.getFrameId(link)
    center = s.model.inertias[s.model.frames[frame].parentJoint].lever
    added = np.zeros_like(s.state.tau)
    for first, last in windows:
        rise = np.where(is_first_log, np.clip(np.minimum(t - first, last - t) / 0.1, 0, 1), 0.0)
        for k in np.flatnonzero(rise):
            J = pin.computeFrameJacobian(s.model, data, s.state.q[:, k], frame, pin.LOCAL_WORLD_ALIGNED)
            pin.updateFramePlacement(s.model, data, frame)
            arm = data.oMf[frame].rotation @ center
            added[:, k] -= rise[k] * J.T @ np.concatenate([force, np.cross(arm, force)])
    return Change(link, {"windows": np.round(windows, 2).tolist(), "force": force.tolist()}, added)


_OTHERS: dict[str, Callable[[Situation], Change]] = {
    "presliding_hysteresis": _presliding_hysteresis,
    "torque_gain": _torque_gain,
    "torque_saturation": _torque_saturation,
    "rotor_inertia": _rotor_inertia,
    "time_delay": _time_delay,
    "encoder_offset": _encoder_offset,
    "joint_elasticity": _joint_elasticity,
    "gravity_tilt": _gravity_tilt,
    "payload": _payload,
    "external_contact": _external_contact,
}
_SCALED = (
    *FRICTION_EFFECTS,
    "quadratic_drag",
    "torque_ripple",
    "parallel_spring",
    "end_stop",
    "transmission_coupling",
    "friction_drift",
)
EFFECTS = (*_SCALED, *_OTHERS)


def change_by(effect: str, situation: Situation) -> Change:
    """Change of the log by an effect."""
    if effect in _SCALED:
        return _scaled_torque(situation, effect)
    return _OTHERS[effect](situation)


def smoothed_motion(model: pin.Model, log: JointLog, tau: Array, bandwidth: float) -> JointState:
    """Smooth motion at 1 kHz of the joints of a model; ``tau``: the log's torque, shape (N, joints)."""
    order = [log.joints.index(name) for name in list(model.names)[1:]]
    t = np.arange(log.t[0], log.t[-1], 1 / RATE)
    low_pass = butter(4, bandwidth / (RATE / 2), output="sos")

    def smooth(x: Array) -> Array:
        resampled = np.stack([np.interp(t, log.t, x[:, column]) for column in order])
        return np.asarray(sosfiltfilt(low_pass, resampled, axis=1))

    q, v = smooth(log.signals["q"]), smooth(log.signals["v"])
    return JointState(t - t[0], q, v, np.gradient(v, 1 / RATE, axis=1), smooth(tau))


def joined(states: Sequence[JointState]) -> JointState:
    """Motions of several logs, one after the other."""
    t = np.concatenate([np.asarray(state.t) for state in states])
    q, v, a, tau = (np.concatenate([getattr(one, x) for one in states], axis=1) for x in ("q", "v", "a", "tau"))
    return JointState(t, q, v, a, tau)


def controller_gains(robot: RealRobot, log: JointLog) -> tuple[Array, Array]:
    """Gains of the joints' controllers, in the log's order, shape (n,) each."""
    gains = [next(own for part, own in robot.gains.items() if part in joint) for joint in log.joints]
    kp, kd = np.array(gains).T
    return kp, kd


def logged_torque(robot: RealRobot, log: JointLog) -> Array:
    """Torque of the log, or of the robot's controllers, shape (N, n)."""
    if not robot.gains:
        return log.signals["tau"]
    kp, kd = controller_gains(robot, log)
    signals = log.signals
    command = np.stack([np.interp(log.t - robot.delay, log.t, x) for x in signals["qcmd"].T], axis=1)
    return np.asarray(kp * (command - signals["q"]) - kd * signals["v"])


def changed_log(
    robot: RealRobot, log: JointLog, model: pin.Model, torque: Array, position: Array, file: Path
) -> JointLog:
    """Log of the robot with effects; a controller's command changes such that it gives the torque.

    Parameters
    ----------
    robot, log, model
        The robot, its log, and its bodies.
    torque, position
        What is added to the torque and the position of the model's joints, at 1 kHz, shape (n, N).
    file
        Path of the new log.
    """
    t = np.arange(log.t[0], log.t[-1], 1 / RATE)
    signals = {name: np.array(x) for name, x in log.signals.items()}
    for row, joint in enumerate(list(model.names)[1:]):
        column = log.joints.index(joint)
        added_torque = np.interp(log.t, t, torque[row])
        added_position = np.interp(log.t, t, position[row])
        added_velocity = np.interp(log.t, t, np.gradient(position[row], 1 / RATE))
        signals["q"][:, column] += added_position
        signals["v"][:, column] += added_velocity
        if robot.gains:
            kp, kd = (gain[column] for gain in controller_gains(robot, log))
            command = added_position + (added_torque + kd * added_velocity) / kp
            signals["qcmd"][:, column] += np.interp(log.t + robot.delay, log.t, command)
        else:
            signals["tau"][:, column] += added_torque
    return make_log(file, log.t, log.joints, signals)


def run_idtool(*arguments: object) -> None:
    """Run a command of idtool, for at most `TIMEOUT`."""
    command = [sys.executable, "-m", "idtool", *map(str, arguments), "--quiet"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT, check=False)
    if done.returncode:
        raise RuntimeError((done.stderr.strip().splitlines() or ["no message"])[-1])


def identify(name: str, data: Path, folder: Path) -> None:
    """Identify a robot's model from logs that are not changed."""
    robot = ROBOTS[name]
    logs = [data / log for log in robot.model_logs]
    run_idtool("fit", data / robot.urdf, *logs, "--config", CONFIGS / robot.config, "--out", folder, "--quick")


@dataclass(frozen=True)
class Case:
    """A robot with hidden effects; the same seed gives the same case."""

    robot: str
    effects: tuple[str, ...]
    seed: int

    @property
    def name(self) -> str:
        """Unique name."""
        return f"{self.robot}_{'+'.join(self.effects) or 'none'}_s{self.seed}"


def list_cases(robots: Sequence[str], effects: Sequence[str], seeds: Sequence[int], are_pairs: bool) -> list[Case]:
    """Each effect, or as many random pairs, on every robot for every seed."""
    cases = []
    for seed in seeds:
        for robot in robots:
            rng = np.random.default_rng([seed, 7])
            for effect in effects:
                others = [other for other in effects if other != effect]
                hidden = (effect, str(rng.choice(others))) if are_pairs else (effect,)
                cases.append(Case(robot, hidden, seed))
    return cases


def draw_changes(case: Case, robot: RealRobot, model: pin.Model, base: Path, state: JointState) -> dict[str, Change]:
    """Change by each of a case's effects.

    An effect that the configuration has on a joint is hidden on another; if it has it on all, it is left out.
    """
    report = json.loads((base / "report.json").read_text())
    error = np.array([report["rms"]["train"][name] for name in list(model.names)[1:]])
    config = yaml.safe_load((base / "model.yaml").read_text())
    present = {(entry["effect"], entry.get("joint")) for entry in config.get("effects", ())}
    present |= {("rotor_inertia", rotor["joint"]) for rotor in config.get("rotors", {}).values()}
    rng = np.random.default_rng([case.seed, *map(ord, case.name)])
    changes: dict[str, Change] = {}
    for effect in case.effects:
        free = [j for j in range(model.nv) if (effect, model.names[j + 1]) not in present]
        if free:
            changes[effect] = change_by(effect, Situation(robot, model, state, int(rng.choice(free)), error, rng))
    return changes


EffectKey = tuple[str, str | None]  # effect, and the joint or link that it acts on


@dataclass(frozen=True)
class Outcome:
    """Result of one case.

    Attributes
    ----------
    line
        The outcome in one line of text.
    named
        Effects that were named.
    truth
        Hidden effects.
    error
        Held-out RMS torque error of the given model, by joint [N m].
    """

    line: str
    named: frozenset[EffectKey] = frozenset()
    truth: frozenset[EffectKey] = frozenset()
    error: Mapping[str, float] = field(default_factory=dict)

    def mark(self, unchanged: Outcome) -> str:
        """Mark of the outcome, given that for the unchanged logs; see this file's docstring."""
        if self.truth and self.truth <= self.named:
            return "=" if self.named <= self.truth | unchanged.named else "+"
        is_visible = any(error > (1 + MIN_INCREASE) * unchanged.error[joint] for joint, error in self.error.items())
        return " " if is_visible or not self.error else "?"


def run_case(case: Case, data: Path, folder: Path, inertia: str) -> Outcome:
    """Hide the effects in the logs and diagnose them."""
    robot, base = ROBOTS[case.robot], folder / case.robot
    whole = pin.buildModelFromUrdf(str(base / "identified.urdf"))
    logs = [read_log(data / log) for log in robot.logs]
    locked = [whole.getJointId(name) for name in list(whole.names)[1:] if name not in logs[0].joints]
    model = pin.buildReducedModel(whole, locked, pin.neutral(whole))
    out = folder / case.name
    out.mkdir(exist_ok=True)
    files = [out / name for name in ("log.csv", "validation.csv")[: len(logs)]]
    states = [smoothed_motion(model, log, logged_torque(robot, log), robot.bandwidth) for log in logs]
    state = joined(states)
    changes = draw_changes(case, robot, model, base, state)
    torque = sum((change.torque for change in changes.values()), np.zeros_like(state.tau))
    position = sum((change.position for change in changes.values()), np.zeros_like(state.q))
    ends = np.cumsum([len(np.asarray(own.t)) for own in states])
    for log, file, end, own in zip(logs, files, ends, states, strict=True):
        part = slice(end - len(np.asarray(own.t)), end)
        write_log(file, changed_log(robot, log, model, torque[:, part], position[:, part], file))

    hidden_text = ", ".join(
        _effect_text(effect, change.target, change.parameters) for effect, change in changes.items()
    )
    given = (base / "identified.urdf", base / "model.yaml")
    if inertia == "refit":
        given = (data / robot.urdf, CONFIGS / robot.config)
    validation = [argument for file in files[1:] for argument in ("--validate", file)]
    start = time.perf_counter()
    try:
        arguments = (given[0], files[0], *validation, "--config", given[1], "--out", out)
        run_idtool("diagnose", *arguments, "--inertia", inertia, "--report-only")
    except (RuntimeError, subprocess.TimeoutExpired) as failure:
        return Outcome(f"{case.robot}: {hidden_text} → failed: {failure}")
    seconds = time.perf_counter() - start
    diagnosis = json.loads((out / "diagnosis.json").read_text())
    reported = []
    named = set()
    for step in diagnosis["steps"]:
        if step["effect"] == "unknown":
            continue
        target = step["joint"] or step["link"]
        doubt = " (doubtful)" if step["evidence"]["doubt"] else ""
        reported.append(_effect_text(step["effect"], target, step["parameters"]) + doubt)
        named.add((step["effect"], target))
    before, after = (diagnosis[when]["validation"] for when in ("before", "after"))
    line = (
        f"{case.robot}: {hidden_text or 'nothing'} → {', '.join(reported) or 'nothing'}  "
        f"[{before['overall']:.3g} to {after['overall']:.3g}, {diagnosis['verdict']}, {seconds:.0f} s]"
    )
    truth = frozenset((effect, change.target) for effect, change in changes.items())
    return Outcome(line, frozenset(named), truth, before)


def _effect_text(effect: str, target: str | None, parameters: Mapping[str, Any]) -> str:
    """Effect, location and rounded numbers."""
    numbers = [
        f"{name} {value:.4g}" if isinstance(value, int | float) else f"{name} {value}"
        for name, value in parameters.items()
        if name not in ("inertia", "windows", "profile", "side") or isinstance(value, float)
    ]
    return f"{effect}.{target or 'all'} ({', '.join(numbers)})"


def _run_case(arguments: tuple[Case, Path, Path, str]) -> Outcome:
    return run_case(*arguments)


def main() -> None:
    """Identify the robots' models, and print a line for each case."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robots", default=",".join(ROBOTS))
    parser.add_argument("--effects", help="with commas; default: all that can be found")
    parser.add_argument("--seeds", default="0", help="such as 0,3-5")
    parser.add_argument("--pairs", action="store_true", help="hide each effect together with another one")
    parser.add_argument("--inertia", choices=("fixed", "refit"), default="fixed")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder for all files; default: a temporary one")
    options = parser.parse_args()

    robots = options.robots.split(",")
    effects = options.effects.split(",") if options.effects else list(EFFECTS)
    if not options.effects and options.inertia == "refit":
        effects = [effect for effect in effects if effect not in NEED_FIXED_INERTIA]
    cases = list_cases(robots, effects, parse_numbers(options.seeds), options.pairs)
    cases = [Case(robot, (), 0) for robot in robots] + cases
    unchanged: dict[str, Outcome] = {}  # by robot
    marks = []
    with tempfile.TemporaryDirectory() as temporary, Pool(options.jobs) as pool:
        folder = options.keep or Path(temporary)
        for name in robots:
            (folder / name).mkdir(parents=True, exist_ok=True)
            identify(name, options.folder, folder / name)
        outcomes = pool.imap(_run_case, [(case, options.folder, folder, options.inertia) for case in cases])
        for case, outcome in zip(cases, outcomes, strict=True):
            if case.effects:
                marks.append(outcome.mark(unchanged[case.robot]))
                print(marks[-1], outcome.line, flush=True)
            else:
                unchanged[case.robot] = outcome
                print("-", outcome.line, flush=True)
    exact, among, hardly_visible = (sum(mark in kind for mark in marks) for kind in ("=", "=+", "?"))
    print(f"\nof {len(marks)} cases, {exact} exact; in {among}, all hidden effects are named")
    print(f"hardly visible: {hardly_visible}")


if __name__ == "__main__":
    main()
