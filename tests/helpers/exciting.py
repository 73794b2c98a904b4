"""What the tests of excitation share: small robots, and Pinocchio's word on a designed trajectory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from commands import idtool
from numpy.typing import NDArray

from idtool.data.logs import JointLog, read_log

Array = NDArray[np.float64]

BOX = (
    '<inertial><origin xyz="{x} 0 0.02"/><mass value="{m}"/>'
    '<inertia ixx="0.01" iyy="0.02" izz="0.015" ixy="0.001" ixz="0" iyz="0"/></inertial>'
)


def body(name: str, m: float = 1.0, x: float = 0.15, extra: str = "") -> str:
    """A link with a mass and an inertia."""
    return f'<link name="{name}">{BOX.format(x=x, m=m)}{extra}</link>'


def joint(
    name: str,
    parent: str,
    child: str,
    axis: str = "0 1 0",
    xyz: str = "0.3 0 0",
    kind: str = "revolute",
    limit: str = 'lower="-1.5" upper="2" velocity="4" effort="30"',
    extra: str = '<dynamics damping="0.2" friction="0.5"/>',
) -> str:
    """A joint with friction."""
    limits = f"<limit {limit}/>" if limit else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}"/>'
        f'<axis xyz="{axis}"/>{limits}{extra}</joint>'
    )


def robot(*parts: str) -> str:
    """A URDF on a fixed base."""
    return f'<robot name="r"><link name="base"/>{"".join(parts)}</robot>'


def arm(effort: float = 30.0) -> str:
    """Two joints that swing up and down, one after the other."""
    limit = f'lower="-1.5" upper="2" velocity="4" effort="{effort}"'
    return robot(
        body("upper"),
        body("fore", 0.5),
        joint("a", "base", "upper", xyz="0 0 1", limit=limit),
        joint("b", "upper", "fore"),
    )


def excited(folder: Path, urdf: str | Path, *options: object, config: str = "") -> tuple[dict[str, Any], JointLog]:
    """The report and the log of a design that succeeds, by few iterations where nothing else is said."""
    folder.mkdir(exist_ok=True)
    path = folder / "robot.urdf"
    if isinstance(urdf, str):
        path.write_text(urdf)
        (folder / "robot.yaml").write_text(config or "{}")
    else:
        path = urdf
    few = [] if "--iterations" in options else ["--iterations", "8"]
    short = [] if "--duration" in options else ["--duration", "6"]
    out = folder / "out" / "motion.csv"
    done = idtool("excite", path, "--json", "--quiet", *few, *short, "--out", out, *options)
    assert done.code == 0, done.err
    return done.json, read_log(done.json["file"])


def derivatives(log: JointLog) -> tuple[Array, Array, Array]:
    """Positions, and their derivatives by differences within the log, shape (N, nv) each; ends left out."""
    q, dt = log.signals["qcmd"], log.dt
    v = (q[:-4] - 8 * q[1:-3] + 8 * q[3:-1] - q[4:]) / (12 * dt)
    a = (-q[:-4] + 16 * q[1:-3] - 30 * q[2:-2] + 16 * q[3:-1] - q[4:]) / (12 * dt**2)
    return q[2:-2], v, a


def torque(urdf: str, joints: Sequence[str], friction: Mapping[str, tuple[float, float]], log: JointLog) -> Array:
    """What Pinocchio says that a log's motion takes, friction added, shape (N, nv)."""
    model = pin.buildModelFromXML(urdf)
    data = model.createData()
    index = [model.joints[model.getJointId(name)].idx_v for name in joints]
    tau = []
    for q, v, a in zip(*derivatives(log), strict=True):
        full = np.zeros((3, model.nv))
        full[:, index] = q, v, a
        tau.append(pin.rnea(model, data, *full)[index])
    v = derivatives(log)[1]
    viscous, coulomb = np.transpose([friction[name] for name in joints])
    return np.array(tau) + viscous * v + coulomb * np.sign(v)
