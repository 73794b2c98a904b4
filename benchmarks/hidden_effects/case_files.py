"""Files of a case: `write_case` writes URDF, configuration, logs and truth, for `idtool diagnose`.

A single log is ``log.csv``; several logs are ``log1.csv``, ``log2.csv``, …, for the diagnosis, and ``unseen.csv``.

>>> for case in list_cases("single", robots=["planar2"], magnitudes=["strong"], seeds=[0]):
...     write_case(case, Path("/tmp/hidden") / case.name)

or ``python benchmarks/hidden_effects FOLDER --robots planar2 --magnitudes strong,ordinary --seeds 0 --seconds 20``.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import yaml

from hidden_effects.case_list import Case
from hidden_effects.effects import HiddenEffect, config_omissions, with_stronger_motors
from hidden_effects.friction import draw_friction
from hidden_effects.logs import Recording, record, write_log
from hidden_effects.magnitudes import draw_parameters
from hidden_effects.motion import draw_motion
from hidden_effects.robots import ROBOTS, Body, Robot, Truth, draw_truth, links_with_motors, rotor, urdf_text

_MAX_TRIES = 8
_STRENGTHENING = 1.05  # of motors, until they keep their command
_UNSEEN_PACE = 1.2  # of the motion that is not for the diagnosis, relative to the first one


@dataclass(frozen=True)
class CaseFiles:
    """Paths of a case's files; ``logs`` are those for the diagnosis, ``unseen`` is one that is not."""

    urdf: Path
    config: Path
    truth: Path
    logs: tuple[Path, ...]
    unseen: Path | None

    @property
    def log(self) -> Path:
        """The first log."""
        return self.logs[0]


def case_files(case: Case, folder: Path) -> CaseFiles:
    """Paths of a case's files in a folder."""
    urdf, config, truth = (folder / name for name in ("robot.urdf", "config.yaml", "truth.json"))
    if case.logs == 1:
        return CaseFiles(urdf, config, truth, (folder / "log.csv",), None)
    logs = tuple(folder / f"log{k + 1}.csv" for k in range(case.logs))
    return CaseFiles(urdf, config, truth, logs, folder / "unseen.csv")


def write_case(case: Case, folder: Path) -> CaseFiles:
    """Write a case's files into a folder, the logs last; do nothing if the logs are there already."""
    files = case_files(case, folder)
    paths = [*files.logs, files.unseen] if files.unseen else list(files.logs)
    if all(path.exists() for path in paths):
        return files
    folder.mkdir(parents=True, exist_ok=True)
    robot = ROBOTS[case.robot]
    is_fixed = case.inertia == "fixed"
    truth = draw_truth(robot, case.seed, exact=is_fixed)
    motion = draw_motion(robot, case.seed, case.seconds)
    hidden = draw_parameters(robot, truth, case.hidden, motion, case.seed, is_fixed)
    friction = draw_friction(case.friction, case.seed)
    motions = [motion]
    for k in range(1, case.logs):
        motions.append(draw_motion(robot, case.seed, case.seconds, k))
    if files.unseen:
        motions.append(draw_motion(robot, case.seed, case.seconds, relative_pace=_UNSEEN_PACE))

    def record_all(hidden: tuple[HiddenEffect, ...]) -> list[Recording]:
        return [
            record(robot, truth, hidden, commanded, case.sensors, case.seed, friction, k)
            for k, commanded in enumerate(motions)
        ]

    hidden, recorded = _with_strong_motors(hidden, record_all)
    recordings = dict(zip(paths, recorded, strict=True))

    friction_terms, without_rotor = config_omissions(hidden)
    files.urdf.write_text(urdf_text(robot, links_with_motors(robot, without_rotor)))
    config = _config(robot, friction_terms, without_rotor)
    files.config.write_text(yaml.safe_dump(config, sort_keys=False))
    content = {
        "case": case.name,
        "robot": case.robot,
        "seed": case.seed,
        "inertia": case.inertia,
        "seconds": case.seconds,
        "hidden": [asdict(effect) for effect in hidden],
        "truth": _truth_as_dict(robot, truth),
        "friction": asdict(friction),
        "noise": case.sensors.noise,
        "torque_noise": {
            path.name: dict(zip(robot.names, recording.noise.tolist(), strict=True))
            for path, recording in recordings.items()
        },
    }
    files.truth.write_text(json.dumps(content, indent=1))
    for path, recording in recordings.items():
        part = path.with_suffix(".part")
        write_log(part, robot, recording, case.sensors.has_velocity)
        part.rename(path)
    return files


def _with_strong_motors(
    hidden: tuple[HiddenEffect, ...], record_all: Callable[[tuple[HiddenEffect, ...]], list[Recording]]
) -> tuple[tuple[HiddenEffect, ...], list[Recording]]:
    """Hidden effects whose saturated motors are strong enough to keep their command, and all recordings."""
    for _ in range(_MAX_TRIES):
        try:
            return hidden, record_all(hidden)
        except RuntimeError:
            stronger = with_stronger_motors(hidden, _STRENGTHENING)
            if stronger == hidden:
                raise
            hidden = stronger
    return hidden, record_all(hidden)


def _config(robot: Robot, friction: dict[str, dict[str, bool]], without_rotor: set[str]) -> dict[str, Any]:
    """The designer's configuration: rotors, and the friction that the model has."""
    rotors = {}
    for joint in robot.joints:
        if joint.name in without_rotor:
            continue
        body = rotor(joint)
        rotors[f"{joint.name}_rotor"] = {
            "joint": joint.name,
            "gear_ratio": joint.gear,
            "parent": joint.parent,
            "origin": {"xyz": list(joint.xyz), "rpy": list(joint.rpy)},
            "axis": list(joint.axis),
            "inertial": {"mass": body.mass, "com": [0.0, 0.0, 0.0], "inertia": _inertia_entries(body)},
        }
    config: dict[str, Any] = {"rotors": rotors}
    if friction:
        config["friction"] = friction
    return config


def _inertia_entries(body: Body) -> list[float]:
    """Entries ixx, ixy, iyy, ixz, iyz, izz of a body's inertia."""
    return [float(body.inertia[a, b]) for a, b in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]


def _truth_as_dict(robot: Robot, truth: Truth) -> dict[str, Any]:
    return {
        "links": {name: _body_as_dict(body) for name, body in truth.links.items()},
        "rotors": {name: _body_as_dict(body) for name, body in truth.rotors.items()},
        "viscous": dict(zip(robot.names, truth.viscous.tolist(), strict=True)),
        "coulomb": dict(zip(robot.names, truth.coulomb.tolist(), strict=True)),
    }


def _body_as_dict(body: Body) -> dict[str, Any]:
    return {"mass": body.mass, "com": body.com.tolist(), "inertia": _inertia_entries(body)}
