"""What is known beside the logs: measured masses and centres of mass, and bodies or joints that are copies of others.

All of it is linear in the coefficients, theta = K z with facts row · theta = value, so it goes with R-factors.

Letters: theta (p,) coefficients; z (p',) those that are no copies; K (p, p').
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.exceptions import ConfigError
from idtool.common.names import nearest, some
from idtool.dynamics.regressor import LinearModel
from idtool.robot.config import Config, Measured, Mirror
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inertia import SIZE, mirrored
from idtool.robot.model import Model

_ALIKE = 1e-2  # of a size


@dataclass(frozen=True)
class Fact:
    """One equation, row · theta = value.

    Attributes
    ----------
    label
        Where it stands in the configuration.
    row
        Shape (p,).
    value
        In the unit of row · theta.
    standard_error
        Of the value; None: exact.
    """

    label: str
    row: Array
    value: float
    standard_error: float | None = None


@dataclass(frozen=True)
class Knowledge:
    """What is known of a model's coefficients.

    Attributes
    ----------
    K
        theta = K z, shape (p, p').
    free
        Which coefficients z are, shape (p',).
    facts
        Equations on theta.
    copies
        Index of a body to that of the one it is a copy of, and the signs of x, y and z in the image, shape (3,).
    """

    K: Array
    free: Indices
    facts: tuple[Fact, ...] = ()
    copies: Mapping[int, tuple[int, Array]] = field(default_factory=dict)

    @classmethod
    def none(cls, p: int) -> Knowledge:
        """Nothing beside the logs."""
        return cls(np.eye(p), np.arange(p))

    @property
    def hard(self) -> tuple[Fact, ...]:
        """The exact facts."""
        return tuple(fact for fact in self.facts if fact.standard_error is None)

    def soft_rows(self) -> Array:
        """The others as rows [row, value] in units of their standard errors, shape (facts, p + 1)."""
        p = len(self.K)
        rows = [np.append(f.row, f.value) / f.standard_error for f in self.facts if f.standard_error is not None]
        return np.array(rows).reshape(-1, p + 1)


def knowledge(config: Config, model: Model, equation: LinearModel) -> Knowledge:
    """What a configuration knows of a model.

    Raises
    ------
    ConfigError
        If it names a body or joint that is not there, or copies go round in a circle.
    """
    p = len(equation.coefficients)
    K, source = np.eye(p), np.arange(p)
    names = [body.name for body in model.bodies]
    bodies = _sources(config.mirror, names, "body")
    for copy, (of, plane) in bodies.items():
        rows, columns = (slice(SIZE * i, SIZE * (i + 1)) for i in (copy, of))
        K[rows] = 0
        K[rows, columns] = mirrored(plane)
        source[rows] = -1
    for copy, (of, _) in _sources(config.mirror, list(model.names), "joint").items():
        for to, fro in _friction_pairs(equation, model.names[copy], model.names[of]):
            K[to] = K[fro]
            source[to] = -1
    free = np.flatnonzero(source >= 0)
    facts = (*_masses(config, names, p), *_centres(model, p))
    return Knowledge(K[:, free], free, facts, bodies)


def with_equal_bounds(model: Model, known: Knowledge) -> Model:
    """The model in which the bounds of a body are those of the one that it is a copy of; others are warned of."""
    bodies, lost = list(model.bodies), []
    for copy, (of, signs) in known.copies.items():
        own = bodies[copy]
        bodies[copy] = own.bounded_as(bodies[of], signs)
        if own.bounds and not _alike(own.ellipsoids, bodies[copy].ellipsoids):
            lost.append(own.name)
    said = (f"copies, bounded as what they are copies of and not as configured: {some(lost)}",) if lost else ()
    return replace(model, bodies=tuple(bodies), warnings=(*model.warnings, *said))


def _alike(ones: tuple[Ellipsoid, ...], others: tuple[Ellipsoid, ...]) -> bool:
    """Whether ellipsoids are the same to a hundredth of their size."""
    return len(ones) == len(others) and all(
        np.allclose(a.center, b.center, atol=_ALIKE * a.size) and np.allclose(a.Q_s, b.Q_s, atol=_ALIKE * a.size**2)
        for a, b in zip(ones, others, strict=True)
    )


def _sources(mirrors: tuple[Mirror, ...], names: list[str], kind: str) -> dict[int, tuple[int, Array]]:
    """Index of every copy to that of the body or joint that it copies in the end, and the reflection, shape (3,)."""
    direct: dict[str, Mirror] = {}
    for entry in mirrors:
        name: str | None = getattr(entry, kind)
        if name is None:
            continue
        for given in (name, entry.of):
            if given not in names:
                raise ConfigError(f"mirror: {given}", f"is no moving {kind} of the model; {nearest(given, names)}")
        if name in direct:
            raise ConfigError(f"mirror: {name}", "is the copy of two; keep one entry")
        direct[name] = entry
    found = {}
    for name in direct:
        plane, of, seen = np.ones(3), name, {name}
        while of in direct:
            plane = plane * reflection(direct[of].plane)
            of = direct[of].of
            if of in seen:
                raise ConfigError(f"mirror: {name}", "is in the end a copy of itself; leave one of the circle free")
            seen.add(of)
        found[names.index(name)] = (names.index(of), plane)
    return found


def reflection(plane: str | None) -> Array:
    """Signs of x, y and z under reflection in a plane of the frame, shape (3,); without a plane, none."""
    return np.array([1.0 if plane is None or axis in plane else -1.0 for axis in "xyz"])


def _friction_pairs(equation: LinearModel, copy: str, of: str) -> list[tuple[int, int]]:
    """Indices of a joint's coefficients that do not depend on the direction, and of the same of another joint."""
    index = {c.key: i for i, c in enumerate(equation.coefficients)}
    even = [c for c in equation.coefficients if c.even and c.owner == copy]
    pairs = [(index[c.key], index.get((c.effect, of, c.name, c.instance))) for c in even]
    return [(to, fro) for to, fro in pairs if fro is not None]


def _masses(config: Config, names: list[str], p: int) -> list[Fact]:
    facts = []
    for name, measured in config.known.mass.items():
        if name not in names:
            hint = f"is no body of the model (give what is fixed to it along with it); {nearest(name, names)}"
            raise ConfigError(f"known.mass: {name}", hint)
        row = np.zeros(p)
        row[SIZE * names.index(name)] = 1.0
        facts.append(_fact(f"known.mass: {name}", row, measured))
    if config.known.total_mass is not None:
        row = np.zeros(p)
        row[: SIZE * len(names) : SIZE] = 1.0
        facts.append(_fact("known.total_mass", row, config.known.total_mass))
    return facts


def _fact(label: str, row: Array, measured: Measured) -> Fact:
    return Fact(label, row, measured.value, measured.standard_error)


def _centres(model: Model, p: int) -> list[Fact]:
    """That h − m c = 0 for every body whose centre of mass c is known."""
    facts = []
    for i, body in enumerate(model.bodies):
        for k, c in enumerate(body.com or ()):
            row = np.zeros(p)
            row[SIZE * i], row[SIZE * i + 1 + k] = -c, 1.0
            facts.append(Fact(f"known_com: {body.name}", row, 0.0))
    return facts
