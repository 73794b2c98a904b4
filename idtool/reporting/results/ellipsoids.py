"""Records of `idtool ellipsoids`, without and with `--check`."""

from __future__ import annotations

from typing import Annotated

from idtool.reporting.results.base import Keys, LinkEllipsoid, ReadOnly, Record, Result, Sentences, Vector, field


class EllipsoidsReport(Result):
    """Result of `idtool ellipsoids`."""

    bounding_ellipsoids: Annotated[ReadOnly[tuple[LinkEllipsoid, ...]], Keys("link")] = field(
        "Bounding ellipsoids, as in the [configuration](config.md#bounds-of-the-bodies)."
    )


class RepairedLink(Record):
    """A link's inertia in the repaired URDF."""

    mass: float = field("Mass [kg].")
    com: Vector = field("Centre of mass, shape (3,) [m].")
    inertia_com: Vector = field("Inertia about the centre of mass: [xx, xy, yy, xz, yz, zz] [kg·m²].")
    moved: float = field("Largest change of the inertia about the centre of mass, divided by its largest entry.")


class CheckedLink(Record):
    """A link, and whether its inertia is realizable."""

    mass: float = field("Mass [kg].")
    violations: Sentences = field("Reasons why its inertia is not realizable, one sentence each.")
    nearest: RepairedLink | None = field("With `--repair`, the inertia in the new URDF; null if it was not changed.")


class CheckReport(Result):
    """Result of `idtool ellipsoids --check`."""

    links: Annotated[ReadOnly[CheckedLink], Keys("link")] = field("All links with an inertial.")
    urdf: str = field("The URDF.")
