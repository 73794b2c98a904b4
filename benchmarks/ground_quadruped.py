"""Quadruped on the ground: what is identified of it, compared with the true robot.

Run ``python benchmarks/ground --out FOLDER --seconds 20`` first, then ``python benchmarks/ground_quadruped.py FOLDER``.

The model is fitted to logs of standing, trotting and hanging, with unknown and with measured forces on the feet. It
prints the errors of mass and centre of mass, and the error on each other log, whitened by the noise of the rows and
compared with that of the true robot.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from ground.__main__ import KINDS
from ground.robot import JOINTS, Quadruped, true_quadruped

import idtool


def true_model(folder: Path, robot: Quadruped, config: Mapping[str, Any], noise: Mapping[str, float]) -> idtool.Model:
    """The true robot with its friction and a given noise of the rows."""
    friction = {}
    for joint, viscous, coulomb in zip(JOINTS, robot.viscous, robot.coulomb, strict=True):
        friction[joint] = {"viscous": float(viscous), "coulomb": float(coulomb)}
    base = {**config["base"], "noise": dict(noise)}
    return idtool.Model(folder / "true.urdf", config={**config, "base": base, "friction": friction})


def whitened_error(model: idtool.Model, log: Path, noise: Mapping[str, float]) -> float:
    """RMS error of all rows in units of their noise."""
    rms = idtool.validate(model, log, simulation=False).rms.model
    return float(np.sqrt(np.mean([(rms[name] / sigma) ** 2 for name, sigma in noise.items()])))


def main() -> None:
    """Fit with unknown and with measured forces, and compare."""
    parser = argparse.ArgumentParser(description="What idtool identifies of a quadruped on the ground.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    folder = options.folder
    truth = true_quadruped(options.seed)
    logs = [next(folder.glob(f"{kind}.*")) for kind in KINDS]
    for name in ("quadruped", "measured"):
        config = yaml.safe_load((folder / f"{name}.yaml").read_text())
        result = idtool.fit(idtool.Model(folder / "quadruped.urdf", config=config), logs, quick=True)
        robot = result.whole_robot
        assert robot is not None
        com_error = 1e3 * np.linalg.norm(np.asarray(robot.com) - truth.center_of_mass)
        print(
            f"{name}: mass {100 * (robot.mass / truth.mass - 1):+.3f} %, centre of mass off by {com_error:.2f} mm "
            f"(prior {100 * (robot.prior_mass / truth.mass - 1):+.1f} %)",
            flush=True,
        )
        noise = result.model.config["base"]["noise"]
        reference = true_model(folder, truth, config, noise)
        for kind in KINDS:
            (log,) = folder.glob(f"{kind}2.*")
            own = whitened_error(result.model, log, noise)
            of_truth = whitened_error(reference, log, noise)
            ratio = own / of_truth
            print(f"  {kind}: held-out error {own:.3f}, of the true robot {of_truth:.3f}: {ratio:.3f}", flush=True)


if __name__ == "__main__":
    main()
