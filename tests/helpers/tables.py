"""Known arms after their tables of joints (Khalil & Kleinfinger 1986, Craig): the links' inertia is any.

A joint's frame is that of the joint before it, turned by alpha about x, moved by a along x, then moved by d along and
turned by theta about the joint's own axis z. Units: m and rad.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from robots import inertial, joint
from scipy.spatial.transform import Rotation

Row = tuple[float, float, float, float] | tuple[float, float, float, float, str]  # alpha, a, d, theta, kind of joint

P, N = np.pi / 2, -np.pi / 2

PUMA: tuple[Row, ...] = (
    (0, 0, 0, 0),
    (N, 0, 0.2435, 0),
    (0, 0.4318, -0.0934, 0),
    (P, -0.0203, 0.4331, 0),
    (N, 0, 0, 0),
    (P, 0, 0, 0),
)
RX90: tuple[Row, ...] = ((0, 0, 0, 0), (P, 0, 0, 0), (0, 0.45, 0, 0), (N, 0, 0.45, 0), (P, 0, 0, 0), (N, 0, 0, 0))
UR5: tuple[Row, ...] = (
    (0, 0, 0.08916, 0),
    (P, 0, 0, 0),
    (0, -0.425, 0, 0),
    (0, -0.39225, 0.10915, 0),
    (P, 0, 0.09456, 0),
    (N, 0, 0.0823, 0),
)
PANDA: tuple[Row, ...] = (
    (0, 0, 0.333, 0),
    (N, 0, 0, 0),
    (P, 0, 0.316, 0),
    (P, 0.0825, 0, 0),
    (N, -0.0825, 0.384, 0),
    (P, 0, 0, 0),
    (P, 0.088, 0, 0),
)
STANFORD: tuple[Row, ...] = (
    (0, 0, 0.412, 0),
    (N, 0, 0.154, 0),
    (P, 0, 0.3, 0, "prismatic"),
    (0, 0, 0, 0),
    (N, 0, 0, 0),
    (P, 0, 0, 0),
)
SCARA: tuple[Row, ...] = ((0, 0, 0.4, 0), (0, 0.35, 0, 0), (0, 0.25, 0, 0, "prismatic"), (0, 0, 0, 0))
GANTRY: tuple[Row, ...] = ((0, 0, 0, 0, "prismatic"), (P, 0, 0, 1, "prismatic"), (P, 0, 0, 1, "prismatic"))


def table_urdf(rows: Sequence[Row], rng: np.random.Generator, parent: str = "base", prefix: str = "") -> str:
    """Links and joints 1, 2, … after a table, with the inertia of random bodies."""
    parts = []
    for i, row in enumerate(rows, start=1):
        alpha, a, d, theta = row[:4]
        turned = Rotation.from_euler("X", alpha)
        xyz = np.array([a, 0, 0]) + turned.apply([0, 0, d])
        rpy = (turned * Rotation.from_euler("Z", theta)).as_euler("xyz")
        place = " ".join(repr(float(x)) for x in xyz), " ".join(repr(float(x)) for x in rpy)
        inside = f'<origin xyz="{place[0]}" rpy="{place[1]}"/><axis xyz="0 0 1"/>'
        kind = row[4] if len(row) > 4 else "revolute"
        parts.append(f'<link name="{prefix}link{i}">{inertial(rng)}</link>')
        before = f"{prefix}link{i - 1}" if i > 1 else parent
        parts.append(joint(f"{prefix}joint{i}", str(kind), before, f"{prefix}link{i}", inside))
    return "".join(parts)


def rooted(*parts: str) -> str:
    return f'<robot name="arm"><link name="base"/>{"".join(parts)}</robot>'
