"""A planar arm whose links are given solids, to see what they collide with."""

from __future__ import annotations

from collections.abc import Callable

from robots import joint

from idtool.robot.collision import SelfCollision
from idtool.robot.model import RobotModel

Build = Callable[..., RobotModel]

SPHERE = '<sphere radius="{0}"/>'
BOX = '<box size="{0} {1} {2}"/>'
UPPER, LOWER = 0.5, 0.3  # lengths of the arm's links [m]


def solid(shape: str, xyz: str = "0 0 0", rpy: str = "0 0 0", tag: str = "collision") -> str:
    return f'<{tag}><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{shape}</geometry></{tag}>'


def place(x: float, y: float = 0.0, axis: str = "0 0 1") -> str:
    return f'<origin xyz="{x} {y} 0"/><axis xyz="{axis}"/>'


def arm(base: str, upper: str, tip: str, kind: str = "revolute", extra: str = "") -> str:
    """Joint j1 at the base's origin, j2 at 0.5 m from it, about z or along x; a link fixed at 0.3 m from that."""
    return "".join(
        [
            f'<robot name="arm"><link name="base">{base}</link><link name="upper">{upper}</link><link name="elbow"/>',
            f'<link name="tip">{tip}</link>{extra}',
            joint("j1", "revolute", "base", "upper", place(0)),
            joint("j2", kind, "upper", "elbow", place(UPPER, axis="1 0 0" if kind == "prismatic" else "0 0 1")),
            joint("j3", "fixed", "elbow", "tip", place(LOWER)),
            "</robot>",
        ]
    )


def checked(model: RobotModel, locked_joints: dict[str, float] | None = None) -> SelfCollision:
    found = SelfCollision.from_model(model, locked_joints)
    assert found is not None
    return found


def with_swinging_sphere(text: str) -> str:
    """The robot with another link at its base, which j4 swings about z at y = 3, with a sphere at a distance of 1 m."""
    links = f'<link name="moved"/><link name="end">{solid(SPHERE.format(0.05))}</link>'
    joints = joint("j4", "revolute", "base", "moved", place(0, 3)) + joint("j5", "fixed", "moved", "end", place(1))
    return text.replace("</robot>", f"{links}{joints}</robot>")
