"""`Foot`: a contact on which a robot stands, and what the ground can exert there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError
from idtool.common.names import join_names, suggestion
from idtool.robot.config import Config, Contact
from idtool.robot.geometry import link_geometry
from idtool.robot.model import RobotModel

_MIN_FEET_POINTS = 3  # points of contact, without a sole, on which a robot can stand


@dataclass(frozen=True)
class Foot:
    """A contact on which a robot stands.

    Attributes
    ----------
    contact
        The contact as configured.
    body
        Index of its body.
    point
        Its place in the body's frame, or the centre of its ball, shape (3,) [m].
    sole
        Extent of a sole from the contact's place along x and y of the link, as its lowest and highest x and y, shape
        (2, 2) [m]; None for a point.
    """

    contact: Contact
    body: int
    point: Array
    sole: Array | None

    @property
    def name(self) -> str:
        """Name of the contact."""
        return self.contact.name

    @property
    def size(self) -> int:
        """Number of components of the wrench that the ground exerts."""
        return 3 if self.sole is None else 6


def find_feet(
    model: RobotModel, config: Config, names: Sequence[str], sole_size: tuple[float, float] | None
) -> tuple[Foot, ...]:
    """The contacts on which a robot stands.

    Parameters
    ----------
    model
        The robot, with a floating base.
    config
        Its configuration.
    names
        Names of the contacts; none: all at the ends of limbs. A rope may hold the torso.
    sole_size
        Length and width of every sole about its contact [m]; None: by the geometry of the link.

    Raises
    ------
    ConfigError
        If a name is unknown, or these contacts cannot carry a robot.
    """
    candidates = {}
    for contact in config.contacts:
        if not model.bodies[model.frames[contact.link].body].is_base:
            candidates[contact.name] = contact
    for name in names:
        if name not in candidates:
            what = f"{name} is not a contact of the configuration off the base; {suggestion(name, candidates)}"
            raise ConfigError("--feet", what)
    at_ends = [name for name, contact in candidates.items() if _is_at_end(contact, model)]
    chosen = [candidates[name] for name in dict.fromkeys(names or at_ends)]
    has_sole = any(contact.kind == "surface" for contact in chosen)
    if not has_sole and len(chosen) < _MIN_FEET_POINTS:
        given = join_names([contact.name for contact in chosen]) or "none"
        what = f"a robot stands on at least three points or on a surface, but the feet are {given}"
        raise ConfigError("contacts", f"{what}; add the other feet to contacts, or leave out --stand")
    return tuple(_foot(model, contact, sole_size) for contact in chosen)


def _is_at_end(contact: Contact, model: RobotModel) -> bool:
    """True for a contact on a link that carries no other moving link."""
    carriers = {body.mount.body for body in model.bodies if body.kind == "link"}
    return model.frames[contact.link].body not in carriers


def _foot(model: RobotModel, contact: Contact, sole_size: tuple[float, float] | None) -> Foot:
    frame = model.frames[contact.link]
    place = np.asarray(contact.point)
    sole = None
    if contact.kind == "surface":
        sole = _sole(model, contact, sole_size)
    return Foot(contact, frame.body, frame.p + frame.R @ place, sole)


def _sole(model: RobotModel, contact: Contact, sole_size: tuple[float, float] | None) -> Array:
    """Extent of a sole, as in `Foot`."""
    if sole_size is not None:
        half = np.asarray(sole_size) / 2
        return np.stack([-half, half])
    points = link_geometry(model.robot, contact.link).points
    if not len(points):
        what = f"link {contact.link} has no geometry that tells the size of its sole"
        raise ConfigError("--sole-size", f"{what}; give --sole-size LENGTH WIDTH")
    horizontal = points[:, :2] - np.asarray(contact.point)[:2]
    return np.stack([horizontal.min(axis=0), horizontal.max(axis=0)])
