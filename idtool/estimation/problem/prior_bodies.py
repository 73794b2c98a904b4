"""The bodies that a fit is pulled towards: the URDF's, as far as they are to be believed, at the masses that are known.

A CAD export without materials, or a URDF written for pictures, gives links of different sizes the same inertia, a unit
one or next to none. A fit that is pulled towards such a prior is pulled nowhere. In its stead every such body is filled
evenly: within its bounds, or where it has none along the way to the joints that it carries. Its density follows from
the known total mass, or else from the torque.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import ConvexHull

from idtool.common.arrays import Array
from idtool.common.names import some
from idtool.dynamics.effects import build_effects
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.weights import weighted_rows
from idtool.robot.body import Body
from idtool.robot.config import Config
from idtool.robot.config.estimation import Measured
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inertia import SIZE, from_pseudo_inertia, mass_com_inertia
from idtool.robot.model import Model
from idtool.robot.shapes import Shape

_ALIKE = 1e-6  # relative difference of two inertias below which they are the same
_FEWEST = 3  # links that are all the same by accident no more
_OTHER_SIZE = 1.2  # ratio of the largest link's size to the smallest's from which they are not of one kind
_LIGHTEST = 1e-3  # kg of a body that a joint moves
_LENGTH = 0.2  # m of a link where no joints tell
_THICKNESS = 0.15  # radius of a link without bounds, in units of a typical link's length
_BALL = 0.25  # radius of the last link without bounds, likewise: of about the volume of such a rod
_DENSITY = 500.0  # kg/m³ of bounds where neither torque nor total mass tells: some air in aluminium
_DENSITIES = (50.0, 8000.0)  # kg/m³ that a density from the torque must lie between
_CORNERS = 500  # of the polyhedron that stands for a shape
_OFF = 0.3  # of its mass, standard error of what a URDF says of it beside a measured mass


@dataclass(frozen=True)
class PriorBodies:
    """What a fit is pulled towards.

    Attributes
    ----------
    bodies
        The model's, with the prior's parameters.
    equation
        The torque equation with these as its prior.
    placeholders
        Names of the bodies that are filled evenly.
    warnings
        What a user should know, a plain sentence each.
    """

    bodies: tuple[Body, ...]
    equation: LinearModel
    placeholders: tuple[str, ...]
    warnings: tuple[str, ...]


def placeholder_reasons(bodies: Sequence[Body]) -> dict[str, str]:
    """Why a body's inertia in the URDF is taken for a placeholder, by name; none of those that are not."""
    links = [body for body in bodies if body.kind == "link" and body.pi[0] > 0]
    sizes = [size for i, body in enumerate(bodies) if body.kind == "link" and (size := _size(bodies, i)) > 0]
    unlike = len(sizes) > 1 and max(sizes) > _OTHER_SIZE * min(sizes)
    alike = unlike and len(links) >= _FEWEST and all(_same(body, links[0]) for body in links)
    light = sum(bool(body.pi[0] < _LIGHTEST) for body in links)
    found = {}
    for body in bodies:
        reason = _reason(body, mostly_light=2 * light > len(links))
        if reason is None and alike and body.kind == "link":
            reason = "links of different sizes have the same mass and inertia"
        if reason is not None:
            found[body.name] = reason
    return found


def prior_bodies(config: Config, model: Model, equation: LinearModel, reduction: Reduction) -> PriorBodies:
    """What the fit of a model is pulled towards.

    Parameters
    ----------
    config
        The configuration, with the masses that are known.
    model
        The tree of bodies, with the URDF's parameters.
    equation
        The torque equation.
    reduction
        The data, whose torque gives placeholders their density where the total mass is not known.
    """
    reasons = placeholder_reasons(model.bodies)
    bodies, warnings = model.bodies, []
    if reasons:
        filled = [_filled(model, i) if body.name in reasons else None for i, body in enumerate(bodies)]
        density, source = _density(config, model, equation, reduction, filled)
        bodies = tuple(
            body if unit is None else replace(body, pi=density * unit)
            for body, unit in zip(bodies, filled, strict=True)
        )
        warnings.append(_said(reasons, density, source))
    bodies = _at_known_masses(config, bodies)
    if bodies is not model.bodies:
        effects = build_effects(replace(model, bodies=bodies), config)
        equation = LinearModel(equation.joints, effects, equation.operating_point)
    return PriorBodies(bodies, equation, tuple(reasons), tuple(warnings))


def _said(reasons: Mapping[str, str], density: float, source: str) -> str:
    """What a user should know of placeholders."""
    first = next(iter(reasons.values()))
    return (
        f"the URDF's inertia is a placeholder for {some(list(reasons))} ({first}): the prior is an even density of "
        f"{density:.0f} kg/m³, {source}"
    )


def _at_known_masses(config: Config, bodies: tuple[Body, ...]) -> tuple[Body, ...]:
    """The bodies with their parameters in proportion to masses that are known; the same where none are.

    A mass with a standard error counts beside the URDF's by its precision.
    """
    originals = {entry.body: entry.of for entry in config.mirror if entry.body is not None}
    known = {}
    for body in bodies:
        measured = config.known.mass.get(body.name) or config.known.mass.get(originals.get(body.name, ""))
        if measured is not None and body.pi[0] > 0:
            known[body.name] = _blended(float(body.pi[0]), measured)
    rest = sum(float(body.pi[0]) for body in bodies if body.name not in known)
    total, others = config.known.total_mass, 1.0
    if total is not None and rest > 0:
        weighed = sum(known.values())
        all_of_it = _blended(weighed + rest, total)
        others = (all_of_it - weighed) / rest if all_of_it > weighed else 1.0
    factors = [known[body.name] / float(body.pi[0]) if body.name in known else others for body in bodies]
    if all(factor == 1.0 for factor in factors):
        return bodies
    return tuple(replace(body, pi=factor * body.pi) for body, factor in zip(bodies, factors, strict=True))


def _blended(mass: float, measured: Measured) -> float:
    """What a URDF's mass and a measured one say together [kg]."""
    own, error = (_OFF * mass) ** 2, (measured.standard_error or 0.0) ** 2
    return mass + (measured.value - mass) * own / (own + error)


def _reason(body: Body, mostly_light: bool) -> str | None:
    """Why one body's inertia, looked at by itself, is a placeholder; a single light one may hold a place on purpose."""
    mass, _, inertia = mass_com_inertia(body.pi)
    if not mass > 0:
        return "no mass" if body.bounds else None
    if mass < _LIGHTEST and (body.bounds or mostly_light):
        return f"a mass of {mass:.1g} kg"
    if np.allclose(inertia, np.eye(3), atol=_ALIKE):
        return "a unit inertia"
    return None


def _same(one: Body, other: Body) -> bool:
    """Whether two bodies have the same mass, and the same inertia about their centres of mass."""
    (m, _, I), (n, _, K) = mass_com_inertia(one.pi), mass_com_inertia(other.pi)  # noqa: E741
    return bool(np.isclose(m, n, rtol=_ALIKE, atol=0) and np.allclose(I, K, rtol=_ALIKE, atol=_ALIKE * abs(I).max()))


def _ends(bodies: Sequence[Body], index: int) -> list[Array]:
    """Where the joints that a body carries sit in its frame, but for those at its own joint, shape (3,) each [m]."""
    places = [child.mount.p for child in bodies if child.mount.body == index and child.kind == "link"]
    return [place for place in places if np.linalg.norm(place) > 0]


def _size(bodies: Sequence[Body], index: int) -> float:
    """How far a body's bounds reach, or where it has none, its joints [m]; 0 where neither tells."""
    if bodies[index].bounds:
        return max(bound.size for bound in bodies[index].bounds)
    return max((float(np.linalg.norm(end)) for end in _ends(bodies, index)), default=0.0)


def _filled(model: Model, index: int) -> Array:
    """A body's parameters with a density of 1 kg/m³, shape (10,)."""
    bodies = model.bodies
    solids = [_moments(bound) for bound in bodies[index].bounds]
    if not solids:
        reaches = [float(np.linalg.norm(end)) for i in range(len(bodies)) for end in _ends(bodies, i)]
        typical = float(np.median(reaches)) if reaches else _LENGTH
        solids = [_rod(end, _THICKNESS * typical) for end in _ends(bodies, index)] or [_ball(_BALL * typical)]
    return from_pseudo_inertia(np.sum(solids, axis=0))


def _moments(bound: Ellipsoid | Shape) -> Array:
    """The pseudo-inertia of a solid with a density of 1 kg/m³, shape (4, 4)."""
    if isinstance(bound, Ellipsoid):
        return _solid(4 / 3 * np.pi * float(np.prod(bound.semi_axes)), np.array(bound.center), bound.Q_s / 5)
    center, covariance = polyhedron_moments(bound.grid(_CORNERS))
    return _solid(bound.volume, center, covariance)


def polyhedron_moments(points: Array) -> tuple[Array, Array]:
    """Centre, shape (3,), and covariance, shape (3, 3), of the convex hull of points, shape (n, 3), filled evenly.

    Of a tetrahedron with corners v_i and centre c the covariance is Σ (v_i − c)(v_i − c)ᵀ / 20.
    """
    hull = ConvexHull(points)
    faces = points[hull.simplices]
    corners = np.concatenate([faces, np.broadcast_to(points.mean(axis=0), (len(faces), 1, 3))], axis=1)
    volumes = np.abs(np.linalg.det(corners[:, :3] - corners[:, 3:]))
    shares = volumes / volumes.sum()
    centers = corners.mean(axis=1)
    center = shares @ centers
    spread = corners - centers[:, None]
    within = np.einsum("t,tki,tkj->ij", shares, spread, spread) / 20
    between = np.einsum("t,ti,tj->ij", shares, centers - center, centers - center)
    return center, within + between


def _rod(end: Array, radius: float) -> Array:
    """The same of a round rod from the frame's origin to a place."""
    reach = float(np.linalg.norm(end))
    across = np.eye(3) - np.outer(end, end) / reach**2
    return _solid(np.pi * radius**2 * reach, end / 2, np.outer(end, end) / 12 + radius**2 / 4 * across)


def _ball(radius: float) -> Array:
    """The same of a ball about the frame's origin."""
    return _solid(4 / 3 * np.pi * radius**3, np.zeros(3), radius**2 / 5 * np.eye(3))


def _solid(volume: float, center: Array, covariance: Array) -> Array:
    """The pseudo-inertia of a volume whose points have a mean and a covariance."""
    first = volume * center
    second = volume * (covariance + np.outer(center, center))
    return np.block([[second, first[:, None]], [first[None, :], np.array([[volume]])]])


def _density(
    config: Config, model: Model, equation: LinearModel, reduction: Reduction, filled: Sequence[Array | None]
) -> tuple[float, str]:
    """The density of all filled bodies [kg/m³], and where it is from."""
    volume = sum(float(unit[0]) for unit in filled if unit is not None)
    rest = sum(float(body.pi[0]) for body, unit in zip(model.bodies, filled, strict=True) if unit is None)
    total = config.known.total_mass
    if total is not None and total.value > rest:
        return (total.value - rest) / volume, "from known.total_mass"
    cure = "; measure the robot's mass and give it as known.total_mass"
    density = _density_of_torque(equation, reduction, filled)
    if not density > 0:
        return _DENSITY, f"which is assumed{cure}"
    return float(np.clip(density, *_DENSITIES)), f"from the torque{cure}"


def _density_of_torque(equation: LinearModel, reduction: Reduction, filled: Sequence[Array | None]) -> float:
    """The density with which filled bodies, the others' prior and any friction come nearest to the torque."""
    prior = equation.prior
    inertial = np.arange(len(prior)) < SIZE * len(filled)
    unit, others = np.zeros(len(prior)), np.where(inertial, prior, 0.0)
    for i, parameters in enumerate(filled):
        if parameters is not None:
            own = slice(SIZE * i, SIZE * (i + 1))
            unit[own], others[own] = parameters, 0.0
    rows = weighted_rows(equation, reduction, np.ones(len(reduction)))
    Y, tau = rows[:, :-1], rows[:, -1]
    columns = np.column_stack([Y @ unit, Y[:, ~inertial]])
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0
    found = np.linalg.lstsq(columns / size, tau - Y @ others, rcond=None)[0]
    return float(found[0] / size[0])
