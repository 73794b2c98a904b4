"""Simulate the sample logs: `python sample_logs/make.py` writes them, truth.yaml and the folders beside this file.

Each robot's URDF and config hold what its designer believed. Here its true parameters are drawn, 10 to 30 % away, and
its experiment is run in MuJoCo on a model built from them (two_mass.py). Nothing of idtool takes part but the writer
of the files. The same seed gives the same numbers.

The robots with hidden effects, the simulator pair and the quadruped are those of benchmarks/, which share no code with
idtool either.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from types import ModuleType
from typing import Any

import belt_arm
import leg
import numpy as np
import yaml
from bodies import Array, Body, ellipsoid_matrix, true_link, true_rotor
from scipy.signal import butter, sosfiltfilt
from two_mass import RATE, build, prior_links, rigid_torque

from idtool.data.logs import make_log, write_log

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "benchmarks"))
from ground.logs import Recording, config_text, record, write_csv  # noqa: E402  # found from here on
from ground.robot import prior_robot, urdf_text  # noqa: E402
from ground.robots import KINDS, TRUE_ROBOTS  # noqa: E402
from hidden_effects.case_files import write_case  # noqa: E402
from hidden_effects.case_list import list_cases  # noqa: E402
from simulator_pair import write_pair  # noqa: E402

ROBOTS: dict[str, tuple[ModuleType, int]] = {"leg": (leg, 1), "belt_arm": (belt_arm, 2)}  # and its seed
HIDDEN = {"parallel_spring": "spring", "payload": "payload"}  # effect hidden in the log of a leg, and the folder
AS_CSV = "leg_validate"  # the log that is also written as CSV
BAND = 40.0  # Hz
MODEL_ERROR = 0.1  # what the two-mass gears may add to the rigid model, as a part of the noise in the band

# Decimals of the quadruped's channels, by the beginning of their names: a resolution below the noise, as sensors have.
DECIMALS = {"tau_": 2, "t": 3, "q_": 5, "v_": 3, "imu_w": 4, "imu_a": 2, "imu_q": 5, "contact_": 0}

TRUTH = """\
# The parameters that the sample logs were simulated with. Written by make.py.
#
# <robot>:
#   seed:      random seed of the parameters, the phases of the motion and the noise
#   bodies:    mass (kg), com (m) and inertia (kg m^2) of links and rotors, each in its own frame; the inertia about
#              the com as [ixx, ixy, iyy, ixz, iyz, izz]. A rotor is balanced: symmetric about its axis.
#   friction:  torque viscous * v + coulomb * sign(v) at the joint (N m s/rad, N m)
#   sensors:   position_step and velocity_step: resolution of q and v (rad, rad/s); torque_noise: standard deviation
#              of the white noise on tau (N m); velocity_lag: lag of v behind the derivative of q (s). With a
#              velocity_step of zero, v is the smoothed numerical derivative of the quantized q.
"""


def draw_bodies(urdf: Path, config: Mapping[str, Any], rng: np.random.Generator) -> dict[str, Body]:
    """Draw the true parameters of every link and rotor that the config names."""
    ellipsoids = config["bounding_ellipsoids"]
    bodies = {
        name: true_link(rng, prior, ellipsoid_matrix(ellipsoids[name][0]))
        for name, prior in prior_links(urdf, list(ellipsoids)).items()
    }
    for name, rotor in config["rotors"].items():
        prior, Q = Body.from_config(rotor["inertial"]), ellipsoid_matrix(rotor["bounding_ellipsoid"])
        bodies[name] = true_rotor(rng, prior, Q, rotor["axis"])
    return bodies


def in_band(signal: Array) -> Array:
    """Root mean square (nj,) of a signal (N, nj) below `BAND`."""
    filtered = sosfiltfilt(butter(4, BAND, fs=RATE, output="sos"), signal, axis=0)
    return np.asarray(np.sqrt((filtered**2).mean(axis=0)))


def make(name: str, experiment: ModuleType, seed: int) -> dict[str, Any]:
    """Simulate one robot, write its logs, print a row per log and return its part of truth.yaml."""
    urdf = HERE / f"{name}.urdf"
    config = yaml.safe_load(urdf.with_suffix(".yaml").read_text())
    rng = np.random.default_rng(seed)
    bodies = draw_bodies(urdf, config, rng)
    robot = build(urdf, config, bodies, experiment.FRICTION, experiment.GEAR_STIFFNESS, experiment.GEAR_DAMPING)
    for part, log in experiment.record(robot, rng).items():
        noise = in_band(log.torque_noise)
        error = float((in_band(log.run.tau - rigid_torque(robot, log.run)) / noise).max())
        if error > MODEL_ERROR:
            raise RuntimeError(f"{name}_{part}: the gears disturb the torque by {error:.2f} of its noise")
        path = HERE / f"{name}_{part}.mcap"
        table = make_log(path, log.t, tuple(config["joints"]), log.signals)
        write_log(path, table)
        if path.stem == AS_CSV:
            write_log(path.with_suffix(".csv"), table)
        peak_tau, peak_v = np.abs(log.run.tau).max(), np.abs(log.run.v).max()
        print(f"{path.stem:20}{len(log.t):8}{peak_tau:12.1f}{peak_v:12.1f}{noise.mean():12.3f}{error:12.3f}")
    return {
        "seed": seed,
        "bodies": {body: bodies[body].to_config() for body in bodies},
        "friction": {joint: asdict(friction) for joint, friction in experiment.FRICTION.items()},
        "sensors": asdict(experiment.SENSORS),
    }


def make_hidden(effect: str, folder: Path) -> None:
    """Simulate a leg with an effect that its model lacks; write its model, log and truth."""
    shutil.rmtree(folder, ignore_errors=True)  # a case that is there already would be left as it is
    (case,) = (
        case
        for case in list_cases("single", robots=["planar2"], magnitudes=["strong"], seeds=[0], seconds=12.0)
        if [hidden.effect for hidden in case.hidden] == [effect]
    )
    write_case(case, folder)


def make_quadruped(folder: Path, seconds: float = 6.0) -> None:
    """Simulate a quadruped that stands, walks and hangs, twice each; write its URDF, configuration, logs and truth."""
    folder.mkdir(exist_ok=True)
    truth = TRUE_ROBOTS["quadruped"](0)
    (folder / "quadruped.urdf").write_text(urdf_text(prior_robot(truth, 0)))
    (folder / "quadruped.yaml").write_text(config_text(truth, "unknown"))
    (folder / "true.urdf").write_text(urdf_text(truth))
    for kind in KINDS:
        for seed, name in enumerate([kind, f"{kind}2"]):
            write_csv(folder / f"{name}.csv", as_sensors_resolve(record(truth, kind, seconds, seed)))


def as_sensors_resolve(recording: Recording) -> Recording:
    """A recording without forces on the feet, its channels rounded to the resolution of sensors."""
    columns = {}
    for name, values in recording.columns.items():
        for start, decimals in DECIMALS.items():
            if name.startswith(start):
                columns[name] = values.round(decimals) + 0.0  # no -0
                break
    return Recording(columns)


def main() -> None:
    """Write all samples and truth.yaml."""
    print(f"{'log':20}{'samples':>8}{'peak N m':>12}{'peak rad/s':>12}{'noise N m':>12}{'model error':>12}")
    truth = {name: make(name, experiment, seed) for name, (experiment, seed) in ROBOTS.items()}
    text = TRUTH + yaml.safe_dump(truth, sort_keys=False, default_flow_style=None, width=110)
    (HERE / "truth.yaml").write_text(text)
    for effect, name in HIDDEN.items():
        make_hidden(effect, HERE / "hidden" / name)
    write_pair(HERE / "pair")
    make_quadruped(HERE / "quadruped")


if __name__ == "__main__":
    main()
