"""Write a robot on the ground, its configuration and its logs: ``python benchmarks/ground --out FOLDER``.

The folder gets the URDF and the configurations that a user would have, logs of standing, walking and hanging, a second
log of each for validation, and the true robot. The bodies of the URDF are 10 to 30 % off. In ``quadruped.yaml`` or
``humanoid.yaml`` the forces on the feet are unknown, in ``measured.yaml`` they are measured, and in ``sensors.yaml``
wrench sensors in the ankles measure what they transmit. With ``--pose-rate``, the logs also have the pose of the base,
as by motion capture, and ``pose.yaml`` uses it in place of the IMU.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from ground.logs import CONFIGS, Sensors, config_text, record, write_csv, write_mcap
from ground.robot import Robot, prior_robot, urdf_text
from ground.robots import KINDS, TRUE_ROBOTS

_MAX_FALLS = 5


def write_logs(folder: Path, truth: Robot, kind: str, seconds: float, seed: int, ending: str, sensors: Sensors) -> None:
    """Write two logs of a kind of motion; another motion is tried if the robot falls."""
    written = 0
    for motion_seed in range(100 * seed, 100 * seed + 2 + _MAX_FALLS):
        try:
            recording = record(truth, kind, seconds, motion_seed, sensors=sensors)
        except RuntimeError as fall:
            print(f"{kind}: {fall}; another motion is tried", flush=True)
            continue
        written += 1
        path = folder / f"{kind}{written if written > 1 else ''}{ending}"
        write_csv(path, recording) if ending == ".csv" else write_mcap(path, truth, recording)
        print(path, flush=True)
        if written == 2:
            return


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the robot and its logs."""
    parser = argparse.ArgumentParser(description="Write a robot on the ground and its logs.")
    parser.add_argument("--out", type=Path, required=True, help="folder")
    parser.add_argument("--robot", choices=list(TRUE_ROBOTS), default="quadruped")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--seconds", type=float, default=16.0, help="length of each log")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--mcap", action="store_true", help="write MCAP in place of CSV")
    parser.add_argument("--pose-rate", type=int, help="log the pose of the base at this rate [samples/s]; CSV only")
    options = parser.parse_args(arguments)

    options.out.mkdir(parents=True, exist_ok=True)
    truth = TRUE_ROBOTS[options.robot](options.seed)
    (options.out / f"{truth.name}.urdf").write_text(urdf_text(prior_robot(truth, options.seed)))
    (options.out / "true.urdf").write_text(urdf_text(truth))
    for forces in CONFIGS:
        if forces == "sensors" and not truth.wrench_sensors:
            continue
        name = truth.name if forces == "unknown" else forces
        (options.out / f"{name}.yaml").write_text(config_text(truth, forces))
    if options.pose_rate is not None:
        (options.out / "pose.yaml").write_text(config_text(truth, base_sensor="pose"))
    sensors = Sensors(pose_rate=options.pose_rate)
    ending = ".mcap" if options.mcap else ".csv"
    for kind in options.kinds.split(","):
        write_logs(options.out, truth, kind, options.seconds, options.seed, ending, sensors)


if __name__ == "__main__":
    main()
