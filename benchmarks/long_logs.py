"""Robots of any number of joints and logs of any length, for measurements of time and memory.

Run ``python benchmarks/long_logs.py FOLDER [--branches 4] [--length 3] [--minutes 1] [--logs 1] [--rotors]``. It
writes ``robot.urdf``, ``robot.yaml`` and ``log_<i>.mcap``. A robot is some equal branches on a fixed trunk: 4 branches
of 3 joints are a quadruped on a stand, 1 of 60 is a chain. Joints follow sums of sines; the torque is that of
Pinocchio's inverse dynamics with true inertias that differ from those of the URDF, plus friction and noise.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml
from numpy.typing import NDArray

from idtool.data.logs import make_log, write_log

Array = NDArray[np.float64]

RATE = 1000.0  # Hz
_AXES = ("1 0 0", "0 1 0", "0 1 0")  # of the joints of a branch, by turns
_LINK_LENGTH = 0.2  # m
_LINK_RADIUS = 0.05  # m
_MASS = 2.0  # kg, of the first link of a branch
_SPREAD = 0.15  # of true masses and centres about those of the URDF
_SINES = 8  # of each joint's motion
_NOISE = {"q": 2e-5, "v": 5e-3, "tau": 0.1}
_GEAR_RATIO = 8.0
_ROTOR_INERTIA = 2e-4  # kg·m²
_ROTOR_MASS = 0.2  # kg


@dataclass(frozen=True)
class BranchedRobot:
    """Equal branches of links on a fixed trunk.

    Attributes
    ----------
    branches, length
        Number of branches, and of joints in each.
    has_rotors
        True if every joint has a geared rotor.
    """

    branches: int
    length: int
    has_rotors: bool = False

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, branch after branch."""
        return tuple(f"b{branch}_j{i}" for branch in range(self.branches) for i in range(self.length))

    def urdf(self, masses: Array, centres: Array) -> str:
        """The URDF with masses [kg], shape (nv,), and centres of mass along the links [m], shape (nv,)."""
        lines = ['<robot name="branched">', '<link name="trunk"/>']
        for k, joint in enumerate(self.joints):
            branch, i = divmod(k, self.length)
            parent = "trunk" if i == 0 else f"b{branch}_l{i - 1}"
            x = 0.3 * branch if i == 0 else 0.0
            z = 0.0 if i == 0 else -_LINK_LENGTH
            mass, centre = masses[k], centres[k]
            across = mass * _LINK_LENGTH**2 / 14
            along = mass * _LINK_RADIUS**2 / 3
            lines.append(
                f'<link name="b{branch}_l{i}"><inertial><origin xyz="0 0 {-centre}"/><mass value="{mass}"/>'
                f'<inertia ixx="{across}" iyy="{across}" izz="{along}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
                f'<joint name="{joint}" type="revolute"><parent link="{parent}"/><child link="b{branch}_l{i}"/>'
                f'<origin xyz="{x} 0 {z}"/><axis xyz="{_AXES[i % len(_AXES)]}"/>'
                '<limit lower="-3" upper="3" effort="500" velocity="30"/></joint>'
            )
        return "\n".join([*lines, "</robot>"])

    def config(self) -> dict[str, object]:
        """The configuration as plain data: an ellipsoid for every link, friction, and rotors if there are any."""
        axes = [1.5 * _LINK_RADIUS, 1.5 * _LINK_RADIUS, 0.7 * _LINK_LENGTH]
        ellipsoid = {"center": [0.0, 0.0, -_LINK_LENGTH / 2], "semi_axes": axes}
        links = [joint.replace("_j", "_l") for joint in self.joints]
        config: dict[str, object] = {"bounding_ellipsoids": {link: [ellipsoid] for link in links}}
        if self.has_rotors:
            config["rotors"] = {f"{joint}_rotor": self._rotor(k) for k, joint in enumerate(self.joints)}
        return config

    def _rotor(self, k: int) -> dict[str, object]:
        branch, i = divmod(k, self.length)
        joint = self.joints[k]
        axis = [float(x) for x in _AXES[i % len(_AXES)].split()]
        across = _ROTOR_INERTIA / 2
        ixx, iyy, izz = (_ROTOR_INERTIA if x else across for x in axis)
        return {
            "joint": joint,
            "gear_ratio": _GEAR_RATIO,
            "parent": "trunk" if i == 0 else f"b{branch}_l{i - 1}",
            "origin": {"xyz": [0.3 * branch if i == 0 else 0.0, 0.0, 0.0 if i == 0 else -_LINK_LENGTH]},
            "axis": axis,
            "inertial": {
                "mass": _ROTOR_MASS,
                "com": [0.0, 0.0, 0.0],
                "inertia": [ixx, 0.0, iyy, 0.0, 0.0, izz],
            },
        }


def drawn_bodies(robot: BranchedRobot, rng: np.random.Generator) -> tuple[Array, Array]:
    """Masses [kg] and centres of mass [m] of the links, shape (nv,) each."""
    nv = len(robot.joints)
    masses = _MASS * 0.9 ** (np.arange(nv) % robot.length) * rng.uniform(1 - _SPREAD, 1 + _SPREAD, nv)
    centres = _LINK_LENGTH / 2 * rng.uniform(1 - _SPREAD, 1 + _SPREAD, nv)
    return masses, centres


def write_log_of(robot: BranchedRobot, urdf: str, seed: int, minutes: float, path: Path) -> None:
    """Write a log of the robot whose true bodies are those of a URDF."""
    rng = np.random.default_rng(seed)
    model = pin.buildModelFromXML(urdf)
    data = model.createData()
    nv = model.nv
    names = list(model.names)[1:]
    samples = round(60 * minutes * RATE)
    t = np.arange(samples) / RATE
    q, v, tau = np.zeros((3, samples, nv))
    scale = min(1.0, 3.0 / robot.length)
    frequency = 2 * np.pi * rng.uniform(0.1, 2.0, (_SINES, nv))
    amplitude = scale * rng.uniform(0.05, 0.2, (_SINES, nv))
    start = rng.uniform(0, 2 * np.pi, (_SINES, nv))
    viscous, coulomb = rng.uniform(0.05, 0.3, nv), rng.uniform(0.2, 1.0, nv)
    for first in range(0, samples, 10_000):
        rows = slice(first, min(first + 10_000, samples))
        phase = frequency * t[rows, None, None] + start
        q[rows] = (amplitude * np.sin(phase)).sum(axis=1)
        v[rows] = (amplitude * frequency * np.cos(phase)).sum(axis=1)
        a = -(amplitude * frequency**2 * np.sin(phase)).sum(axis=1)
        for k, row in enumerate(range(rows.start, rows.stop)):
            tau[row] = pin.rnea(model, data, q[row], v[row], a[k])
        tau[rows] += viscous * v[rows] + coulomb * np.sign(v[rows])
        if robot.has_rotors:
            tau[rows] += _GEAR_RATIO**2 * _ROTOR_INERTIA * a
        for name, signal in (("q", q), ("v", v), ("tau", tau)):
            signal[rows] += _NOISE[name] * rng.standard_normal((rows.stop - rows.start, nv))
    write_log(path, make_log(path, t, tuple(names), {"q": q, "v": v, "tau": tau}))


def write_robot(folder: Path, robot: BranchedRobot) -> str:
    """Write the robot as its engineers believe it to be; return the true URDF."""
    folder.mkdir(parents=True, exist_ok=True)
    nv = len(robot.joints)
    nominal = _MASS * 0.9 ** (np.arange(nv) % robot.length)
    (folder / "robot.urdf").write_text(robot.urdf(nominal, np.full(nv, _LINK_LENGTH / 2)))
    (folder / "robot.yaml").write_text(yaml.safe_dump(robot.config(), sort_keys=False))
    return robot.urdf(*drawn_bodies(robot, np.random.default_rng(0)))


def main() -> None:
    """Write a robot and its logs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--branches", type=int, default=4)
    parser.add_argument("--length", type=int, default=3, help="joints of a branch")
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--logs", type=int, default=1)
    parser.add_argument("--rotors", action="store_true")
    options = parser.parse_args()
    robot = BranchedRobot(options.branches, options.length, options.rotors)
    true_urdf = write_robot(options.folder, robot)
    for i in range(options.logs):
        write_log_of(robot, true_urdf, i, options.minutes, options.folder / f"log_{i}.mcap")


if __name__ == "__main__":
    main()
