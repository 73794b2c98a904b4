"""Benchmark of `idtool diagnose` on logs of real robots, to which effects are added by computation.

Run ``python benchmarks/real_logs.py FOLDER [--robots panda,go2] [--effects ...] [--seeds 0-2] [--pairs] [--jobs N]
[--inertia refit]``, where FOLDER holds ``panda/`` and ``go2/`` with URDFs and logs (not part of this repository);
``--keep DIR`` keeps all files.

Logs are changed as if the robot had an effect more: torque is added along the logged motion, or the logged positions
are changed. `idtool diagnose --inertia fixed` starts from a model that was identified from unchanged logs (of Panda,
the same log, since there is one only), and ``--inertia refit`` from the URDF. Everything else in these logs is real:
friction, noise, cables, flexible links. The effects share no code with idtool.

Their sizes are those of ``benchmarks/hidden_effects/on_logs.py``. With ``--pairs``, each effect comes with a random
second one.

Each case is one line. The first of each robot (``-``) has nothing added: what is named there, the model lacks without
any added effect, and it counts neither for nor against the other cases. Marks of these:

- ``=``: nothing but the hidden effects is named; ``+``: something else is too.
- ``?``: not found, and the hidden effects increase the training error of no joint by more than a tenth, so that hardly
  anything can be found.
- ``!``: the command failed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import yaml
from hidden_effects.case_list import NEED_FIXED_INERTIA, parse_numbers
from hidden_effects.on_logs import (
    EFFECTS,
    PARAMETERS,
    RATE,
    WHOLE_TORQUES,
    Array,
    EffectKey,
    HiddenEffect,
    Motion,
    Situation,
    added_signals,
)
from scipy.signal import butter, sosfiltfilt

from idtool.data.logs import read_log, write_log
from idtool.data.logs.log import JointLog, make_log

CONFIGS = Path(__file__).parents[1] / "configs"
MIN_VISIBLE_INCREASE = 0.1  # of a joint's error
SETTLING_PERIODS = 6.0  # of the low-pass, by which a log is extended at its ends
TIMEOUT = 900.0  # s


@dataclass(frozen=True)
class RealRobot:
    """A robot and its logs.

    Attributes
    ----------
    urdf, config
        URDF, in the folder of the logs, and configuration.
    model_logs
        Logs from which the model is identified.
    changed_logs
        Logs to which effects are added: one to diagnose and, if there is a second one, one to validate.
    bandwidth
        Of the low-pass that smooths the motion along which torque is computed [Hz].
    loaded_links
        Links that may carry a payload or be pushed.
    payload_mass
        Typical mass of a payload [kg].
    push_force
        Force of a push [N].
    """

    urdf: str
    config: str
    model_logs: tuple[str, ...]
    changed_logs: tuple[str, ...]
    bandwidth: float
    loaded_links: tuple[str, ...]
    payload_mass: float
    push_force: float


ROBOTS = {
    "panda": RealRobot(
        urdf="panda/panda.urdf",
        config="panda.yaml",
        model_logs=("panda/excitation.mcap",),
        changed_logs=("panda/excitation.mcap",),
        bandwidth=20.0,
        loaded_links=("panda_link5", "panda_link7"),
        payload_mass=2.0,
        push_force=15.0,
    ),
    "go2": RealRobot(
        urdf="go2/go2.urdf",
        config="go2.yaml",
        model_logs=("go2/chirp_4.csv", "go2/chirp_5.csv"),
        changed_logs=("go2/chirp_6.csv", "go2/chirp_7.csv"),
        bandwidth=10.0,
        loaded_links=("FL_calf", "RR_calf"),
        payload_mass=0.35,
        push_force=6.0,
    ),
}


def joint_names(model: pin.Model) -> list[str]:
    """Names of a model's joints, without the base."""
    return list(model.names)[1:]


def controller(robot: RealRobot) -> Mapping[str, Any]:
    """Controller of a robot's configuration; empty: its torque was logged."""
    return yaml.safe_load((CONFIGS / robot.config).read_text()).get("controller", {})


def fitted_delay(folder: Path) -> float:
    """Time from a command to its torque in an identified model [s]."""
    delay = yaml.safe_load((folder / "model.yaml").read_text()).get("controller", {}).get("delay", 0.0)
    return float(delay["value"] if isinstance(delay, dict) else delay)


def logged_torque(robot: RealRobot, log: JointLog, delay: float) -> Array:
    """Torque of the log, or of the robot's controllers, shape (samples, joints)."""
    gains = controller(robot)
    if not gains:
        return log.signals["tau"]
    kp = np.array([gains["kp"][joint] for joint in log.joints])
    kd = np.array([gains["kd"][joint] for joint in log.joints])
    command = np.stack([np.interp(log.t - delay, log.t, x) for x in log.signals["qcmd"].T], axis=1)
    return np.asarray(kp * (command - log.signals["q"]) - kd * log.signals["v"])


def even_times(log: JointLog) -> Array:
    """Times at which the motion of a log is evaluated, shape (N,) [s]."""
    return np.arange(log.t[0], log.t[-1], 1 / RATE)


def smoothed_motion(model: pin.Model, log: JointLog, tau: Array, bandwidth: float, is_diagnosed: bool) -> Motion:
    """Smooth motion of a model's joints; ``tau``: the log's torque, shape (samples, joints)."""
    order = [log.joints.index(name) for name in joint_names(model)]
    t = even_times(log)
    low_pass = butter(4, bandwidth / (RATE / 2), output="sos")  # run twice: 6 dB down at its corner
    settling = round(SETTLING_PERIODS * RATE / bandwidth)

    def smooth(x: Array) -> Array:
        resampled = np.stack([np.interp(t, log.t, x[:, column]) for column in order])
        return np.asarray(sosfiltfilt(low_pass, resampled, axis=1, padlen=settling))

    q, v = smooth(log.signals["q"]), smooth(log.signals["v"])
    a = np.gradient(v, 1 / RATE, axis=1)
    return Motion(t - t[0], q, v, a, smooth(tau), is_diagnosed)


def changed_log(
    robot: RealRobot, log: JointLog, model: pin.Model, delay: float, torque: Array, position: Array, file: Path
) -> JointLog:
    """Log of the robot with effects; the command of a controller changes such that it gives the torque.

    Parameters
    ----------
    robot, log, model
        The robot, its log, and its bodies.
    delay
        From a command to its torque [s].
    torque, position
        What the effects add, shape (n, N).
    file
        Path of the new log.
    """
    t = even_times(log)
    gains = controller(robot)
    signals = {name: np.array(x) for name, x in log.signals.items()}
    for row, joint in enumerate(joint_names(model)):
        column = log.joints.index(joint)
        added_torque = np.interp(log.t, t, torque[row])
        added_position = np.interp(log.t, t, position[row])
        added_velocity = np.interp(log.t, t, np.gradient(position[row], 1 / RATE))
        signals["q"][:, column] += added_position
        signals["v"][:, column] += added_velocity
        if gains:
            added_command = added_position + (added_torque + gains["kd"][joint] * added_velocity) / gains["kp"][joint]
            signals["qcmd"][:, column] += np.interp(log.t + delay, log.t, added_command)
        else:
            signals["tau"][:, column] += added_torque
    return make_log(file, log.t, log.joints, signals)


# Cases


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


@dataclass(frozen=True)
class Outcome:
    """Result of one case.

    Attributes
    ----------
    line
        The outcome in one line of text.
    named
        Effects that were named.
    hidden
        Hidden effects.
    error
        RMS torque error of the given model on the training data, by joint and ``overall`` [N m]; empty: it failed.
    """

    line: str
    named: frozenset[EffectKey] = frozenset()
    hidden: frozenset[EffectKey] = frozenset()
    error: Mapping[str, float] = field(default_factory=dict)

    def mark(self, unchanged: Outcome) -> str:
        """Mark of the outcome, given that of the unchanged logs; see this file's docstring."""
        if not self.error:
            return "!"
        if self.hidden <= self.named:
            others = self.named - self.hidden - unchanged.named
            return "+" if others else "="
        limits = {name: (1 + MIN_VISIBLE_INCREASE) * error for name, error in unchanged.error.items()}
        is_visible = any(error > limits[name] for name, error in self.error.items())
        return " " if is_visible else "?"


def list_cases(robots: Sequence[str], effects: Sequence[str], seeds: Sequence[int], are_pairs: bool) -> list[Case]:
    """Each effect on every robot for every seed, alone or with a random second one."""
    cases = []
    for seed in seeds:
        for robot in robots:
            for effect in effects:
                rng = np.random.default_rng([seed, *map(ord, robot + effect)])
                second = str(rng.choice([other for other in EFFECTS if other != effect]))
                cases.append(Case(robot, (effect, second) if are_pairs else (effect,), seed))
    return cases


def run_idtool(*arguments: object) -> None:
    """Run a command of idtool, for at most `TIMEOUT`.

    Raises
    ------
    RuntimeError
        If it fails.
    """
    command = [sys.executable, "-m", "idtool", *map(str, arguments), "--quiet"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT, check=False)
    except subprocess.TimeoutExpired as failure:
        raise RuntimeError(f"no result after {TIMEOUT:g} s") from failure
    if done.returncode:
        raise RuntimeError((done.stderr.strip().splitlines() or ["no message"])[-1])


def fit_unchanged_logs(name: str, data: Path, folder: Path) -> None:
    """Identify a robot's model from logs that are not changed."""
    robot = ROBOTS[name]
    logs = [data / log for log in robot.model_logs]
    run_idtool("fit", data / robot.urdf, *logs, "--config", CONFIGS / robot.config, "--out", folder, "--quick")


def read_model(urdf: Path, log: JointLog) -> pin.Model:
    """Rigid bodies of a URDF, in which the joints that a log has not are locked at 0."""
    full_model = pin.buildModelFromUrdf(str(urdf))
    locked = [full_model.getJointId(name) for name in joint_names(full_model) if name not in log.joints]
    return pin.buildReducedModel(full_model, locked, pin.neutral(full_model))


def draw_effects(
    case: Case, model: pin.Model, fit_folder: Path, motion: Motion, excluded: Collection[EffectKey]
) -> list[HiddenEffect]:
    """Effects of a case with their parameters, on random joints.

    Parameters
    ----------
    case
        The case.
    model, fit_folder, motion
        The robot's identified bodies, the folder of their fit, and the motion of the log that is diagnosed.
    excluded
        Effects that the unchanged robot has. An effect that every joint has is left out.
    """
    report = json.loads((fit_folder / "report.json").read_text())
    model_error = np.array([report["rms"]["train"][name] for name in joint_names(model)])
    config = yaml.safe_load((fit_folder / "model.yaml").read_text())
    present = set(excluded)
    present |= {(entry["effect"], entry.get("joint")) for entry in config.get("effects", ())}
    present |= {("rotor_inertia", rotor["joint"]) for rotor in config.get("rotors", {}).values()}
    robot = ROBOTS[case.robot]
    hidden = []
    for effect in case.effects:
        rng = np.random.default_rng([case.seed, *map(ord, case.robot + effect)])
        free = [j for j, name in enumerate(joint_names(model)) if (effect, name) not in present]
        if not free:
            continue
        joint: int | None = int(rng.choice(free))
        target: str | None = joint_names(model)[joint]
        situation = Situation(model, motion, joint, model_error, robot.payload_mass, robot.push_force, rng)
        parameters = PARAMETERS[effect](situation)
        if effect in WHOLE_TORQUES:
            joint = None
            target = None if effect == "gravity_tilt" else str(rng.choice(robot.loaded_links))
        hidden.append(HiddenEffect(effect, joint, target, parameters))
    return hidden


def run_case(case: Case, data: Path, folder: Path, inertia: str, excluded: Collection[EffectKey]) -> Outcome:
    """Add the effects to the logs and diagnose them."""
    robot, fit_folder = ROBOTS[case.robot], folder / case.robot
    logs = [read_log(data / log) for log in robot.changed_logs]
    model = read_model(fit_folder / "identified.urdf", logs[0])
    delay = fitted_delay(fit_folder)
    motions = []
    for log in logs:
        tau = logged_torque(robot, log, delay)
        motions.append(smoothed_motion(model, log, tau, robot.bandwidth, is_diagnosed=log is logs[0]))
    hidden = draw_effects(case, model, fit_folder, motions[0], excluded)
    hidden_text = ", ".join(effect_text(one.effect, one.target, one.parameters) for one in hidden) or "nothing"

    case_folder = folder / case.name
    case_folder.mkdir(exist_ok=True)
    files = [case_folder / name for name in ("log.csv", "validation.csv")[: len(logs)]]
    for log, motion, file in zip(logs, motions, files, strict=True):
        torque, position = added_signals(hidden, model, motion)
        write_log(file, changed_log(robot, log, model, delay, torque, position, file))

    urdf, config = fit_folder / "identified.urdf", fit_folder / "model.yaml"
    if inertia == "refit":
        urdf, config = data / robot.urdf, CONFIGS / robot.config
    validation = [argument for file in files[1:] for argument in ("--validate", file)]
    start = time.perf_counter()
    try:
        options = ("--config", config, "--inertia", inertia, "--report-only", "--out", case_folder)
        run_idtool("diagnose", urdf, files[0], *validation, *options)
    except RuntimeError as failure:
        return Outcome(f"{case.robot}: {hidden_text} → failed: {failure}")
    seconds = time.perf_counter() - start
    diagnosis = json.loads((case_folder / "diagnosis.json").read_text())
    return read_outcome(f"{case.robot}: {hidden_text}", hidden, diagnosis, seconds)


def read_outcome(
    case_text: str, hidden: Sequence[HiddenEffect], diagnosis: Mapping[str, Any], seconds: float
) -> Outcome:
    """The outcome of a case from the content of its diagnosis.json."""
    named = set()
    texts = []
    for step in diagnosis["steps"]:
        if step["effect"] == "unknown":
            continue
        target = step["joint"] or step["link"]
        doubt = " (doubtful)" if step["evidence"]["doubt"] else ""
        texts.append(effect_text(step["effect"], target, step["parameters"]) + doubt)
        named.add((step["effect"], target))
    before, after = (diagnosis[when]["validation"]["overall"] for when in ("before", "after"))
    figures = f"{before:.3g} to {after:.3g}, {diagnosis['verdict']}, {seconds:.0f} s"
    line = f"{case_text} → {', '.join(texts) or 'nothing'}  [{figures}]"
    return Outcome(line, frozenset(named), frozenset(one.key for one in hidden), diagnosis["before"]["train"])


def effect_text(effect: str, target: str | None, parameters: Mapping[str, Any]) -> str:
    """Effect, location and its parameters, rounded; without long lists."""
    texts = []
    for name, value in parameters.items():
        if isinstance(value, int | float):
            texts.append(f"{name} {value:.4g}")
        elif isinstance(value, str):
            texts.append(f"{name} {value}")
        elif value is not None and np.ndim(value) == 1 and len(value) <= 3:
            texts.append(f"{name} [{', '.join(f'{x:.3g}' for x in value)}]")
    return f"{effect}.{target or 'all'} ({', '.join(texts)})"


def main() -> None:
    """Identify the robots' models, and print a line for each case."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robots", default=",".join(ROBOTS))
    parser.add_argument("--effects", help="with commas; default: all that can be found")
    parser.add_argument("--seeds", default="0", help="such as 0,3-5")
    parser.add_argument("--pairs", action="store_true", help="add each effect together with another one")
    parser.add_argument("--inertia", choices=("fixed", "refit"), default="fixed")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder for all files; default: a temporary one")
    options = parser.parse_args()

    robots = options.robots.split(",")
    effects = options.effects.split(",") if options.effects else list(EFFECTS)
    for name, known in [*((robot, ROBOTS) for robot in robots), *((effect, EFFECTS) for effect in effects)]:
        if name not in known:
            parser.error(f"{name}: give some of {', '.join(known)}")
    if not options.effects and options.inertia == "refit":
        effects = [effect for effect in effects if effect not in NEED_FIXED_INERTIA]
    cases = list_cases(robots, effects, parse_numbers(options.seeds), options.pairs)
    marks: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as temporary, Pool(options.jobs) as pool:
        folder = options.keep or Path(temporary)
        for name in robots:
            (folder / name).mkdir(parents=True, exist_ok=True)
            fit_unchanged_logs(name, options.folder, folder / name)
        run = partial(run_case, data=options.folder, folder=folder, inertia=options.inertia)
        outcomes = pool.map(partial(run, excluded=()), [Case(name, (), 0) for name in robots])
        unchanged = dict(zip(robots, outcomes, strict=True))
        for outcome in unchanged.values():
            print("-", outcome.line, flush=True)
            if not outcome.error:
                sys.exit(1)
        results = [pool.apply_async(run, (case,), {"excluded": unchanged[case.robot].named}) for case in cases]
        for case, result in zip(cases, results, strict=True):
            outcome = result.get()
            if not outcome.hidden and outcome.error:
                continue  # every joint has the effect
            mark = outcome.mark(unchanged[case.robot])
            marks[mark] += 1
            print(mark, outcome.line, flush=True)
    print(f"\nof {marks.total()} cases, {marks['=']} exact; in {marks['='] + marks['+']}, all hidden effects are named")
    print(f"hardly visible: {marks['?']}; failed: {marks['!']}")


if __name__ == "__main__":
    main()
