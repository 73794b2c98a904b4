"""Linear constraints on the coefficients: measured masses and reflected inertias, known centres of mass, and copies.

Copies are substituted, theta = K z; everything else is an equation row · theta = value. Both go with R-factors.

Letters: theta (p,) coefficients; z (p',) those that are no copies; K (p, p').
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, replace

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError
from idtool.common.names import join_names, suggestion
from idtool.common.notice import Notice
from idtool.dynamics.armature import rotor_inertia_type
from idtool.dynamics.regressor import LinearModel
from idtool.robot.config import Config, MeasuredValue, Mirror
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inertia import PI_SIZE, parameter_reflection
from idtool.robot.model import RobotModel

_ELLIPSOID_TOLERANCE = 1e-2  # relative to its size
_ROUNDING = 1e-12  # of the columns that are added


@dataclass(frozen=True)
class Constraint:
    """One equation, row · theta = value.

    Attributes
    ----------
    label
        Its place in the configuration.
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
class EqualityConstraints:
    """All equality constraints on a model's coefficients, exact ones and measured ones.

    Attributes
    ----------
    K
        theta = K z, shape (p, p').
    free
        Index of each z among the coefficients, shape (p',).
    constraints
        Equations on theta.
    copies
        Index of a body to that of the one it is a copy of, and the signs of x, y and z in the image, shape (3,).
    """

    K: Array
    free: Indices
    constraints: tuple[Constraint, ...] = ()
    copies: Mapping[int, tuple[int, Array]] = field(default_factory=dict)

    @classmethod
    def none(cls, p: int) -> EqualityConstraints:
        """No constraint on p coefficients."""
        return cls(np.eye(p), np.arange(p))

    @property
    def hard(self) -> tuple[Constraint, ...]:
        """The exact constraints."""
        return tuple(constraint for constraint in self.constraints if constraint.standard_error is None)

    def free_columns(self, rows: Array, coefficients: Indices | None = None) -> Array:
        """Columns of the coefficients that are no copies: the product of rows and K, exactly zero where copies cancel.

        Their rounding errors, scaled to norm one, would look like a direction that the data determine.

        Parameters
        ----------
        rows
            The regressor's rows or a factor of them, shape (rows, p), or (rows, m) of some coefficients.
        coefficients
            Indices of these m coefficients; None: all.

        Returns
        -------
        Shape (rows, p').
        """
        K = self.K if coefficients is None else self.K[coefficients]
        columns = rows @ K
        norms_without_cancelling = np.linalg.norm(rows, axis=0) @ np.abs(K)
        is_rounding = np.linalg.norm(columns, axis=0) < _ROUNDING * norms_without_cancelling
        return np.where(is_rounding, 0.0, columns)

    def soft_rows(self) -> Array:
        """Measured constraints as rows [row, value] in units of their standard errors, shape (measured, p + 1)."""
        rows = [
            np.append(constraint.row, constraint.value) / constraint.standard_error
            for constraint in self.constraints
            if constraint.standard_error is not None
        ]
        return np.array(rows).reshape(-1, len(self.K) + 1)


def equality_constraints(config: Config, model: RobotModel, equation: LinearModel) -> EqualityConstraints:
    """The equality constraints of a configuration, for one model.

    Raises
    ------
    ConfigError
        If it names a body or joint that is not there, or copies go round in a circle.
    """
    p = len(equation.coefficients)
    K = np.eye(p)
    is_copy = np.zeros(p, dtype=bool)
    names = [body.name for body in model.bodies]

    body_copies = _copies(config.mirror, names, "body")
    for copy, (original, signs) in body_copies.items():
        rows = slice(PI_SIZE * copy, PI_SIZE * (copy + 1))
        columns = slice(PI_SIZE * original, PI_SIZE * (original + 1))
        K[rows] = 0
        K[rows, columns] = parameter_reflection(signs)
        is_copy[rows] = True

    joint_copies = _copies(config.mirror, list(model.names), "joint")
    for copy, (original, _) in joint_copies.items():
        for target, source in _friction_pairs(equation, model.names[copy], model.names[original]):
            K[target] = K[source]
            is_copy[target] = True

    free = np.flatnonzero(~is_copy)
    constraints = (
        *_mass_constraints(config, names, p),
        *_com_constraints(model, p),
        *_armature_constraints(config, equation),
    )
    return EqualityConstraints(K[:, free], free, constraints, body_copies)


def with_equal_bounds(model: RobotModel, equalities: EqualityConstraints) -> RobotModel:
    """The model with every copy bounded as its original, and a notice where a copy has other bounds of its own."""
    bodies = list(model.bodies)
    overruled = []
    for copy, (original, signs) in equalities.copies.items():
        own = bodies[copy]
        bodies[copy] = own.with_mirrored_bounds(bodies[original], signs)
        if own.bounds and not _are_close(own.ellipsoids, bodies[copy].ellipsoids):
            overruled.append(own.name)
    notices = model.notices
    if overruled:
        message = (
            "these copies get the bounds of their originals instead of their own from the configuration: "
            f"{join_names(overruled)}"
        )
        notices = (*notices, Notice("copies_bounds_overruled", "warning", None, message))
    return replace(model, bodies=tuple(bodies), notices=notices)


def _are_close(ellipsoids: Sequence[Ellipsoid], others: Sequence[Ellipsoid]) -> bool:
    """True if ellipsoids are equal, pair by pair, to a hundredth of their size."""
    if len(ellipsoids) != len(others):
        return False
    for ellipsoid, other in zip(ellipsoids, others, strict=True):
        tolerance = _ELLIPSOID_TOLERANCE * ellipsoid.size
        if not np.allclose(ellipsoid.center, other.center, atol=tolerance):
            return False
        if not np.allclose(ellipsoid.Q_s, other.Q_s, atol=tolerance * ellipsoid.size):
            return False
    return True


def _copies(mirrors: Sequence[Mirror], names: list[str], kind: str) -> dict[int, tuple[int, Array]]:
    """Index of every copy to that of its original, copies of copies resolved, and the reflection's signs, shape (3,).

    Parameters
    ----------
    mirrors
        From the configuration.
    names
        All bodies or joints of the model.
    kind
        ``body`` or ``joint``.
    """
    entries: dict[str, Mirror] = {}
    for entry in mirrors:
        name: str | None = getattr(entry, kind)
        if name is None:
            continue
        for given in (name, entry.of):
            if given not in names:
                raise ConfigError(
                    f"mirror: {given}", f"is not a moving {kind} of the model; {suggestion(given, names)}"
                )
        if name in entries:
            raise ConfigError(f"mirror: {name}", "is given as a copy of two others; keep one entry")
        entries[name] = entry

    copies = {}
    for name in entries:
        original = name
        signs = np.ones(3)
        visited = {name}
        while original in entries:
            signs = signs * reflection(entries[original].plane)
            original = entries[original].of
            if original in visited:
                raise ConfigError(f"mirror: {name}", "is a copy of itself through others; remove one entry")
            visited.add(original)
        copies[names.index(name)] = (names.index(original), signs)
    return copies


def reflection(plane: str | None) -> Array:
    """Signs of x, y and z under reflection in a plane of the frame, shape (3,); without a plane, none."""
    return np.array([1.0 if plane is None or axis in plane else -1.0 for axis in "xyz"])


def _friction_pairs(equation: LinearModel, copy: str, original: str) -> Iterator[tuple[int, int]]:
    """Indices of a joint's coefficients that don't depend on the direction, each with its original's."""
    index = {c.key: i for i, c in enumerate(equation.coefficients)}
    for c in equation.coefficients:
        if c.even and c.owner == copy:
            source = index.get((c.effect, original, c.name, c.instance))
            if source is not None:
                yield index[c.key], source


def _mass_constraints(config: Config, names: list[str], p: int) -> list[Constraint]:
    constraints = []
    for name, measured in config.known.mass.items():
        if name not in names:
            hint = f"is not a body of the model (a body includes the links fixed to it); {suggestion(name, names)}"
            raise ConfigError(f"known.mass: {name}", hint)
        row = np.zeros(p)
        row[PI_SIZE * names.index(name)] = 1.0
        constraints.append(_measured_constraint(f"known.mass: {name}", row, measured))
    if config.known.total_mass is not None:
        row = np.zeros(p)
        row[: PI_SIZE * len(names) : PI_SIZE] = 1.0
        constraints.append(_measured_constraint("known.total_mass", row, config.known.total_mass))
    return constraints


def _armature_constraints(config: Config, equation: LinearModel) -> list[Constraint]:
    """Known reflected inertias of rotors."""
    constraints = []
    effect = rotor_inertia_type().id
    for i, coefficient in enumerate(equation.coefficients):
        armature = config.armature_of(coefficient.owner) if coefficient.effect == effect else None
        if isinstance(armature, MeasuredValue):
            row = np.zeros(len(equation.coefficients))
            row[i] = 1.0
            constraints.append(_measured_constraint(f"armature: {coefficient.owner}", row, armature))
    return constraints


def _measured_constraint(label: str, row: Array, measured: MeasuredValue) -> Constraint:
    return Constraint(label, row, measured.value, measured.standard_error)


def _com_constraints(model: RobotModel, p: int) -> list[Constraint]:
    """H − m c = 0 for every body whose centre of mass c is known."""
    constraints = []
    for i, body in enumerate(model.bodies):
        for axis, c in enumerate(body.com or ()):
            row = np.zeros(p)
            row[PI_SIZE * i] = -c
            row[PI_SIZE * i + 1 + axis] = 1.0
            constraints.append(Constraint(f"known_com: {body.name}", row, 0.0))
    return constraints
