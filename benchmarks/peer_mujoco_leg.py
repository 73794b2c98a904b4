"""Comparison with mujoco.sysid: the sample leg fitted to one log, and its simulated motion on another one.

Run ``python benchmarks/peer_mujoco_leg.py``; it needs ``pip install 'mujoco[sysid]'``. mujoco.sysid minimizes the
position error of rollouts of a second each, from idtool's start states, under the logged torque. It is tuned as in
`peer_mujoco_sysid`: first armature, damping and dry friction of the joints, then also masses and centres of mass, then
the ten pseudo-inertia parameters of each link. It starts from the URDF and from rotors as armature. idtool's time is
that of the whole command, with the same rollouts, standard errors and page; mujoco.sysid's is that of the fit.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import sample_leg
import startup
from comparison import Comparison, can_import, from_times
from numpy.typing import NDArray

from idtool.data.signals import Signals
from idtool.dynamics.simulation.windows import measured_states, split_into_windows

Array = NDArray[np.float64]

WINDOW = 1.0  # s
VALIDATION = sample_leg.SAMPLES / "leg_validate.mcap"
TIME_LIMIT = 300.0  # s, of a fit
MIN_GAIN = 2e-3  # of the cost in two steps; less ends a stage
JOINT_LIMITS = {  # minimum, maximum, scale; kg·m², N·m·s/rad, N·m
    "armature": (1e-4, 0.5, 0.01),
    "damping": (1e-4, 2.0, 0.1),
    "frictionloss": (1e-4, 10.0, 0.1),
}


def is_installed() -> bool:
    """True if mujoco.sysid is installed with the packages that it needs."""
    return can_import("mujoco.sysid", "optimize")


@dataclass(frozen=True)
class Windows:
    """Windows of a log.

    Attributes
    ----------
    starts
        Position and velocity of each, shape (2, nv, W).
    torque, position
        Samples in each, shape (n, nv) [N·m, rad].
    """

    starts: Array
    torque: tuple[Array, ...]
    position: tuple[Array, ...]

    @classmethod
    def of(cls, signals: Signals) -> Windows:
        """The windows that idtool simulates."""
        windows = split_into_windows(signals, signals.ranges, WINDOW)
        starts = np.stack(measured_states(signals, [window.start for window in windows]))
        torque = tuple(signals.channels.signal("tau", window).T for window in windows)
        position = tuple(signals.channels.signal("q", window).T for window in windows)
        return cls(starts, torque, position)


def leg_spec() -> Any:
    """MuJoCo model of the leg's URDF, its rotors as armature, and a motor and a sensor on every joint."""
    import mujoco

    experiment = sample_leg.leg_experiment()
    spec = mujoco.MjSpec.from_file(str(sample_leg.URDF))
    spec.option.timestep = 1e-3
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for joint, name in zip(spec.joints, experiment.model.names, strict=True):
        assert joint.name == name
        joint.limited = False
        joint.actfrclimited = False
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        kinds = {"type": mujoco.mjtSensor.mjSENS_JOINTPOS, "objtype": mujoco.mjtObj.mjOBJ_JOINT}
        spec.add_sensor(name=f"{name}_position", objname=name, **kinds)
        rotor = experiment.config.rotors[f"{name}_rotor"]
        ixx, _, iyy, *_ = rotor.inertial.inertia
        joint.armature = rotor.gear_ratio**2 * max(ixx, iyy)
    return spec


def fit_leg(windows: Windows) -> tuple[Any, Any]:
    """Fit in stages; the model's specification and the parameters."""
    import peer_mujoco_sysid as tuned
    from mujoco.sysid import InertiaType, ParameterDict, TimeSeries, apply_param_modifiers, build_residual_fn

    deadline = time.perf_counter() + TIME_LIMIT
    spec = leg_spec()
    data = _sequences(spec, windows)

    def error(
        params: Any, _: Any, measured: Any, model: Any, everything: bool, state: Array, **options: object
    ) -> tuple[Array, Any, Any]:
        q = state[:, 1 : 1 + model.nq]
        q_measured, times = measured.data[1:], measured.times[1:]
        scaled = 1e3 * (q - q_measured) / np.sqrt(q.size * len(windows.position))
        mapping = measured.signal_mapping
        return scaled, TimeSeries(times, q, mapping), TimeSeries(times, q_measured, mapping)

    residual = build_residual_fn(models_sequences=[data], modify_residual=error)
    params, scales = ParameterDict(), {}
    for kind in (None, InertiaType.MassIpos, InertiaType.Pseudo):
        stage = _joint_parameters(spec) if kind is None else tuned.link_parameters(kind, spec)
        for param, scale in stage:
            params.add(param)  # in place of one of the same name
            scales[param.name] = scale
        scale = np.concatenate([scales[name] for name in params.keys()])  # noqa: SIM118 - no mapping
        start = params.move_off_bounds(0.002).as_vector()  # as mujoco.sysid advises
        cost = residual if kind is None else tuned.with_prior(residual, start, scale)
        in_time = tuned.optimize(params, cost, deadline, MIN_GAIN, x_scale=scale, eps=1e-5)
        assert in_time, f"mujoco.sysid did not end within {TIME_LIMIT:g} s"
        apply_param_modifiers(params, spec)
    return spec, params


def _joint_parameters(spec: Any) -> list[tuple[Any, Array]]:
    """Armature, damping and dry friction of every joint from their start values, with their scales."""
    from mujoco.sysid import Parameter

    parameters = []
    for joint in spec.joints:
        for kind, (least, most, scale) in JOINT_LIMITS.items():

            def apply(spec: Any, param: Any, name: str = joint.name, kind: str = kind) -> None:
                value = param.value[0]
                setattr(spec.joint(name), kind, [value, 0, 0] if kind == "damping" else value)

            start = float(np.ravel(getattr(joint, kind))[0])
            parameters.append(
                (Parameter(f"{joint.name} {kind}", start, least, most, modifier=apply), np.array([scale]))
            )
    return parameters


def _sequences(spec: Any, windows: Windows) -> Any:
    """The windows in the form of mujoco.sysid, compared with its state."""
    from mujoco.sysid import ModelSequences, SignalType, TimeSeries, create_initial_state

    model = spec.compile()
    names = [(f"{joint.name}_qpos", SignalType.MjStateQPos) for joint in spec.joints]
    states, torques, positions = [], [], []
    for i, (torque, position) in enumerate(zip(windows.torque, windows.position, strict=True)):
        times = np.arange(len(torque)) * model.opt.timestep
        states.append(create_initial_state(model, *windows.starts[:, :, i]))
        torques.append(TimeSeries(times, torque))
        positions.append(TimeSeries.from_names(times, position, model, names))
    labels = [f"window {i}" for i in range(len(states))]
    return ModelSequences("leg", spec, labels, states, torques, positions)


def position_error(spec: Any, windows: Windows) -> float:
    """RMS position error of rollouts over all windows and joints [rad]."""
    import mujoco
    from mujoco.rollout import rollout
    from mujoco.sysid import create_initial_state

    model = spec.compile()
    squares: list[Array] = []
    for i, (torque, position) in enumerate(zip(windows.torque, windows.position, strict=True)):
        start = create_initial_state(model, *windows.starts[:, :, i])
        states, _ = rollout(model, mujoco.MjData(model), start, torque[:-1])
        squares.append(np.square(states[0, :, 1 : 1 + model.nq] - position[1:]).ravel())
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def run_idtool(out: Path) -> float:
    """Wall time of the whole command `idtool fit` [s]."""
    started = time.perf_counter()
    startup.idtool("fit", sample_leg.URDF, sample_leg.LOG, "--validate", VALIDATION, "--out", out, "--quiet")
    return time.perf_counter() - started


def comparisons() -> list[Comparison]:
    """Fit with idtool, mujoco.sysid and idtool; simulate both models on the log that was not fitted."""
    fitted = Windows.of(sample_leg.leg_experiment().runs[0].signals)
    held_out = Windows.of(sample_leg.leg_experiment(VALIDATION).runs[0].signals)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        run_idtool(out)  # compiles what it imports
        before = run_idtool(out)
        started = time.perf_counter()
        spec, params = fit_leg(fitted)
        theirs = time.perf_counter() - started
        pairs = [(before, theirs), (run_idtool(out), theirs)]
        report = json.loads((out / "report.json").read_text())
    agreement = {
        "held-out position error of idtool [mrad]": 1e3 * report["simulation"]["position"]["overall"],
        "of mujoco.sysid [mrad]": 1e3 * position_error(spec, held_out),
        "of the URDF in MuJoCo [mrad]": 1e3 * position_error(leg_spec(), held_out),
    }
    count = len(params.as_vector())
    return [
        from_times(
            "identification of the leg from 10 s, and its motion on another log in windows of 1 s",
            f"mujoco.sysid {metadata.version('mujoco')}",
            pairs,
            agreement,
            f"The rollouts of mujoco.sysid have {count} parameters and idtool's start states. Its rotors are armature. "
            "The time of idtool includes start-up, standard errors, rollouts and page.",
        )
    ]


def main() -> None:
    """Print the ratio."""
    if not is_installed():
        print("error: mujoco.sysid: is not installed; pip install 'mujoco[sysid]'", file=sys.stderr)
        raise SystemExit(2)
    for comparison in comparisons():
        print(comparison)


if __name__ == "__main__":
    main()
