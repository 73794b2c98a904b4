"""Robot on the ground: what is identified of it, compared with the true robot.

Run ``python benchmarks/ground --out FOLDER --seconds 20`` first, with ``--robot humanoid`` for a humanoid, then
``python benchmarks/ground_robot.py FOLDER``.

The model is fitted to logs of standing, walking and hanging, with unknown and with measured forces on the feet, and
with wrench sensors in the ankles if the robot has them. It prints time and peak memory of each fit, the errors of mass
and centre of mass, and for each other log

- the error on it, whitened by the noise of the rows and compared with that of the true robot;
- the error of the predicted force and moment on the base: difference of the identified and the true robot along the
  log's filtered motion, RMS of the vector's length.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import time
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from ground.logs import CONFIGS
from ground.robot import Robot
from ground.robots import KINDS, TRUE_ROBOTS

import idtool
from idtool.api.data import load_experiment
from idtool.estimation.dataset.experiment import coefficients_of

Config = dict[str, Any]


@dataclass(frozen=True)
class HeldOut:
    """Errors on a log that was not used for the fit.

    Attributes
    ----------
    whitened, whitened_of_truth
        RMS error of all rows in units of their noise, of the identified and of the true robot.
    base_force, base_moment
        RMS error of the predicted wrench on the base [N, N m].
    """

    whitened: float
    whitened_of_truth: float
    base_force: float
    base_moment: float


@dataclass(frozen=True)
class Outcome:
    """What a fit finds, and what it takes.

    Attributes
    ----------
    mass_error, prior_mass_error
        Relative, of the identified robot and of the URDF.
    com_error
        Distance of the centre of mass from the true one, all joints at zero [m].
    seconds, cpu_seconds, peak_memory
        Wall time and time on processors [s], and peak memory of the process [MiB].
    held_out
        By kind of motion.
    """

    mass_error: float
    prior_mass_error: float
    com_error: float
    seconds: float
    cpu_seconds: float
    peak_memory: float
    held_out: Mapping[str, HeldOut]


def outcome_of(folder: Path, robot_name: str, forces: str, seed: int) -> Outcome:
    """Fit with one of the configurations, and compare with the true robot."""
    truth = TRUE_ROBOTS[robot_name](seed)
    config = read_config(folder, robot_name, forces)
    logs = [next(folder.glob(f"{kind}.*")) for kind in KINDS]
    started, cpu_started = time.perf_counter(), time.process_time()
    result = idtool.fit(idtool.Model(folder / f"{robot_name}.urdf", config=config), logs, quick=True)
    seconds, cpu_seconds = time.perf_counter() - started, time.process_time() - cpu_started
    peak_memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    fitted = folder / f"{forces}_fit"
    result.save(fitted)

    noise = result.model.config["base"]["noise"]
    same_band = {"filter": result.model.config["filter"]}
    reference = true_model(folder, truth, {**config, **same_band}, noise)
    measured = {**read_config(folder, robot_name, "measured"), **same_band}
    held_out = {}
    for kind in KINDS:
        (log,) = folder.glob(f"{kind}2.*")
        errors = whitened_error(result.model, log, noise), whitened_error(reference, log, noise)
        held_out[kind] = HeldOut(*errors, *base_wrench_error(fitted, folder / "true.urdf", measured, log))
    whole = result.whole_robot
    assert whole is not None
    return Outcome(
        mass_error=whole.mass / truth.mass - 1,
        prior_mass_error=whole.prior_mass / truth.mass - 1,
        com_error=float(np.linalg.norm(np.asarray(whole.com) - truth.center_of_mass)),
        seconds=seconds,
        cpu_seconds=cpu_seconds,
        peak_memory=peak_memory,
        held_out=held_out,
    )


def read_config(folder: Path, robot_name: str, forces: str) -> Config:
    """One of the configurations that ``benchmarks/ground`` wrote."""
    name = robot_name if forces == "unknown" else forces
    return dict(yaml.safe_load((folder / f"{name}.yaml").read_text()))


def true_model(folder: Path, truth: Robot, config: Config, noise: Mapping[str, float]) -> idtool.Model:
    """The true robot with its friction, soft feet and offsets of its sensors, and a given noise of the rows."""
    friction = {}
    for joint, viscous, coulomb in zip(truth.joints, truth.viscous, truth.coulomb, strict=True):
        friction[joint] = {"viscous": float(viscous), "coulomb": float(coulomb)}
    sensors = []
    for sensor in config.get("wrench_sensors", []):
        sensors.append({**sensor, "offset": truth.wrench_sensors[sensor["joint"]].tolist()})
    compliance = {foot.name: 1 / foot.softness.stiffness for foot in truth.feet if not foot.is_sole}
    contacts = []
    for contact in config["contacts"]:
        own = {"compliance": compliance[contact["name"]]} if contact["name"] in compliance else {}
        contacts.append({**contact, **own})
    base = {**config["base"], "noise": dict(noise)}
    changes = {"base": base, "contacts": contacts, "friction": friction, "wrench_sensors": sensors}
    complete = {**config, **changes}
    return idtool.Model(folder / "true.urdf", config=complete)


def whitened_error(model: idtool.Model, log: Path, noise: Mapping[str, float]) -> float:
    """RMS error, in units of their noise, of all rows of which contacts leave something."""
    rms = idtool.validate(model, log, simulation=False).rms.model
    in_noise = [error / noise[name] for name, error in rms.items() if name in noise and error is not None]
    return float(np.sqrt(np.mean(np.square(in_noise))))


def base_wrench_error(fitted: Path, true_urdf: Path, measured: Config, log: Path) -> tuple[float, float]:
    """RMS difference of the force [N] and the moment [N m] on the base that two robots predict along a log's motion.

    Parameters
    ----------
    fitted
        Folder with the identified model.
    true_urdf
        The true robot.
    measured
        Configuration with measured forces, and the true rotors.
    log
        The log.
    """
    identified = yaml.safe_load((fitted / "model.yaml").read_text())
    rotors = {"rotors": identified["rotors"]}
    model = idtool.Model(fitted / "identified.urdf", config={**measured, **rotors})
    experiment = load_experiment(model, (), [log])
    truth = idtool.Model(true_urdf, config=measured)
    true_coefficients = coefficients_of(truth.robot, truth.settings, experiment)
    equation = experiment.equation
    (run,) = experiment.runs
    errors = []
    for batch in experiment.batches(run, held_out=True):
        residuals = [equation.residual(batch.motion, theta) for theta in (equation.prior, true_coefficients)]
        errors.append(batch.filter(residuals[1] - residuals[0])[experiment.model.base_coordinates])
    squares = np.square(np.concatenate(errors, axis=1)).mean(axis=1)
    return float(np.sqrt(squares[:3].sum())), float(np.sqrt(squares[3:].sum()))


def main() -> None:
    """Fit with every configuration, each in a process of its own, and print what is found."""
    parser = argparse.ArgumentParser(description="What idtool identifies of a robot on the ground.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    folder = options.folder
    (robot_name,) = (name for name in TRUE_ROBOTS if (folder / f"{name}.urdf").exists())
    for forces in CONFIGS:
        if forces == "sensors" and not (folder / "sensors.yaml").exists():
            continue
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
            outcome = process.submit(outcome_of, folder, robot_name, forces, options.seed).result()
        print(
            f"{forces}: mass {100 * outcome.mass_error:+.3f} % (prior {100 * outcome.prior_mass_error:+.1f} %), "
            f"centre of mass off by {1e3 * outcome.com_error:.2f} mm; {outcome.seconds:.0f} s "
            f"({outcome.cpu_seconds:.0f} s of CPU), {outcome.peak_memory:.0f} MiB",
            flush=True,
        )
        for kind, errors in outcome.held_out.items():
            ratio = errors.whitened / errors.whitened_of_truth
            print(
                f"  {kind}: held-out error {errors.whitened:.3f}, of the true robot {errors.whitened_of_truth:.3f}: "
                f"{ratio:.3f}; wrench on the base {errors.base_force:.3f} N, {errors.base_moment:.4f} N m",
                flush=True,
            )


if __name__ == "__main__":
    main()
