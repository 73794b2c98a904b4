"""Write logs of a robot and of its simulator under the same commands: ``python benchmarks/simulator_pair.py FOLDER``.

Both are MuJoCo models of the same bodies. The simulator is the one of the file; the robot has other friction, rotors
and a delay from command to torque.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

JOINTS = ("yaw", "shoulder", "elbow")
STEP = 0.001  # s
_FINE = 10  # integrator steps per sample
KP, KD = np.array([60.0, 80.0, 40.0]), np.array([3.0, 4.0, 1.5])

URDF = """<robot name="arm">
  <link name="base"/>
  <link name="column">
    <inertial><origin xyz="0.02 0 0.1"/><mass value="3"/>
      <inertia ixx="0.03" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.02"/></inertial>
  </link>
  <link name="upper">
    <inertial><origin xyz="0 0 -0.15"/><mass value="2"/>
      <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.004"/></inertial>
  </link>
  <link name="lower">
    <inertial><origin xyz="0 0 -0.12"/><mass value="1"/>
      <inertia ixx="0.008" ixy="0" ixz="0" iyy="0.008" iyz="0" izz="0.001"/></inertial>
  </link>
  <joint name="yaw" type="continuous"><parent link="base"/><child link="column"/><axis xyz="0 0 1"/></joint>
  <joint name="shoulder" type="continuous"><parent link="column"/><child link="upper"/>
    <origin xyz="0 0 0.3"/><axis xyz="0 1 0"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
    <origin xyz="0 0 -0.3"/><axis xyz="0 1 0"/></joint>
</robot>
"""

MJCF = """<mujoco model="arm">
  <!-- the user's own file -->
  <compiler angle="radian"/>
  <default>
    <joint damping="0.2"/>
    <default class="arm"><joint frictionloss="0.1"/></default>
  </default>
  <worldbody>
    <light   pos='0 0 3' />
    <body name="column" childclass="arm">
      <inertial pos="0.02 0 0.1" mass="3" diaginertia="0.03 0.03 0.02"/>
      <joint name="yaw" axis="0 0 1" damping="0.5" frictionloss='0.4'/>
      <body name="upper" pos="0 0 0.3">
        <inertial pos="0 0 -0.15" mass="2" diaginertia="0.02 0.02 0.004"/>
        <joint name="shoulder" axis="0 1 0"/>
        <body name="lower" pos="0 0 -0.3">
          <inertial pos="0 0 -0.12" mass="1" diaginertia="0.008 0.008 0.001"/>
          <joint name="elbow" axis="0 1 0" frictionloss="0.2"></joint>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="yaw"/><motor joint="shoulder"/><motor joint="elbow"/></actuator>
</mujoco>
"""


ROBOT: Mapping[str, Mapping[str, float]] = {
    "yaw": {"damping": 0.9},
    "shoulder": {"frictionloss": 0.8, "armature": 0.08},
    "elbow": {"armature": 0.03},
}  # that differs from the file


@dataclass(frozen=True)
class Machine:
    """A MuJoCo model that is played commands.

    Attributes
    ----------
    text
        MJCF.
    joints
        Attributes of ``mujoco.MjModel`` that differ from the file, by joint: damping, frictionloss, armature.
    delay, command_delay
        Of the torque, and of the commanded position and velocity [s]; multiples of the sample time.
    noise
        Standard deviation of the logged torque's noise [N·m].
    """

    text: str
    joints: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    delay: float = 0.0
    command_delay: float = 0.0
    noise: float = 0.0

    def play(self, seconds: float, seed: int, commands: bool = False) -> Array:
        """Rows t, q, v, tau of a log, shape (N, 10), along a reference that the seed chooses.

        With ``commands``, qcmd and vcmd in place of tau, shape (N, 13).
        """
        model = mujoco.MjModel.from_xml_string(self.text)
        model.opt.timestep = STEP / _FINE
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        model.dof_solref[:] = [0.0005, 1.0]
        model.dof_solimp[:, :2] = 0.9999
        for name, values in self.joints.items():
            dof = model.joint(name).dofadr[0]
            for attribute, value in values.items():
                getattr(model, f"dof_{attribute}")[dof] = value
        data = mujoco.MjData(model)
        reference = _reference(seconds, seed)  # (N, 2, 3)
        rows = []
        torques: list[Array] = []
        for i, command in enumerate(reference):
            q, v = data.qpos.copy(), data.qvel.copy()
            q_command, v_command = reference[max(i - round(self.command_delay / STEP), 0)]
            torques.append(KP * (q_command - q) + KD * (v_command - v))
            rows.append([i * STEP, *q, *v, *(command.ravel() if commands else torques[-1])])
            data.ctrl[:] = torques[max(i - round(self.delay / STEP), 0)]
            mujoco.mj_step(model, data, _FINE)
        log = np.array(rows)
        if not commands:
            log[:, 7:] += self.noise * np.random.default_rng(seed).standard_normal((len(log), 3))
        return log


def _reference(seconds: float, seed: int) -> Array:
    """Commanded positions and velocities, shape (N, 2, 3)."""
    rng = np.random.default_rng(seed)
    frequency, phase = rng.uniform(0.2, 1.6, (3, 5)), rng.uniform(0, 2 * np.pi, (3, 5))
    amplitude = np.array([0.5, 0.4, 0.5])[:, None] / np.sqrt(5)
    t = STEP * np.arange(round(seconds / STEP))
    angle = 2 * np.pi * frequency * t[:, None, None] + phase
    position = (amplitude * np.sin(angle)).sum(axis=2)
    velocity = (amplitude * 2 * np.pi * frequency * np.cos(angle)).sum(axis=2)
    rise = np.minimum(t, 1.0)[:, None]
    return np.stack([rise * position, rise * velocity + (t < 1.0)[:, None] * position], axis=1)


def write_log(path: Path, rows: Array, commands: bool = False) -> Path:
    """Write a log as CSV."""
    path.parent.mkdir(parents=True, exist_ok=True)
    signals = ("q", "v", "qcmd", "vcmd") if commands else ("q", "v", "tau")
    names = [f"{signal}_{joint}" for signal in signals for joint in JOINTS]
    np.savetxt(path, rows, delimiter=",", header=",".join(["t", *names]), comments="", fmt="%.9g")
    return path


def robot(delay: float = 0.004) -> Machine:
    """The robot."""
    return Machine(MJCF, ROBOT, delay=delay, noise=0.02)


def write_pair(folder: Path, seconds: float = 12.0, name: str = "run1.csv", seed: int = 1) -> None:
    """Write ``arm.urdf`` and ``scene.xml``, and a log each of ``robot/`` and ``simulator/``."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.urdf").write_text(URDF)
    (folder / "scene.xml").write_text(MJCF)
    write_log(folder / "robot" / name, robot().play(seconds, seed))
    write_log(folder / "simulator" / name, Machine(MJCF).play(seconds, seed))


if __name__ == "__main__":
    write_pair(Path(sys.argv[1]))
