"""Comparison of idtool with mujoco.sysid: error of the Go2's simulated closed loop on a held-out log, and time.

Run ``python benchmarks/peer_mujoco_sysid.py FOLDER``, where FOLDER holds go2.urdf and chirp_4.csv to chirp_7.csv (not
part of this repository). It needs ``pip install 'mujoco[sysid]'`` and takes half an hour. Chirps 4 to 6 are fitted. All
of chirp 7 is simulated without a restart under the joint controller of configs/go2.yaml, whose command is interpolated
between samples: idtool's model by idtool, mujoco.sysid's by MuJoCo in steps of a millisecond. The error is that of the
joint positions. idtool's time is that of the whole command, two simulations of chirp 7 included; mujoco.sysid's is that
of the fit.

mujoco.sysid minimizes the error of such rollouts with derivatives by finite differences. With its defaults, the whole
robot is simulated, the residual is that of position sensors, normalized joint by joint, and the fit ends only when
steps are below the noise of the differences. Tuned, each leg is fitted by itself, which is possible as the trunk is
fixed; the residual is that of the simulated state, since the sensors report it a step late; parameters have scales; and
the fit ends after two steps that gain less than 0.2 %. Inertia is freed after the other parameters, first mass and
centre of mass, then the ten pseudo-inertia parameters, with a weak prior at their start values.
"""

from __future__ import annotations

import argparse
import io
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from idtool.robot.config import Controller, read_config

try:
    import mujoco
    from mujoco import sysid
    from mujoco.rollout import rollout
    from mujoco.sysid import InertiaType, Parameter, ParameterDict, TimeSeries
except ImportError:
    print("error: mujoco.sysid: is not installed; pip install 'mujoco[sysid]'", file=sys.stderr)
    raise SystemExit(2) from None

Array = NDArray[np.float64]
Residual = Callable[..., tuple[list[Array], list[TimeSeries], list[TimeSeries]]]
Stage = Callable[[mujoco.MjSpec], list[tuple[Parameter, Array]]]

CONFIG = Path(__file__).parents[1] / "configs" / "go2.yaml"
FITTED, HELD_OUT = (4, 5, 6), 7
LEGS = ("FL", "FR", "RL", "RR")
PERIOD = 0.005  # s, of the logs
STEPS = 5  # of the simulator, per sample
FITTED_DELAY = 0.0106  # s, by idtool, for a configuration that has its delay fitted
TIME_LIMIT = 900.0  # s, of a setting
JOINT_PARAMETERS = {  # start, minimum, maximum, scale; kg·m², N·m·s/rad, N·m
    "armature": (0.01, 1e-4, 0.5, 0.01),
    "damping": (0.1, 1e-4, 2.0, 0.1),
    "frictionloss": (0.1, 1e-4, 3.0, 0.1),
}
LINK_SCALES = {  # mass and centre of mass; size, stretch, shear and centre of mass
    InertiaType.MassIpos: np.repeat([0.2, 0.03], [1, 3]),
    InertiaType.Pseudo: np.repeat([0.25, 0.05], [7, 3]),
}
PRIOR_WEIGHT = 0.1  # mrad per scale


@dataclass(frozen=True)
class Task:
    """The robot, its controller, its joints in the logs' order, and q, v and qcmd of each log, shape (3, N, joints)."""

    urdf: Path
    controller: Controller
    joints: list[str]
    runs: dict[int, Array]

    @property
    def delay(self) -> float:
        """Delay from command to torque [s]."""
        known = self.controller.known_delay
        return FITTED_DELAY if known is None else known.value

    def command(self, qcmd: Array) -> Array:
        """The delayed command at every step of the simulator, shape (steps + 1, joints)."""
        samples = np.arange(len(qcmd))
        delayed = np.arange(samples[-1] * STEPS + 1) / STEPS - self.delay / PERIOD
        return np.column_stack([np.interp(delayed, samples, column) for column in qcmd.T])

    def spec(self, legs: Sequence[str] = LEGS) -> mujoco.MjSpec:
        """MuJoCo model with a fixed trunk, some of the legs, and their controller."""
        robot = etree.parse(self.urdf).getroot()
        others = tuple(f"{leg}_" for leg in LEGS if leg not in legs)
        for element in list(robot.iter("visual", "collision", "link", "joint")):
            if element.tag in ("visual", "collision") or element.get("name", "").startswith(others):
                element.getparent().remove(element)
        spec = mujoco.MjSpec.from_string(etree.tostring(robot).decode())
        spec.compile()
        spec = mujoco.MjSpec.from_string(spec.to_xml())  # links on fixed joints become part of what carries them
        spec.option.timestep = PERIOD / STEPS
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        for joint in spec.joints:
            name = joint.name
            joint.limited = False
            joint.actfrclimited = False
            actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            actuator.set_to_position(kp=self.controller.kp[name], kv=self.controller.kd[name])
            kinds = {"type": mujoco.mjtSensor.mjSENS_JOINTPOS, "objtype": mujoco.mjtObj.mjOBJ_JOINT}
            spec.add_sensor(name=f"{name}_position", objname=name, **kinds)
        return spec

    def error(self, params: ParameterDict) -> Array:
        """Simulated less measured positions of the held-out run, shape (N, joints) [rad]."""
        q, v, qcmd = self.runs[HELD_OUT]
        model = sysid.apply_param_modifiers(params, self.spec())
        start = sysid.create_initial_state(model, q[0], v[0])
        states, _ = rollout(model, mujoco.MjData(model), start, self.command(qcmd)[:-1])
        simulated = states[0, STEPS - 1 :: STEPS, 1 : 1 + model.nq]
        return np.concatenate([q[:1], simulated]) - q


def read_task(folder: Path) -> Task:
    """Read the robot, its controller and its logs."""
    controller = read_config(CONFIG).controller
    runs = {}
    for number in (*FITTED, HELD_OUT):
        path = folder / f"chirp_{number}.csv"
        names = path.read_text().split("\n", 1)[0].split(",")
        table = dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))
        assert np.allclose(np.diff(table["t"]), PERIOD)
        joints = [name.removeprefix("q_") for name in names if name.startswith("q_")]
        signals = []
        for signal in ("q", "v", "qcmd"):
            signals.append(np.column_stack([table[f"{signal}_{joint}"] for joint in joints]))
        runs[number] = np.stack(signals)
    return Task(folder / "go2.urdf", controller, joints, runs)


@dataclass
class StopCriterion:
    """Stops an optimizer that runs out of time or gains too little in two steps, and keeps its best parameters."""

    deadline: float
    min_gain: float
    best: Array | None = None

    def __call__(self, trace: Sequence[Any]) -> None:
        """Check the criterion after an iteration."""
        self.best = trace[-1].candidate.ravel()
        gain = sum(step.reduction for step in trace[-2:]) if len(trace) > 1 else np.inf
        if time.perf_counter() > self.deadline or gain < self.min_gain * trace[-1].objective:
            raise StopIteration


def optimize(params: ParameterDict, residual: Residual, deadline: float, min_gain: float = 0.0, **options: Any) -> bool:
    """Fit parameters in place; true if it ended in time."""
    criterion = StopCriterion(deadline, min_gain)
    try:
        fitted, _ = sysid.optimize(
            params, residual, verbose=False, output=io.StringIO(), iter_callback=criterion, **options
        )
        params.update_from_vector(fitted.as_vector())
    except StopIteration:
        params.update_from_vector(criterion.best)
    return time.perf_counter() < deadline


def sequences(task: Task, spec: mujoco.MjSpec, joints: slice, on_state: bool) -> sysid.ModelSequences:
    """The fitted runs in the form of mujoco.sysid, compared with its position sensors or with its state."""
    model = spec.compile()
    states, commands, positions = [], [], []
    names = [(f"{joint.name}_qpos", sysid.SignalType.MjStateQPos) for joint in spec.joints] if on_state else None
    for q, v, qcmd in (task.runs[number][..., joints] for number in FITTED):
        command = task.command(qcmd)
        states.append(sysid.create_initial_state(model, q[0], v[0]))
        commands.append(TimeSeries(np.arange(len(command)) * model.opt.timestep, command))
        positions.append(TimeSeries.from_names(np.arange(len(q)) * PERIOD, q, model, names))
    return sysid.ModelSequences("go2", spec, [f"chirp_{n}" for n in FITTED], states, commands, positions)


def joint_parameter(joint: str, kind: str) -> Parameter:
    """Armature, damping or dry friction of a joint."""

    def apply(spec: mujoco.MjSpec, param: Parameter) -> None:
        setattr(spec.joint(joint), kind, [param.value[0], 0, 0] if kind == "damping" else param.value[0])

    return Parameter(f"{joint} {kind}", *JOINT_PARAMETERS[kind][:3], modifier=apply)


def link_parameter(spec: mujoco.MjSpec, link: str, kind: InertiaType) -> Parameter:
    """Mass and centre of mass of a link, or its ten pseudo-inertia parameters."""

    def apply(spec: mujoco.MjSpec, param: Parameter) -> None:
        sysid.apply_body_inertia(spec, link, param)
        if kind == InertiaType.Pseudo:
            spec.body(link).iquat[:] = [1, 0, 0, 0]  # mujoco 4.0 leaves it undefined, and does not compile then

    return sysid.body_inertia_param(spec.copy(), spec.compile(), link, kind, modifier=apply)


def joint_parameters(spec: mujoco.MjSpec) -> list[tuple[Parameter, Array]]:
    """Parameters of every joint, with their scales."""
    parameters = []
    for joint in spec.joints:
        for kind, (*_, scale) in JOINT_PARAMETERS.items():
            parameters.append((joint_parameter(joint.name, kind), np.array([scale])))
    return parameters


def link_parameters(kind: InertiaType, spec: mujoco.MjSpec) -> list[tuple[Parameter, Array]]:
    """Parameters of every link, with their scales."""
    return [(link_parameter(spec, body.name, kind), LINK_SCALES[kind]) for body in spec.bodies[1:]]


def state_error(
    params: ParameterDict, _: TimeSeries, measured: TimeSeries, model: mujoco.MjModel, everything: bool, state: Array
) -> tuple[Array, TimeSeries, TimeSeries]:
    """Simulated less measured positions after the first sample [mrad], scaled so that the squares sum to their mean."""
    q = state[STEPS - 1 :: STEPS, 1 : 1 + model.nq]
    q_measured, times, mapping = measured.data[1:], measured.times[1:], measured.signal_mapping
    error = 1e3 * (q - q_measured) / np.sqrt(len(FITTED) * q.size)
    return error, TimeSeries(times, q, mapping), TimeSeries(times, q_measured, mapping)


def with_prior(residual: Residual, start: Array, scale: Array) -> Residual:
    """A residual with a weak prior on the parameters at their start values."""

    def extended(x: Array, params: ParameterDict) -> tuple[list[Array], list[TimeSeries], list[TimeSeries]]:
        errors, predicted, measured = residual(x, params)
        return [*errors, PRIOR_WEIGHT * ((x.T - start) / scale).T], predicted, measured

    return extended


def fit_robot(task: Task) -> tuple[ParameterDict, bool]:
    """Fit the whole robot with the defaults; true if it ended in time."""
    spec = task.spec()
    params = ParameterDict({param.name: param for param, _ in joint_parameters(spec)})
    residual = sysid.build_residual_fn(models_sequences=[sequences(task, spec, slice(None), on_state=False)])
    return params, optimize(params, residual, time.perf_counter() + TIME_LIMIT)


def fit_leg(stages: Sequence[Stage], task: Task, leg: str) -> tuple[ParameterDict, bool]:
    """Fit a leg by itself, with more free parameters from stage to stage; true if it ended in time."""
    deadline = time.perf_counter() + TIME_LIMIT / len(LEGS)
    spec = task.spec([leg])
    in_time = True
    columns = [i for i, name in enumerate(task.joints) if name.startswith(leg)]
    data = sequences(task, spec, slice(columns[0], columns[-1] + 1), on_state=True)
    residual = sysid.build_residual_fn(models_sequences=[data], modify_residual=state_error)
    params, scales = ParameterDict(), {}
    for stage in stages:
        for param, scale in stage(spec):
            params.add(param)  # in place of one of the same name
            scales[param.name] = scale
        scale = np.concatenate([scales[name] for name in params.keys()])  # noqa: SIM118 - no mapping
        start = params.move_off_bounds(0.002).as_vector()  # as mujoco.sysid advises
        cost = residual if stage is stages[0] else with_prior(residual, start, scale)
        in_time = optimize(params, cost, deadline, 2e-3, x_scale=scale, eps=1e-5)
        sysid.apply_param_modifiers(params, spec)
    return params, in_time


def fit_legs(stages: Sequence[Stage], task: Task) -> tuple[ParameterDict, bool]:
    """Fit leg after leg; true if all ended in time."""
    legs = [fit_leg(stages, task, leg) for leg in LEGS]
    params = ParameterDict({name: param for fitted, _ in legs for name, param in fitted.items()})
    return params, all(in_time for _, in_time in legs)


MASSES_AND_COMS, INERTIAS = (partial(link_parameters, kind) for kind in LINK_SCALES)
SETTINGS: dict[
    str, tuple[int, Callable[[Task], tuple[ParameterDict, bool]]]
] = {  # number of free parameters, and the fit
    "defaults; joints": (36, fit_robot),
    "tuned; joints": (36, partial(fit_legs, [joint_parameters])),
    "tuned; joints, masses, centres": (84, partial(fit_legs, [joint_parameters, MASSES_AND_COMS])),
    "tuned; joints, inertias": (156, partial(fit_legs, [joint_parameters, MASSES_AND_COMS, INERTIAS])),
}


def run_idtool(task: Task) -> tuple[float, dict[str, Any]]:
    """Wall time of `idtool fit` [s] and its report."""
    *logs, last = (task.urdf.with_name(f"chirp_{n}.csv") for n in task.runs)
    arguments = [task.urdf, *logs, "--validate", last, "--config", CONFIG, "--quiet"]
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, "-c", "from idtool.cli import main; main()", "fit", *arguments, "--out", out]
        started = time.perf_counter()
        subprocess.run(command, check=True)
        return time.perf_counter() - started, json.loads(Path(out, "report.json").read_text())


def print_row(name: str, free: int, seconds: float, errors: Sequence[float], mean: str, remark: str) -> None:
    """Print a row: the errors of all joints, of hips, thighs and calves, and the constant part [mrad]."""
    groups = (errors, errors[::3], errors[1::3], errors[2::3])
    overall, *parts = (1e3 * np.sqrt(np.mean(np.square(group))) for group in groups)
    columns = "".join(f"{part:7.2f}" for part in parts)
    print(f"{name:45s}{free:4d}{seconds:8.1f}{overall:8.3f}{columns}{mean:>7s}  {remark}", flush=True)


def main() -> None:
    """Fit in turn and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    task = read_task(parser.parse_args().folder)
    q, _, qcmd = task.runs[HELD_OUT]
    print(f"q = qcmd would be {1e3 * np.sqrt(np.mean((q - qcmd) ** 2)):.1f} mrad off")
    print(f"{'':45s}free fit [s]  [mrad]   hips thighs calves   mean")
    idtool_runs = [run_idtool(task)]
    sysid_seconds = {}
    for name, (free, fit) in SETTINGS.items():
        started = time.perf_counter()
        params, in_time = fit(task)
        sysid_seconds[name] = time.perf_counter() - started
        error = task.error(params)
        rms = np.sqrt(np.mean(error**2, axis=0))
        mean = f"{1e3 * np.sqrt(np.mean(error.mean(axis=0) ** 2)):.2f}"
        print_row(
            f"mujoco.sysid {mujoco.__version__}, {name}",
            free,
            sysid_seconds[name],
            rms,
            mean,
            "" if in_time else "stopped",
        )
        idtool_runs.append(run_idtool(task))
    seconds = statistics.median(wall_time for wall_time, _ in idtool_runs)
    report = idtool_runs[0][1]
    simulation = report["simulation"]
    free = 10 * len(report["bodies"]) + 2 * len(report["friction"])
    assert (simulation["kind"], simulation["windows"]) == ("closed_loop", {"simulated": 1, "of": 1})
    remark = "of it " + ", ".join(f"{step} {s:.1f}" for step, s in report["seconds"].items())
    print_row("idtool fit", free, seconds, [simulation["position"][name] for name in task.joints], "", remark)
    print("times of idtool's: " + ", ".join(f"{s / seconds:.1f} {name}" for name, s in sysid_seconds.items()))


if __name__ == "__main__":
    main()
