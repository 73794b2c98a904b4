"""`ConstraintSet`: the inertia parameters that a body may have. A new set is one new file in this folder."""

from __future__ import annotations

from abc import ABC, abstractmethod

from idtool.robot.body import Body
from idtool.robot.inequality import Piece


class ConstraintSet(ABC):
    """A convex cone of inertia parameters.

    Attributes
    ----------
    name
        As in the configuration.
    tightness
        Order among the sets: a tighter set lies within a looser one, where both apply.
    automatic
        True if a body may get it without being asked for; False where it leaves out bodies that could exist.
    """

    name: str
    tightness: int
    automatic: bool = True

    def applies_to(self, body: Body) -> bool:
        """True if the body has what the set needs, such as a bounding ellipsoid."""
        return True

    @abstractmethod
    def pieces(self, body: Body) -> tuple[Piece, ...]:
        """The pieces whose sum the body's parameters are, each with its inequalities."""
