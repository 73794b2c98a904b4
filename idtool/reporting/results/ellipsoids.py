"""Records of `idtool ellipsoids`, without and with `--check`."""

from __future__ import annotations

from typing import Annotated

from idtool.reporting.results.base import Ellipsoid, Keys, ReadOnly, Record, Result, Sentences, Vector, field


class EllipsoidsReport(Result):
    """Result of `idtool ellipsoids`."""

    bounding_ellipsoids: Annotated[ReadOnly[tuple[Ellipsoid, ...]], Keys("link")] = field(
        "Bounding ellipsoids, as in the [configuration](config.md#where-a-bodys-mass-may-be)."
    )


class RepairedLink(Record):
    """A link's inertia in the repaired URDF."""

    mass: float = field("Mass [kg].")
    com: Vector = field("Centre of mass, shape (3,) [m].")
    inertia_com: Vector = field("Inertia about the centre of mass: [xx, xy, yy, xz, yz, zz] [kg·m²].")
    moved: float = field("Largest change of the inertia about the centre of mass, over its largest entry.")


class CheckedLink(Record):
    """A link and whether a body can have its inertia."""

    mass: float = field("Mass [kg].")
    violations: Sentences = field("Why no body can have its inertia, one sentence each.")
    nearest: RepairedLink | None = field("With `--repair`, what is in the new URDF; null where nothing was changed.")


class CheckReport(Result):
    """Result of `idtool ellipsoids --check`."""

    links: Annotated[ReadOnly[CheckedLink], Keys("link")] = field("All links with an inertial.")
    urdf: str = field("The URDF.")
