"""Quadruped that stands along a designed trajectory, compared with one that sways by hand.

Run ``python benchmarks/ground --out FOLDER --seconds 12`` first, then
``python benchmarks/ground_excitation.py FOLDER``.

`idtool excite --stand` designs a trajectory that complements the log of the hanging robot, with the URDF, whose bodies
are 10 to 30 % off. The true robot plays it in MuJoCo under joint controllers. The model is fitted to a log of this
motion and that of the hanging robot, and to as long a log of the hand-made motion and the same one of the hanging
robot. It prints the largest ratio of friction, how long a foot is off the ground, and the errors of mass and centre of
mass.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from ground.logs import record, write_csv
from ground.playback import play
from ground.quadruped import true_quadruped

import idtool


def main() -> None:
    """Design, play, fit, compare."""
    parser = argparse.ArgumentParser(description="Design, play and evaluate a trajectory of a standing quadruped.")
    parser.add_argument("folder", type=Path, help="from benchmarks/ground")
    parser.add_argument("--seconds", type=float, default=8.0, help="length of each standing log")
    parser.add_argument("--iterations", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0, help="of the robot, of the hand-made motion and of the search")
    options = parser.parse_args()
    folder = options.folder
    truth = true_quadruped(options.seed)

    model = idtool.Model(folder / "quadruped.urdf")
    result = idtool.excite(
        model,
        logs=folder / "hang.csv",
        stand=True,
        duration=options.seconds,
        slow=0.1,
        iterations=options.iterations,
        seed=options.seed,
    )
    result.save(folder / "designed_commands.csv")
    table = np.genfromtxt(folder / "designed_commands.csv", delimiter=",", names=True)
    commands = {name: table[name] for name in table.dtype.names}
    recording, feet = play(truth, commands, seed=options.seed)
    print(f"designed: friction {feet.friction:.2f}, off the ground {100 * feet.open_share:.2f} % of the time")
    write_csv(folder / "designed.csv", recording)
    write_csv(folder / "swaying.csv", record(truth, "stand", options.seconds, 100 * options.seed))
    for name in ("designed", "swaying"):
        fitted = idtool.fit(model, [folder / f"{name}.csv", folder / "hang.csv"], quick=True)
        robot = fitted.whole_robot
        assert robot is not None
        distance = np.linalg.norm(np.asarray(robot.com) - truth.center_of_mass)
        print(f"{name}: mass {100 * (robot.mass / truth.mass - 1):+.3f} %, centre of mass {1000 * distance:.2f} mm off")


if __name__ == "__main__":
    main()
