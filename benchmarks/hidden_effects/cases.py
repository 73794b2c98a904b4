"""Cases: a robot, what is hidden in it, a seed; `cases` lists them, `write_case` writes what `idtool diagnose` gets.

>>> for case in cases("single", robots=["planar2"], magnitudes=["strong"], seeds=[0]):
...     write_case(case, Path("/tmp/hidden") / case.name)

or ``python benchmarks/hidden_effects FOLDER --robots planar2 --magnitudes strong,ordinary --seeds 0 --seconds 20``.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import yaml

from hidden_effects.effects import Hidden, lacking
from hidden_effects.logs import record, write_log
from hidden_effects.motion import draw_motion
from hidden_effects.plans import Case, cases
from hidden_effects.robots import ROBOTS, Body, Robot, Truth, draw_truth, rotor, urdf_text
from hidden_effects.sizes import drawn

__all__ = ["Case", "Hidden", "Written", "cases", "write_case"]


@dataclass(frozen=True)
class Written:
    """A case's files."""

    urdf: Path
    config: Path
    log: Path
    truth: Path


def write_case(case: Case, folder: Path) -> Written:
    """Make a case's log, and write it with URDF, config and truth; the log last."""
    robot = ROBOTS[case.robot]
    files = Written(*(folder / name for name in ("robot.urdf", "config.yaml", "log.csv", "truth.json")))
    if files.log.exists():
        return files
    folder.mkdir(parents=True, exist_ok=True)
    truth = draw_truth(robot, case.seed, exact=case.inertia == "fixed")
    motion = draw_motion(robot, case.seed, case.seconds)
    hidden = drawn(robot, truth, case.hidden, motion, case.seed, case.inertia == "fixed")
    recording = record(robot, truth, hidden, motion, case.sensors, case.seed)
    files.urdf.write_text(urdf_text(robot))
    files.config.write_text(yaml.safe_dump(_config(robot, hidden), sort_keys=False))
    told = {"case": case.name, "robot": case.robot, "seed": case.seed, "inertia": case.inertia}
    told |= {"seconds": case.seconds, "hidden": [asdict(one) for one in hidden], "truth": _told(robot, truth)}
    told |= {"torque_noise": dict(zip(robot.names, recording.noise.tolist(), strict=True))}
    files.truth.write_text(json.dumps(told, indent=1))
    part = files.log.with_suffix(".part")
    write_log(part, robot, recording, case.sensors.velocity)
    part.rename(files.log)
    return files


def _config(robot: Robot, hidden: tuple[Hidden, ...]) -> dict[str, Any]:
    """What the designer tells idtool: rotors, and the friction that the model has."""
    friction, missing = lacking(hidden)
    rotors = {}
    for joint in robot.joints:
        if joint.name in missing:
            continue
        body = rotor(joint)
        rotors[f"{joint.name}_rotor"] = {
            "joint": joint.name,
            "gear_ratio": joint.gear,
            "parent": joint.parent,
            "origin": {"xyz": list(joint.xyz), "rpy": list(joint.rpy)},
            "axis": list(joint.axis),
            "inertial": {"mass": body.mass, "com": [0.0, 0.0, 0.0], "inertia": _six(body)},
        }
    return {"rotors": rotors} | ({"friction": friction} if friction else {})


def _six(body: Body) -> list[float]:
    return [float(body.inertia[a, b]) for a, b in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]


def _told(robot: Robot, truth: Truth) -> dict[str, Any]:
    def body(one: Body) -> dict[str, Any]:
        return {"mass": one.mass, "com": one.com.tolist(), "inertia": _six(one)}

    return {
        "links": {name: body(one) for name, one in truth.links.items()},
        "rotors": {name: body(one) for name, one in truth.rotors.items()},
        "viscous": dict(zip(robot.names, truth.viscous.tolist(), strict=True)),
        "coulomb": dict(zip(robot.names, truth.coulomb.tolist(), strict=True)),
    }
