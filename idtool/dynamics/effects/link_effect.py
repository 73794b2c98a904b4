"""`LinkEffect`: an effect that acts on one link, and how an entry of a configuration is read as one."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from typing import Self

import numpy as np

from idtool.common.exceptions import ConfigError
from idtool.common.names import nearest, shown
from idtool.dynamics.effects.held_effect import HeldEffect
from idtool.dynamics.effects.named import check_names, place
from idtool.robot.body import Frame
from idtool.robot.config import EffectEntry
from idtool.robot.model import Model


class LinkEffect(HeldEffect):
    """An effect on one link, which may be part of a body under another name.

    Attributes
    ----------
    names
        Of its parameters.
    link
        The link.
    frame
        Where the link's frame is in the body that carries it.
    chain
        The model with no bodies but those that that body hangs on, and itself, which comes last.

    Parameters
    ----------
    model
        The robot.
    link
        The link.
    frame
        Where it is.
    """

    names: tuple[str, ...]

    def __init__(self, model: Model, link: str, frame: Frame) -> None:
        super().__init__(model)
        self.link, self.frame = link, frame
        self.chain = _chain(model, frame.body)

    @classmethod
    def of(cls, entry: EffectEntry, model: Model) -> Self:
        """See `NamedEffect.of`."""
        if entry.link is None or entry.joint is not None:
            raise ConfigError(place(entry), "acts on a link; give link, and no joint")
        links = model.robot.links
        if entry.link not in links:
            raise ConfigError(place(entry), f"{shown(entry.link)} is no link of the URDF; {nearest(entry.link, links)}")
        check_names(entry, cls.names)
        return cls.read(entry, model, _frame(entry, entry.link, model))

    @classmethod
    @abstractmethod
    def read(cls, entry: EffectEntry, model: Model, frame: Frame) -> Self:
        """The effect that an entry with the right names describes."""

    @property
    def key(self) -> tuple[str | float, ...]:
        """See `NamedEffect.key`."""
        return self.id, self.link


def _frame(entry: EffectEntry, link: str, model: Model) -> Frame:
    """Where a link's frame is in the body that carries it, by way of links on fixed joints that have no inertial."""
    places = {member.link: member.frame for body in model.bodies for member in body.members}
    above = {joint.child: joint for joint in model.robot.joints.values()}
    R, p, at = np.eye(3), np.zeros(3), link
    while at not in places:
        if at not in above:
            raise ConfigError(place(entry), f"link {shown(link)} moves with no joint; name one that does")
        joint = above[at]
        if joint.kind != "fixed":
            held = f"hangs on joint {shown(joint.name)}, which is held still"
            raise ConfigError(place(entry), f"link {shown(link)} {held}; name the link before it")
        R, p, at = joint.R @ R, joint.p + joint.R @ p, joint.parent
    return places[at].then(R, p)


def _chain(model: Model, last: int) -> Model:
    """See `LinkEffect.chain`."""
    bodies = []
    while last >= 0:
        bodies.append(model.bodies[last])
        last = bodies[-1].mount.body
    chain = (replace(body, mount=replace(body.mount, body=i - 1)) for i, body in enumerate(reversed(bodies)))
    return replace(model, bodies=tuple(chain))
