"""Robot on the ground with a hidden effect: what ``idtool diagnose`` names.

Run ``python benchmarks/ground --out FOLDER`` first, with ``--robot humanoid`` for a humanoid, then
``python benchmarks/ground_effects.py FOLDER``.

A model is fitted to the logs without an effect. Then the robot stands, trots and hangs once more with each effect in
turn, and the model is diagnosed. With ``--inertia refit``, a payload cannot be told from the trunk.
"""

from __future__ import annotations

import argparse
import copy
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from ground.logs import Recording, Sensors, record, write_csv
from ground.plant import Payload, Physics
from ground.robot import Body, Robot
from ground.robots import KINDS, TRUE_ROBOTS

import idtool

_JOINTS = {"quadruped": "FL_calf_joint", "humanoid": "l_knee_joint"}  # with the effect
_PAYLOAD_MASS = 2.5  # kg
_PAYLOAD_LINKS = {"quadruped": "trunk", "humanoid": "waist_pitch"}
_PAYLOAD_COM = {"quadruped": np.array([-0.08, 0.02, 0.09]), "humanoid": np.array([0.03, 0.02, 0.2])}  # m
_DELAY = 0.006  # s
_FOOT_RADIUS_CHANGE = 0.01  # m
_MAX_FALLS = 5


@dataclass(frozen=True)
class Case:
    """A hidden effect.

    Attributes
    ----------
    effect, target
        As a diagnosis names it; empty: nothing is hidden.
    physics, sensors
        Of the simulator.
    change
        Change of the configuration that the model starts from.
    """

    effect: str = ""
    target: str | None = None
    physics: Physics = field(default_factory=Physics)
    sensors: Sensors = field(default_factory=Sensors)
    change: Callable[[dict[str, Any]], None] = lambda config: None


def cases(truth: Robot) -> dict[str, Case]:
    """All hidden effects that the robot can have, by name."""
    joint, payload_link = _JOINTS[truth.name], _PAYLOAD_LINKS[truth.name]
    payload = Body.ellipsoid(_PAYLOAD_MASS, _PAYLOAD_COM[truth.name], np.array([0.1, 0.07, 0.05]))
    of_both = {
        "clean": Case(),
        "payload": Case("payload", payload_link, physics=Physics(payloads=[Payload(payload_link, payload)])),
        "coulomb": Case("coulomb_friction", joint, change=partial(_leave_out_coulomb, joint)),
        "torque_delay": Case("time_delay", None, sensors=Sensors(torque_delay=_DELAY)),
        "imu_delay": Case("imu_delay", None, sensors=Sensors(imu_delay=_DELAY)),
        "rotor": Case("rotor_inertia", joint, change=partial(_leave_out_rotor, truth, joint)),
    }
    if all(foot.is_sole for foot in truth.feet):
        return of_both
    return {**of_both, "foot_radius": Case("foot_radius", None, change=_make_feet_smaller)}


def _leave_out_coulomb(joint: str, config: dict[str, Any]) -> None:
    config["friction"][joint] = {"viscous": config["friction"][joint]["viscous"], "coulomb": False}


def _leave_out_rotor(truth: Robot, joint: str, config: dict[str, Any]) -> None:
    """Take the rotor for a part of the link that carries it, as in a URDF whose masses are right."""
    rotor = config["rotors"].pop(f"{joint}_rotor")
    mount = truth.mounts[joint]
    parameters = {**rotor["inertial"], "com": mount.position.tolist()}
    config["effects"] = [{"effect": "payload", "link": mount.parent, "parameters": parameters}]


def _make_feet_smaller(config: dict[str, Any]) -> None:
    for contact in config["contacts"]:
        if "radius" in contact:
            contact["radius"] -= _FOOT_RADIUS_CHANGE


def write_logs(folder: Path, truth: Robot, case: Case, seconds: float, seed: int) -> list[Path]:
    """Write the logs of a case: stand, walk and hang."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for kind in KINDS:
        path = folder / f"{kind}.csv"
        paths.append(path)
        if path.exists():
            continue
        write_csv(path, _recorded(truth, case, kind, seconds, 100 * seed + 50))
    return paths


def _recorded(truth: Robot, case: Case, kind: str, seconds: float, first_seed: int) -> Recording:
    """Recording of the first motion in which the robot does not fall."""
    for seed in range(first_seed, first_seed + _MAX_FALLS):
        try:
            return record(truth, kind, seconds, seed, copy.deepcopy(case.physics), case.sensors)
        except RuntimeError as fall:
            print(f"{kind}: {fall}; another motion is tried", flush=True)
    raise RuntimeError(f"the robot falls in all motions of the kind {kind}")


def diagnose_case(
    folder: Path,
    robot: str,
    config: Mapping[str, Any],
    seconds: float,
    seed: int,
    inertia: Literal["refit", "fixed"],
    name: str,
) -> str:
    """Line of a table: what a diagnosis names of a case."""
    truth = TRUE_ROBOTS[robot](seed)
    case = cases(truth)[name]
    logs = write_logs(folder / name, truth, case, seconds, seed)
    own = copy.deepcopy(dict(config))
    case.change(own)
    own["base"]["imu"]["delay"] = 0  # with auto, the logs would be corrected before the diagnosis
    model = idtool.Model(folder / "fit" / "identified.urdf", config=own)
    started = time.perf_counter()
    result = idtool.diagnose(model, logs, inertia=inertia)
    seconds_taken = time.perf_counter() - started
    named = []
    for step in result.steps:
        values = {key: _rounded(value) for key, value in step.parameters.items() if key != "inertia"}
        named.append(f"{step.effect} {step.joint or step.link or ''} {values}")
    found = [(step.effect, step.joint or step.link) for step in result.steps]
    expected = [(case.effect, case.target)] if case.effect else []
    mark = "ok" if found == expected else "NO"
    return f"{mark} {name} ({result.verdict}, {seconds_taken:.0f} s): {'; '.join(named) or 'nothing'}"


def _rounded(value: object) -> object:
    if isinstance(value, float):
        return float(f"{value:.4g}")
    if isinstance(value, list):
        return [_rounded(x) for x in value]
    return value


def main() -> None:
    """Diagnose all cases."""
    parser = argparse.ArgumentParser(description="What idtool names of a robot on the ground.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=16.0, help="length of each log")
    parser.add_argument("--cases", help="names, separated by commas; all unless given")
    parser.add_argument("--inertia", choices=("fixed", "refit"), default="fixed")
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()

    folder = options.folder
    (robot,) = (name for name in TRUE_ROBOTS if (folder / f"{name}.urdf").exists())
    fitted = folder / "fit"
    if not (fitted / "model.yaml").exists():
        config = yaml.safe_load((folder / f"{robot}.yaml").read_text())
        logs = [next(folder.glob(f"{kind}.*")) for kind in KINDS]
        idtool.fit(idtool.Model(folder / f"{robot}.urdf", config=config), logs, quick=True).save(fitted)
    config = yaml.safe_load((fitted / "model.yaml").read_text())
    run = partial(diagnose_case, folder, robot, config, options.seconds, options.seed, options.inertia)
    names = options.cases.split(",") if options.cases else list(cases(TRUE_ROBOTS[robot](options.seed)))
    if options.jobs == 1:
        for name in names:
            print(run(name), flush=True)
        return
    with ProcessPoolExecutor(options.jobs) as pool:
        for line in pool.map(run, names):
            print(line, flush=True)


if __name__ == "__main__":
    main()
