"""Repeatability and prediction error of a quadruped's fit, with mirrored legs and with four independent ones.

Run ``python benchmarks/mirrored_legs.py FOLDER``, where FOLDER holds go2.urdf and chirp_4.csv to chirp_7.csv (not part
of this repository). Each chirp is fitted by itself. The spread is the standard deviation over the four fits, and the
error of each fit is that on the other three chirps.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.estimation.identification import choose_sets
from idtool.estimation.problem.estimate import estimate
from idtool.estimation.study.learning import held_out, rms
from idtool.robot.config import Config, Mirror, read_config
from idtool.robot.urdf.reading import Robot, read_robot

Array = NDArray[np.float64]

CONFIG = Path(__file__).parents[1] / "configs" / "go2.yaml"
CHIRPS = (4, 5, 6, 7)
BODIES = ("hip", "thigh", "calf", "hip_rotor", "thigh_rotor", "calf_rotor")
JOINTS = ("hip_joint", "thigh_joint", "calf_joint")
PAIRS = (("FR", "FL"), ("RR", "RL"))


def silent(stage: str, share: float) -> None:
    """Ignore the progress."""


def fit_coefficients(experiment: Experiment) -> Array:
    """Coefficients of a fit to one chirp."""
    sets = choose_sets(experiment.model.bodies, None)
    data = experiment.reduce(silent)
    regularization, equalities = experiment.config.regularization.fixed_or_weak(), experiment.equalities
    return estimate(experiment.equation, experiment.model.bodies, data, sets, regularization, equalities).theta


def compare(robot: Robot, config: Config, folder: Path, name: str) -> None:
    """Fit every chirp by itself, and print spread and error."""
    logs = [folder / f"chirp_{n}.csv" for n in CHIRPS]
    thetas, errors = [], []
    for log in logs:
        others = [other for other in logs if other != log]
        experiment = prepare(robot, config, [log], others)
        theta = fit_coefficients(experiment)
        error = rms(held_out(experiment, silent), experiment.equation.active(), theta)
        thetas.append(theta)
        errors.append(error[-1])  # over all joints
    coefficients = experiment.equation.coefficients
    theta, spread = np.mean(thetas, axis=0), np.std(thetas, axis=0, ddof=1)
    inertial = np.array([c.scale is not None for c in coefficients])
    friction = ~inertial & (theta > 0)
    masses = np.array([c.name == "m" for c in coefficients])
    scale = np.array([c.scale or 1.0 for c in coefficients])
    print(
        f"{name:34s} rms on other chirps {np.mean(errors):.4f} N·m; spread: "
        f"masses {np.median(spread[masses] / theta[masses]):.1%}, "
        f"inertia parameters {np.median((spread / scale)[inertial]):.2%} of body, "
        f"friction {np.median(spread[friction] / theta[friction]):.1%}"
    )


def main() -> None:
    """Compare free legs, mirrored bodies, and mirrored bodies with equal friction."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    robot, config = read_robot(folder / "go2.urdf"), read_config(CONFIG)
    bodies, joints = [], []
    for copy, original in PAIRS:
        bodies += [Mirror(body=f"{copy}_{name}", of=f"{original}_{name}", plane="xz") for name in BODIES]
        joints += [Mirror(joint=f"{copy}_{name}", of=f"{original}_{name}") for name in JOINTS]
    variants = {
        "four free legs": (),
        "two and two mirrored": tuple(bodies),
        "mirrored, friction equal as well": (*bodies, *joints),
    }
    for name, mirror in variants.items():
        compare(robot, config.model_copy(update={"mirror": mirror}), folder, name)


if __name__ == "__main__":
    main()
