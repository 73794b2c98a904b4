"""`LinkEffect`: an effect that acts on one link, and its reading from an entry of a configuration."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from typing import Self

import numpy as np
from typing_extensions import override

from idtool.common.exceptions import ConfigError
from idtool.common.names import printable, suggestion
from idtool.dynamics.effects.entry_parameters import check_parameter_names, entry_location
from idtool.dynamics.effects.fixed_effect import FixedEffect
from idtool.robot.body import Frame
from idtool.robot.config import EffectEntry
from idtool.robot.model import RobotModel


class LinkEffect(FixedEffect):
    """An effect on one link, which may be part of a body under another name.

    Attributes
    ----------
    parameter_names, optional_parameter_names
        Names of the parameters.
    link
        Name of the link.
    frame
        Pose of the link's frame in the body that carries it.
    chain
        The model reduced to the bodies from the base to that body, which comes last.

    Parameters
    ----------
    model
        The robot.
    link
        Name of the link.
    frame
        Pose of its frame in the body that carries it.
    """

    parameter_names: tuple[str, ...]
    optional_parameter_names: tuple[str, ...] = ()

    def __init__(self, model: RobotModel, link: str, frame: Frame) -> None:
        super().__init__(model)
        self.link = link
        self.frame = frame
        self.chain = _chain(model, frame.body)

    @classmethod
    @override
    def from_entry(cls, entry: EffectEntry, model: RobotModel) -> Self:
        if entry.link is None or entry.joint is not None:
            raise ConfigError(entry_location(entry), "acts on a link; give `link` and not `joint`")
        links = model.robot.links
        if entry.link not in links:
            message = f"{printable(entry.link)} is not a link of the URDF; {suggestion(entry.link, links)}"
            raise ConfigError(entry_location(entry), message)
        check_parameter_names(entry, cls.parameter_names, cls.optional_parameter_names)
        return cls.from_checked_entry(entry, model, _link_frame(entry, entry.link, model))

    @classmethod
    @abstractmethod
    def from_checked_entry(cls, entry: EffectEntry, model: RobotModel, frame: Frame) -> Self:
        """Effect that an entry describes whose parameter names and link have been checked."""

    @property
    @override
    def key(self) -> tuple[str | float, ...]:
        return self.id, self.link


def _link_frame(entry: EffectEntry, link: str, model: RobotModel) -> Frame:
    """Pose of a link's frame in the body that carries it, through fixed joints of links without inertial."""
    frames = {member.link: member.frame for body in model.bodies for member in body.members}
    parent_joints = {joint.child: joint for joint in model.robot.joints.values()}
    R = np.eye(3)
    p = np.zeros(3)
    ancestor = link
    while ancestor not in frames:
        if ancestor not in parent_joints:
            what = f"link {printable(link)} is not moved by any joint; name a moving link"
            raise ConfigError(entry_location(entry), what)
        joint = parent_joints[ancestor]
        if joint.kind != "fixed":
            reason = f"is carried by joint {printable(joint.name)}, which is locked"
            raise ConfigError(
                entry_location(entry), f"link {printable(link)} {reason}; name the parent link of this joint"
            )
        R, p = joint.R @ R, joint.p + joint.R @ p
        ancestor = joint.parent
    return frames[ancestor].compose(R, p)


def _chain(model: RobotModel, last: int) -> RobotModel:
    """Model of the bodies from the base to one of them; see `LinkEffect.chain`."""
    bodies = []
    index = last
    while index >= 0:
        bodies.append(model.bodies[index])
        index = model.bodies[index].mount.body
    bodies.reverse()
    chain = []
    for i, body in enumerate(bodies):
        chain.append(replace(body, mount=replace(body.mount, body=i - 1)))
    return replace(model, bodies=tuple(chain))
