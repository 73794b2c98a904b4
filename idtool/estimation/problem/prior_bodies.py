"""The prior's bodies: the URDF's, with placeholders replaced by an even density, at the masses that are known.

A CAD export without materials, or a URDF written for pictures, gives links of different sizes the same inertia, a unit
one or next to none. A fit that is pulled towards such a prior is pulled nowhere. In its stead every such body is filled
evenly: within its bounds, or where it has none along the way to the joints that it carries. Its density follows from
the known total mass, or else from the torque.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.dynamics.effects import build_effects
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.weights import weighted_rows
from idtool.robot.body import Body
from idtool.robot.config import Config
from idtool.robot.config.estimation import MeasuredValue
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inertia import PI_SIZE, from_pseudo_inertia, mass_com_inertia
from idtool.robot.model import RobotModel
from idtool.robot.shapes import Shape

# Signs of a placeholder
_EQUAL_INERTIA = 1e-6  # relative difference of two inertias below which they are the same
_FEWEST_ALIKE = 3  # links whose inertias are all the same by accident no more
_OTHER_SIZE = 1.2  # ratio of the largest link's size to the smallest's from which they are not of one kind
_LIGHTEST = 1e-3  # kg of a body that a joint moves

# Its geometry where it has no bounds
_DEFAULT_LENGTH = 0.2  # m of a link where no joints tell
_ROD_RADIUS = 0.15  # of a link with joints to carry, in units of a typical link's length
_BALL_RADIUS = 0.25  # of the last link, likewise: of about the volume of such a rod
_CORNERS = 500  # of the polyhedron that stands for a shape

# Its density
_DEFAULT_DENSITY = 500.0  # kg/m³ where neither torque nor total mass tell: some air in aluminium
_DENSITY_RANGE = (50.0, 8000.0)  # kg/m³ that a density from the torque must lie in

_URDF_MASS_ERROR = 0.3  # relative standard error of a URDF's mass beside a measured one


@dataclass(frozen=True)
class PriorBodies:
    """Bodies that a fit is pulled towards.

    Attributes
    ----------
    bodies
        The model's, with the prior's parameters.
    equation
        The torque equation with these as its prior.
    placeholders
        Names of the bodies that are filled evenly.
    notices
        Plain sentences for the user.
    """

    bodies: tuple[Body, ...]
    equation: LinearModel
    placeholders: tuple[str, ...]
    notices: tuple[Notice, ...]


def prior_bodies(config: Config, model: RobotModel, equation: LinearModel, reduction: Reduction) -> PriorBodies:
    """The prior's bodies of a model.

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
    unit_densities = {i: _evenly_filled(model.bodies, i) for i, body in enumerate(model.bodies) if body.name in reasons}
    bodies = model.bodies
    source = ""
    if unit_densities:
        density, source = _density(config, model, equation, reduction, unit_densities)
        bodies = tuple(
            replace(body, pi=density * unit_densities[i]) if i in unit_densities else body
            for i, body in enumerate(bodies)
        )
    bodies = _at_known_masses(config, bodies)
    notices = []
    if unit_densities:
        densities = [float(bodies[i].pi[0] / unit[0]) for i, unit in unit_densities.items()]
        notices.append(_placeholder_notice(reasons, densities, source))
    if bodies is not model.bodies:
        effects = build_effects(replace(model, bodies=bodies), config)
        equation = replace(equation, effects=effects)
    return PriorBodies(bodies, equation, tuple(reasons), tuple(notices))


def _placeholder_notice(reasons: Mapping[str, str], densities: Sequence[float], source: str) -> Notice:
    """Notice about placeholders, with their densities [kg/m³], which differ where single masses are known."""
    first_reason = next(iter(reasons.values()))
    lowest, highest = f"{min(densities):.0f}", f"{max(densities):.0f}"
    density = lowest if lowest == highest else f"{lowest} to {highest}"
    message = (
        f"the URDF's inertia of {join_names(list(reasons))} is a placeholder ({first_reason}): the prior is a uniform "
        f"density of {density} kg/m³, {source}"
    )
    return Notice("placeholder_inertia", "warning", None, message)


def placeholder_reasons(bodies: Sequence[Body]) -> dict[str, str]:
    """Reasons why a body's inertia in the URDF is taken for a placeholder, by name; none for bodies that are not."""
    links = [body for body in bodies if body.kind == "link" and body.pi[0] > 0]
    sizes = [_size(bodies, i) for i, body in enumerate(bodies) if body.kind == "link"]
    sizes = [size for size in sizes if size > 0]
    sizes_differ = len(sizes) > 1 and max(sizes) > _OTHER_SIZE * min(sizes)
    same_inertias = len(links) >= _FEWEST_ALIKE and all(_same_inertia(body, links[0]) for body in links)
    light = [body for body in links if body.pi[0] < _LIGHTEST]
    mostly_light = 2 * len(light) > len(links)

    reasons = {}
    for body in bodies:
        reason = _own_reason(body, mostly_light)
        if reason is None and sizes_differ and same_inertias and body.kind == "link":
            reason = "links of different sizes have the same mass and inertia"
        if reason is not None:
            reasons[body.name] = reason
    return reasons


def _own_reason(body: Body, mostly_light: bool) -> str | None:
    """Reason why one body's inertia by itself is a placeholder; a single light one may hold a place on purpose."""
    mass, _, inertia = mass_com_inertia(body.pi)
    if not mass > 0:
        return "no mass" if body.bounds else None
    if mass < _LIGHTEST and (body.bounds or mostly_light):
        return f"a mass of {short_number(mass, 1)} kg"
    if np.allclose(inertia, np.eye(3), atol=_EQUAL_INERTIA):
        return "a unit inertia"
    return None


def _same_inertia(body: Body, other: Body) -> bool:
    """True if two bodies have the same mass, and the same inertia about their centres of mass."""
    mass, _, inertia = mass_com_inertia(body.pi)
    other_mass, _, other_inertia = mass_com_inertia(other.pi)
    if not np.isclose(mass, other_mass, rtol=_EQUAL_INERTIA, atol=0):
        return False
    tolerance = _EQUAL_INERTIA * np.abs(inertia).max()
    return bool(np.allclose(inertia, other_inertia, rtol=_EQUAL_INERTIA, atol=tolerance))


def _child_joint_positions(bodies: Sequence[Body], index: int) -> list[Array]:
    """Positions of the joints that a body carries in its frame, but for those at its own joint, shape (3,) each [m]."""
    positions = []
    for child in bodies:
        if child.mount.body == index and child.kind == "link" and np.linalg.norm(child.mount.p) > 0:
            positions.append(child.mount.p)
    return positions


def _size(bodies: Sequence[Body], index: int) -> float:
    """Reach of a body's bounds, or of its child joints if it has none [m]; 0 where neither tells."""
    if bodies[index].bounds:
        return max(bound.size for bound in bodies[index].bounds)
    positions = _child_joint_positions(bodies, index)
    return max((float(np.linalg.norm(position)) for position in positions), default=0.0)


def _at_known_masses(config: Config, bodies: tuple[Body, ...]) -> tuple[Body, ...]:
    """The bodies with their parameters in proportion to masses that are known; the same tuple where none are.

    A mass with a standard error counts beside the URDF's by its precision.
    """
    mirrored_from = {entry.body: entry.of for entry in config.mirror if entry.body is not None}
    known_masses = config.known.mass
    mass_of_known = {}
    for body in bodies:
        measured = known_masses.get(body.name) or known_masses.get(mirrored_from.get(body.name, ""))
        if measured is not None and body.pi[0] > 0:
            mass_of_known[body.name] = _blended(float(body.pi[0]), measured)

    factor_of_others = 1.0
    mass_of_others = sum(float(body.pi[0]) for body in bodies if body.name not in mass_of_known)
    if config.known.total_mass is not None and mass_of_others > 0:
        total_of_known = sum(mass_of_known.values())
        total = _blended(total_of_known + mass_of_others, config.known.total_mass)
        if total > total_of_known:
            factor_of_others = (total - total_of_known) / mass_of_others

    factors = []
    for body in bodies:
        if body.name in mass_of_known:
            factors.append(mass_of_known[body.name] / float(body.pi[0]))
        else:
            factors.append(factor_of_others)
    if all(factor == 1.0 for factor in factors):
        return bodies
    return tuple(replace(body, pi=factor * body.pi) for body, factor in zip(bodies, factors, strict=True))


def _blended(mass: float, measured: MeasuredValue) -> float:
    """Mean of a URDF's mass and a measured one, weighted by their precisions [kg]."""
    variance_of_urdf = (_URDF_MASS_ERROR * mass) ** 2
    variance_of_measured = (measured.standard_error or 0.0) ** 2
    trust = variance_of_urdf / (variance_of_urdf + variance_of_measured)  # in the measurement
    return mass + (measured.value - mass) * trust


def _evenly_filled(bodies: Sequence[Body], index: int) -> Array:
    """Parameters of a body with a density of 1 kg/m³, shape (10,)."""
    solids = [_bound_pseudo_inertia(bound) for bound in bodies[index].bounds]
    if not solids:
        lengths = []
        for i in range(len(bodies)):
            lengths += [float(np.linalg.norm(position)) for position in _child_joint_positions(bodies, i)]
        typical = float(np.median(lengths)) if lengths else _DEFAULT_LENGTH
        solids = [_rod(end, _ROD_RADIUS * typical) for end in _child_joint_positions(bodies, index)]
        solids = solids or [_ball(_BALL_RADIUS * typical)]
    return from_pseudo_inertia(np.sum(solids, axis=0))


def _bound_pseudo_inertia(bound: Ellipsoid | Shape) -> Array:
    """Pseudo-inertia of a bound with a density of 1 kg/m³, shape (4, 4)."""
    if isinstance(bound, Ellipsoid):
        volume = 4 / 3 * np.pi * float(np.prod(bound.semi_axes))
        return _pseudo_inertia(volume, np.array(bound.center), bound.Q_s / 5)
    center, covariance = hull_centre_and_covariance(bound.grid(_CORNERS))
    return _pseudo_inertia(bound.volume, center, covariance)


def hull_centre_and_covariance(points: Array) -> tuple[Array, Array]:
    """Centre, shape (3,), and covariance, shape (3, 3), of the convex hull of points, shape (n, 3), filled evenly.

    Of a tetrahedron with corners v_i and centre c the covariance is Σ (v_i − c)(v_i − c)ᵀ / 20.
    """
    from scipy.spatial import ConvexHull

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
    """Pseudo-inertia of a round rod from the frame's origin to a position, of 1 kg/m³, shape (4, 4)."""
    length = float(np.linalg.norm(end))
    across = np.eye(3) - np.outer(end, end) / length**2
    covariance = np.outer(end, end) / 12 + radius**2 / 4 * across
    return _pseudo_inertia(np.pi * radius**2 * length, end / 2, covariance)


def _ball(radius: float) -> Array:
    """Pseudo-inertia of a ball about the frame's origin, of 1 kg/m³, shape (4, 4)."""
    return _pseudo_inertia(4 / 3 * np.pi * radius**3, np.zeros(3), radius**2 / 5 * np.eye(3))


def _pseudo_inertia(mass: float, center: Array, covariance: Array) -> Array:
    """Pseudo-inertia of a mass whose points have a mean and a covariance, shape (4, 4)."""
    first = mass * center
    second = mass * (covariance + np.outer(center, center))
    return np.block([[second, first[:, None]], [first[None, :], np.array([[mass]])]])


def _density(
    config: Config,
    model: RobotModel,
    equation: LinearModel,
    reduction: Reduction,
    unit_densities: Mapping[int, Array],
) -> tuple[float, str]:
    """Density of all placeholders [kg/m³], and its source in words.

    Parameters
    ----------
    config, model, equation, reduction
        As in `prior_bodies`.
    unit_densities
        Parameters of the placeholders with a density of 1 kg/m³, shape (10,) each, by index of the body.
    """
    volume = sum(float(unit[0]) for unit in unit_densities.values())
    mass_of_others = sum(float(body.pi[0]) for i, body in enumerate(model.bodies) if i not in unit_densities)
    total = config.known.total_mass
    if total is not None and total.value > mass_of_others:
        return (total.value - mass_of_others) / volume, "computed from known.total_mass"
    weighed = "the robot" if model.has_floating_base else "the moving parts"
    advice = f"; weigh {weighed} and set known.total_mass"
    density = _density_from_torque(equation, reduction, unit_densities, len(model.bodies))
    if not density > 0:
        return _DEFAULT_DENSITY, f"which is assumed{advice}"
    return float(np.clip(density, *_DENSITY_RANGE)), f"estimated from the torque{advice}"


def _density_from_torque(
    equation: LinearModel, reduction: Reduction, unit_densities: Mapping[int, Array], bodies: int
) -> float:
    """Density with which placeholders, the others' prior and any friction come nearest to the torque [kg/m³]."""
    prior = equation.prior
    is_inertial = np.arange(len(prior)) < PI_SIZE * bodies
    of_others = np.where(is_inertial, prior, 0.0)
    of_placeholders = np.zeros(len(prior))
    for i, unit in unit_densities.items():
        own = slice(PI_SIZE * i, PI_SIZE * (i + 1))
        of_placeholders[own] = unit
        of_others[own] = 0.0
    rows = weighted_rows(equation, reduction, np.ones(len(reduction)))
    Y, tau = rows[:, :-1], rows[:, -1]
    columns = np.column_stack([Y @ of_placeholders, Y[:, ~is_inertial]])
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0
    solution = np.linalg.lstsq(columns / size, tau - Y @ of_others, rcond=None)[0]
    return float(solution[0] / size[0])
