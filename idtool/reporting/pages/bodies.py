"""Bodies in three dimensions, as data for `templates/bodies.js` and `robot.js`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.reporting.results.fit import BodyReport, PointMasses
from idtool.robot.inertia import PI_SIZE
from idtool.robot.model import RobotModel
from idtool.robot.witness import deviation_ellipsoid, unrealizable_reasons

_DECIMALS = 6  # of lengths in m
_MAX_NUMBERS = 60_000  # that all bodies hold together
_MAX_MASSES = 300  # of a witness that are drawn


@dataclass(frozen=True)
class BodyDrawing:
    """A body to draw, in its own frame [m].

    Attributes
    ----------
    bounds
        Shapes that bound its mass.
    spread, prior_spread
        Standard-deviation ellipsoids of its mass and of the prior's; None for parameters that no body has.
    masses
        Point masses that have its parameters, or None.
    """

    bounds: list[dict[str, Any]]
    spread: dict[str, Any] | None
    prior_spread: dict[str, Any] | None
    masses: dict[str, Any] | None


def report_views(bodies: Mapping[str, BodyReport]) -> dict[str, Any]:
    """Views of identified bodies, see `body_views`.

    Parameters
    ----------
    bodies
        ``bodies`` of report.json.
    """
    drawings = {}
    for name, body in bodies.items():
        ellipsoids = [{"kind": "ellipsoid", **ellipsoid.model_dump()} for ellipsoid in body.ellipsoids]
        deviation = body.deviation_ellipsoid
        drawings[name] = BodyDrawing(
            bounds=[*ellipsoids, *body.shapes],
            spread=deviation.model_dump() if deviation else None,
            prior_spread=_deviation_view(body.prior.tolist()),
            masses=_witness_view(body.witness),
        )
    return body_views(drawings)


def model_views(model: RobotModel, theta: Array, prior: Array | None) -> dict[str, Any]:
    """Views of bodies that were not identified, see `body_views`.

    Parameters
    ----------
    model
        The tree of bodies.
    theta, prior
        Coefficients of the torque equation, shape (p,), the bodies' first; of the prior None where there is none.
    """
    drawings = {}
    for i, body in enumerate(model.bodies):
        part = slice(PI_SIZE * i, PI_SIZE * (i + 1))
        ellipsoids = [{"kind": "ellipsoid", **ellipsoid.to_dict()} for ellipsoid in body.ellipsoids]
        drawings[body.name] = BodyDrawing(
            bounds=[*ellipsoids, *(shape.to_dict() for shape in body.shapes)],
            spread=_deviation_view(theta[part].tolist()),
            prior_spread=None if prior is None else _deviation_view(prior[part].tolist()),
            masses=None,
        )
    return body_views(drawings)


def body_views(bodies: Mapping[str, BodyDrawing]) -> dict[str, Any]:
    """Views of bodies for `bodies.js`, of bounded size.

    Parameters
    ----------
    bodies
        The bodies by name.

    Returns
    -------
    ``bodies``, each with its name, ``bounds`` (the shapes that bound its mass), ``found`` and ``prior`` (the
    standard-deviation ellipsoids about the centre of mass), or None, and ``masses``, or None; lengths in m, in the
    body's frame. ``hidden``: the number of bodies that are not drawn.
    """
    views: list[dict[str, Any]] = []
    numbers = 0
    for name, body in bodies.items():
        view = _body_view(name, body)
        numbers += _number_count(view)
        if numbers > _MAX_NUMBERS:
            break
        views.append(view)
    return {"bodies": views, "hidden": len(bodies) - len(views)}


def _body_view(name: str, body: BodyDrawing) -> dict[str, Any]:
    return {
        "name": name,
        "bounds": _rounded(body.bounds),
        "found": _rounded(body.spread),
        "prior": _rounded(body.prior_spread),
        "masses": body.masses,
    }


def _deviation_view(pi: list[float]) -> dict[str, Any] | None:
    """The standard-deviation ellipsoid, if some density has these parameters."""
    if len(pi) != PI_SIZE or unrealizable_reasons(pi):
        return None
    return deviation_ellipsoid(pi).to_dict()


def _witness_view(witness: PointMasses | None) -> dict[str, Any] | None:
    """The witness; of many point masses, the heaviest."""
    if witness is None:
        return None
    heaviest = np.sort(np.argsort(witness.masses)[::-1][:_MAX_MASSES])
    return {
        "masses": [float(f"{witness.masses[i]:.5g}") for i in heaviest],
        "points": _rounded([witness.points[i] for i in heaviest]),
        "of": len(witness.masses),
    }


def _rounded(value: Any) -> Any:
    """Plain data with its numbers rounded."""
    if isinstance(value, float):
        return round(value, _DECIMALS) + 0.0
    if isinstance(value, Mapping):
        return {key: _rounded(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(inner) for inner in value]
    return value


def _number_count(value: Any) -> int:
    """Number of numbers in plain data."""
    if isinstance(value, Mapping):
        return sum(map(_number_count, value.values()))
    if isinstance(value, list):
        return sum(map(_number_count, value))
    return int(isinstance(value, int | float))
