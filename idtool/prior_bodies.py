"""The bodies that a fit is pulled towards: the URDF's, as far as they are to be believed, at the masses that are known.

A CAD export without materials, or a URDF written for pictures, gives every link the same inertia, a unit one or next to
none. A fit that is pulled towards such a prior is pulled nowhere. In its stead every such body is filled evenly: within
its bounds, or where it has none along the way to the joints that it carries. Its density follows from the known total
mass, or else from the torque.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from idtool.body import Body
from idtool.config import Config
from idtool.effects import build_effects
from idtool.effects.rigid_body import length
from idtool.ellipsoid import Ellipsoid
from idtool.inertia import SIZE, from_pseudo_inertia, mass_com_inertia
from idtool.model import Model
from idtool.names import some
from idtool.reduction import Reduction
from idtool.regressor import LinearModel
from idtool.shapes import Shape
from idtool.weights import weighted_rows

Array = NDArray[np.float64]

_ALIKE = 1e-6  # relative difference of two inertias below which they are the same
_FEWEST = 3  # links that are all the same by accident no more
_LIGHTEST = 1e-3  # kg of a body that a joint moves
_THICKNESS = 0.15  # radius of a link without bounds, in units of its length
_DENSITY = 500.0  # kg/m³ of bounds where neither torque nor total mass tells: some air in aluminium
_PLACES = 500  # of a shape whose moments are summed


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
    alike = len(links) >= _FEWEST and all(_same(body, links[0]) for body in links)
    found = {}
    for body in bodies:
        reason = _reason(body)
        if reason is None and alike and body.kind == "link":
            reason = "all links have the same mass and inertia"
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
        density = _density(config, model, equation, reduction, filled)
        bodies = tuple(
            body if unit is None else replace(body, pi=density * unit)
            for body, unit in zip(bodies, filled, strict=True)
        )
        warnings.append(_said(reasons, density, config.known.total_mass is not None))
    bodies = _at_known_masses(config, bodies)
    if bodies is not model.bodies:
        effects = build_effects(replace(model, bodies=bodies), config)
        equation = LinearModel(equation.joints, effects, equation.reference)
    return PriorBodies(bodies, equation, tuple(reasons), tuple(warnings))


def _said(reasons: Mapping[str, str], density: float, weighed: bool) -> str:
    """What a user should know of placeholders."""
    first = next(iter(reasons.values()))
    told = "known.total_mass" if weighed else "the torque; measure the robot's mass and give it as known.total_mass"
    return (
        f"the URDF's inertia is a placeholder for {some(list(reasons))} ({first}): the prior is an even density of "
        f"{density:.0f} kg/m³ within the bounds, from {told}"
    )


def _at_known_masses(config: Config, bodies: tuple[Body, ...]) -> tuple[Body, ...]:
    """The bodies with their parameters in proportion to masses that are known; the same where none are."""
    known, total = config.known.mass, config.known.total_mass
    weighed = sum(measured.value for measured in known.values())
    rest = sum(float(body.pi[0]) for body in bodies if body.name not in known)
    others = (total.value - weighed) / rest if total is not None and rest > 0 and total.value > weighed else 1.0
    factors = [
        known[body.name].value / body.pi[0] if body.name in known and body.pi[0] > 0 else others for body in bodies
    ]
    if all(factor == 1.0 for factor in factors):
        return bodies
    return tuple(replace(body, pi=factor * body.pi) for body, factor in zip(bodies, factors, strict=True))


def _reason(body: Body) -> str | None:
    """Why one body's inertia, looked at by itself, is a placeholder."""
    mass, _, inertia = mass_com_inertia(body.pi)
    if not mass > 0:
        return "no mass" if body.bounds else None
    if mass < _LIGHTEST:
        return f"a mass of {mass:.1g} kg"
    if np.allclose(inertia, np.eye(3), atol=_ALIKE):
        return "a unit inertia"
    return None


def _same(one: Body, other: Body) -> bool:
    """Whether two bodies have the same mass, and the same inertia about their centres of mass."""
    (m, _, I), (n, _, K) = mass_com_inertia(one.pi), mass_com_inertia(other.pi)  # noqa: E741
    return bool(np.isclose(m, n, rtol=_ALIKE, atol=0) and np.allclose(I, K, rtol=_ALIKE, atol=_ALIKE * abs(I).max()))


def _filled(model: Model, index: int) -> Array:
    """A body's parameters with a density of 1 kg/m³, shape (10,)."""
    body = model.bodies[index]
    solids = [_moments(bound) for bound in body.bounds]
    if not solids:
        ends = [child.mount.p for child in model.bodies if child.mount.body == index]
        solids = [_rod(end) for end in ends if np.linalg.norm(end) > 0] or [_ball(length(body))]
    return from_pseudo_inertia(np.sum(solids, axis=0))


def _moments(bound: Ellipsoid | Shape) -> Array:
    """The pseudo-inertia of a solid with a density of 1 kg/m³, shape (4, 4)."""
    if isinstance(bound, Ellipsoid):
        return _solid(4 / 3 * np.pi * float(np.prod(bound.semi_axes)), np.array(bound.center), bound.Q_s / 5)
    places = bound.grid(_PLACES)
    return _solid(bound.volume, places.mean(axis=0), np.cov(places.T, bias=True))


def _rod(end: Array) -> Array:
    """The same of a round rod from the frame's origin to a place."""
    reach = float(np.linalg.norm(end))
    radius = _THICKNESS * reach
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
) -> float:
    """The density of all filled bodies [kg/m³]."""
    volume = sum(float(unit[0]) for unit in filled if unit is not None)
    rest = sum(float(body.pi[0]) for body, unit in zip(model.bodies, filled, strict=True) if unit is None)
    total = config.known.total_mass
    if total is not None and total.value > rest:
        return (total.value - rest) / volume
    density = _density_of_torque(equation, reduction, filled)
    return density if density > 0 else _DENSITY


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
